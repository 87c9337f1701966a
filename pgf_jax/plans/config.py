"""Settings of `plan`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from pgf_jax.errors import BadInput
from pgf_jax.fleet.policies import after, check_ask
from pgf_jax.guidance.operators.registry import check_operator
from pgf_jax.physics.config import PhysicsName
from pgf_jax.physics.engine import check_engine
from pgf_jax.planning.config import CostVariant, TaskLimit, Update
from pgf_jax.scene import SceneClass
from pgf_jax.settings import MAX_SEED, Count, Seconds, Seed, check_fields, check_int


@dataclasses.dataclass(frozen=True)
class PlanConfig:
    """How scenes are planned; BadInput where a value is wrong.

    Attributes:
      engine: physics engine: planar (fast, disks on a plane), mjx (MuJoCo in JAX), native (MuJoCo
        in C), or a registered one.
      physics: physics constants: default, or paper (its time step, and the softness of the authors'
        contacts).
      cost: cost terms: source (as the authors' published source has them), or paper (as its text).
      update: how an iteration changes the best trajectory: greedy takes the cheapest rollout, as
        the paper does; stomp blends the noise of all rollouts by weight.
      operator: who gives input (what to push where): heuristic (geometry), noisy (heuristic with
        errors), oracle (tries pushes in simulation), clairvoyant (the same with the robot's own
        noise), none, or a registered one.
      ask: when the robot asks for input: stuck, gain (the predicted gain is high enough), after:N
        (after N reach iterations since each restart or input), or never.
      lanes: robots computed in one call of the engine (L); results are bit-equal for equal L only.
      predictor: what predicts the gain of input (the cost that it saves): paper or best, as
        shipped; a folder of checkpoints, for the paper's pair of networks in it; or best:FOLDER.
      service_mean: mean of a simulated operator's log-normal service time, s.
      service_sd: standard deviation of a simulated operator's service time, s; 0 makes it constant.
      task_limit: simulated time for planning, waiting and interaction in a task, s.
    """

    engine: str = "planar"
    physics: PhysicsName = "default"
    cost: CostVariant = "source"
    update: Update = "greedy"
    operator: str = "none"
    ask: str = "stuck"
    lanes: Count = 1
    predictor: str = "paper"
    service_mean: Seconds = 8.0
    service_sd: Seconds = 4.0
    task_limit: TaskLimit = 180.0

    def __post_init__(self) -> None:
        check_fields(self)
        check_engine(self.engine)
        check_operator(self.operator)
        check_ask(self.ask)

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
    """Plan scenes, from files or sampled, all in one batch.

    A scene that is not solved has a plan too: the best one that was found.

    Attributes:
      scene: scene files (the authors' published MJCF) to plan; object_3 is the goal.
      scene_class: sample scenes of this class instead of reading files: tight, medium or wide;
        None: the files' scenes.
      seed: seed of the noise; with --scene-class also of the first scene, and the next scenes count
        on from there.
      count: how many scenes to sample.
      out: folder for the plans, NAME.plan.json of each scene; None: no plan is written.
      config: how the scenes are planned.
    """

    scene: tuple[Path, ...] = ()
    scene_class: Annotated[SceneClass | None, tyro.conf.arg(aliases=["--preset"])] = None
    seed: Seed = 0
    count: Count = 1
    out: Path | None = None
    config: Annotated[PlanConfig, tyro.conf.arg(name="")] = dataclasses.field(
        default_factory=PlanConfig
    )

    GROUPS = (  # of options, for the help
        ("scene", ("scene", "scene_class", "count", "seed")),
        ("planning", ("engine", "physics", "cost", "update", "lanes", "task_limit")),
        ("operator", ("operator", "ask", "predictor", "service_mean", "service_sd")),
        ("output", ("out",)),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if bool(self.scene) == (self.scene_class is not None):
            got = "both" if self.scene else "neither"
            raise BadInput(f"--scene, --scene-class: expected one of the two, got {got}")
        if self.scene and self.count != 1:
            raise BadInput(f"count: goes with scene_class only, got {self.count} with scene files")
        check_int("seed", self.seed, 0, MAX_SEED - self.count + 1)
