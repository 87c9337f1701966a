"""Settings of `plan`, from Python and on the command line; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pgf_jax.errors import BadInput
from pgf_jax.fleet.policies import after, check_ask
from pgf_jax.guidance.operators.registry import check_operator
from pgf_jax.planning.config import check_planning
from pgf_jax.settings import MAX_SEED, check_choice, check_fields, check_int, check_seconds

PRESETS = ("tight", "medium", "wide")
MIN_TASK_S = 1.5  # the nominal's own rollout


@dataclasses.dataclass(frozen=True)
class PlanConfig:
    """How scenes are planned (D3, D4); BadInput where a value is none of its kind.

    Attributes:
      engine: physics engine: planar, mjx, native, or a registered one.
      physics: default, or the paper's substep and the authors' softness.
      cost: cost variant: the authors' source, or the paper's text.
      update: greedy keeps an iteration's winner (the paper's); stomp blends the noise by weight.
      operator: who gives input: none, heuristic, or a registered one.
      ask: when input is asked for: stuck, gain (predicted, needs checkpoints), never, or after:N
        (N reach iterations after each restart or input). With operator none nothing is asked.
      lanes: L, robots computed in one call; results are bit-equal for equal L only.
      predictor: for --ask gain: paper or best, as shipped; or a folder of checkpoints, for the
        paper's pair in it, or best:FOLDER.
      service_mean: mean of the log-normal service time, s; it counts towards the limit.
      service_sd: its standard deviation, s.
      task_limit: planning, waiting and interaction allowed, s of simulated time.
    """

    engine: str = "planar"
    physics: Literal["default", "paper"] = "default"
    cost: Literal["source", "paper"] = "source"
    update: Literal["greedy", "stomp"] = "greedy"
    operator: str = "none"
    ask: str = "stuck"
    lanes: int = 1
    predictor: str = "paper"
    service_mean: float = 8.0
    service_sd: float = 4.0
    task_limit: float = 180.0

    def __post_init__(self) -> None:
        check_fields(self)
        check_planning(self)
        check_operator(self.operator)
        check_ask(self.ask)
        check_seconds("task_limit", self.task_limit, MIN_TASK_S)
        for name in ("service_mean", "service_sd"):
            check_seconds(name, getattr(self, name), 0.0)

    @property
    def policy(self) -> str:
        """The fleet policy of `ask`; without an operator nothing is asked."""
        if self.operator == "none" or self.ask == "never":
            return "autonomous"
        if self.ask.startswith("after:"):
            return after(check_ask(self.ask))
        # One robot has its operator for itself: an ask when stuck is granted at once.
        return {"stuck": "or-hitl", "gain": "pgf"}[self.ask]


@dataclasses.dataclass(frozen=True)
class PlanCommand:
    """Plan scenes, from files or sampled, in one batch; an unsolved plan is a result too.

    Attributes:
      scene: scene files (the published MJCF); object_3 is the goal.
      preset: sample scenes of this class instead.
      seed: of the noise; with --preset, of the first scene too (the next ones count on).
      count: how many scenes to sample.
      out: folder for NAME.plan.json of each scene; by default none is written.
      config: how they are planned.
    """

    scene: tuple[Path, ...] = ()
    preset: Annotated[str | None, tyro.conf.arg(metavar="{tight,medium,wide}")] = None
    seed: int = 0
    count: int = 1
    out: Path | None = None
    config: Annotated[PlanConfig, tyro.conf.arg(name="")] = dataclasses.field(
        default_factory=PlanConfig
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if bool(self.scene) == (self.preset is not None):
            got = "both" if self.scene else "neither"
            raise BadInput(f"--scene, --preset: expected one of the two, got {got}")
        if self.preset is not None:
            check_choice("preset", self.preset, list(PRESETS))
        check_int("count", self.count, 1)
        if self.scene and self.count != 1:
            raise BadInput(f"count: goes with preset only, got {self.count} with scene files")
        check_int("seed", self.seed, 0, MAX_SEED - self.count + 1)
