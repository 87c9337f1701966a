"""What a sweep is made of: the configuration, its presets and its cells; no JAX here.

The command line of `pgf-jax sweep` is built from `SweepConfig`.
"""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from pgf_jax import cores
from pgf_jax.errors import BadInput, short_repr
from pgf_jax.fleet.compute import parse_compute
from pgf_jax.fleet.config import Cell, FleetConfig
from pgf_jax.fleet.policies import policy_names
from pgf_jax.physics.engine import engine_names
from pgf_jax.planning.config import Cost, Planner
from pgf_jax.settings import MAX_SEED, check_choice, check_fields, check_int, check_seconds

CLOCK_S = 1e-9  # the simulated clock counts nanoseconds


# L, robots in one call: a constant of an engine, because `mjx` rounds differently at another L.
# C MuJoCo rolls out one by one and gains nothing from a larger call, which would only pad more;
# `planar` computes no padding, and fills its chunks better from a larger call.
LANES = {"mjx": 8, "native": 1, "planar": 64}


OTHER_LANES = 8


# Fields that decide on no result: how and where a sweep is computed; and those that say where its
# inputs lie, whose content decides.
HOW = ("preset", "workers", "scheduler", "out", "resume", "json")


INPUTS = ("scenes", "predictor", "log")


# These need no network that predicts a gain.
GAINLESS = frozenset(
    {
        "autonomous",
        "or-hitl",
        "or-hitl-window",
        "queue",
        "always",
        "random",
        "classifier",
        "oracle-gain",
    }
)


@dataclasses.dataclass(frozen=True)
class Preset:
    """Sizes of a sweep; `fixed` ones cannot be combined with others."""

    robots: tuple[int, ...]
    policies: tuple[str, ...]
    tasks: Callable[[int], int]  # R -> tasks of each robot
    scene_class: str = "tight"
    fixed: bool = False


DEFAULT = Preset((1, 10, 20, 30), ("pgf", "or-hitl"), lambda robots: 10)


PRESETS = {
    # 2 policies * (1 robot * 4 tasks + 4 robots * 4 tasks) = 40 tasks.
    "quick": Preset((1, 4), ("pgf", "or-hitl"), lambda robots: 4, fixed=True),
    # The paper's figure 6: 100 tasks of one robot, 50 each of 10, 20 and 30.
    "paper": Preset((1, 10, 20, 30), ("pgf", "or-hitl"), lambda robots: 100 if robots == 1 else 50),
}


_SIZES = ("robots", "policies", "tasks", "scene_class")


@dataclasses.dataclass(frozen=True)
class SweepConfig:
    """Run fleets of several sizes under several policies on the same scenes, and compare them.

    Every robot works through scenes of its own, drawn by (seed, robot, task): they are the same for
    every policy and every fleet size, as are the planner's noise and the operators' service times.

    Attributes:
      preset: quick: robots 1 and 4, 4 tasks each, pgf and or-hitl, tight scenes, none of which can
        be changed; paper: the paper's sizes, 100 tasks of 1 robot, 50 of each of 10, 20 and 30.
      robots: fleet sizes; None: the preset's, or 1 10 20 30.
      policies: pgf, or-hitl, or-hitl-window, always, autonomous, random, queue, classifier,
        oracle-gain (slow: it plans every robot's future twice), or a registered one; None: pgf and
        or-hitl.
      tasks: tasks of each robot; None: the preset's, or 10.
      seed: of scenes, planning noise, service times and ties.
      engine: physics engine: mjx, native, or a registered one.
      physics: default, or the paper's substep and the authors' softness.
      cost: cost variant: the authors' source, or the paper's text.
      update: greedy keeps an iteration's winner (the paper's); stomp blends the noise by weight.
      random_winner: probability with which an iteration's winner is any of the noisy rollouts
        instead of the cheapest: an ablation of the published source's faults.
      scene_class: of the sampled scenes; all: the three in turn; None: tight.
      scenes: folder of scene files (*.xml) to draw the tasks from instead.
      operator: who gives the human input: heuristic, none, or another registered one; replay: who
        did in a recorded session, whose settings are taken over.
      log: of replay: the session's folder, or its event log.
      operators: how many people help the fleet.
      service_mean: mean of the log-normal service time, s.
      service_sd: its standard deviation, s; 0 makes it constant.
      context_switch: added to a service when the operator served another robot before, s.
      window: T_window of Alg. 2, how long bids are collected, s.
      rollout_time: simulated time of one rollout, s; an iteration takes two.
      compute: dedicated (every robot has a computer), or shared:C (all share one of C cores).
      predictor: what pgf bids by: paper or best, as shipped; or a folder of checkpoints, for the
        paper's pair in it, or best:FOLDER.
      horizon: simulated time at which every fleet is stopped, s; None: when its tasks are done.
      workers: processes that share the cells, each on cores of its own; results do not depend on
        it. None: one a core for planar, whose calls use one; else one.
      lanes: L, robots computed in one call; results are bit-equal for equal L only. None: a
        constant of the engine.
      out: folder of the results.
      resume: keep the cells that are finished already, compute the others.
      scheduler: compute on other machines: tcp://HOST:PORT of a Dask scheduler, whose workers have
        one thread each; or slurm:N, to have Slurm start N of them. Needs pgf_jax[cluster].
      json: print a line of JSON for each cell that is finished, and no tables.

    Raises:
      BadInput: a value is none of its kind, or contradicts another. Files, folders and the operator
        are checked by `sweep`.
    """

    preset: Literal["quick", "paper"] | None = None
    robots: tuple[int, ...] | None = None
    policies: tuple[str, ...] | None = None
    tasks: int | None = None
    seed: int = 0
    engine: str = "planar"
    physics: Literal["default", "paper"] = "default"
    cost: Literal["source", "paper"] = "source"
    update: Literal["greedy", "stomp"] = "greedy"
    random_winner: float = 0.0
    scene_class: Literal["tight", "medium", "wide", "all"] | None = None
    scenes: Path | None = None
    operator: str = "heuristic"
    log: Path | None = None
    operators: int = 1
    service_mean: float = 8.0
    service_sd: float = 4.0
    context_switch: float = 0.0
    window: float = 2.0
    rollout_time: float = 1.5
    compute: str = "dedicated"
    predictor: str = "paper"
    horizon: float | None = None
    workers: int | None = None
    lanes: int | None = None
    out: Path = Path("results/sweep")
    resume: bool = False
    scheduler: str | None = None
    json: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        self._check_fixed()
        self._check_scheduler()
        check_choice("engine", self.engine, engine_names())
        if self.scenes is not None and self.scene_class is not None:
            raise BadInput(
                f"scene_class: expected none beside scenes {self.scenes}, got {self.scene_class!r}"
            )
        for name in ("tasks", "operators", "workers", "lanes"):
            if getattr(self, name) is not None:
                check_int(name, getattr(self, name), 1)
        check_int("seed", self.seed, 0, MAX_SEED)
        for name in ("service_mean", "service_sd", "context_switch", "window"):
            check_seconds(name, getattr(self, name), 0.0)
        check_seconds("rollout_time", self.rollout_time, CLOCK_S)
        if self.horizon is not None:
            check_seconds("horizon", self.horizon, CLOCK_S)
        if self.service_mean == 0 and self.service_sd > 0:
            raise BadInput(f"service_sd: expected 0 with service_mean 0, got {self.service_sd!r}")
        try:
            parse_compute(self.compute)
        except ValueError:  # a BadInput is one, and so is a number of too many digits
            raise BadInput(
                f"compute: expected dedicated, or shared:C with C cores, got "
                f"{short_repr(self.compute)}"
            ) from None
        self._check_lists()
        if (self.log is not None) != (self.operator == "replay"):
            raise BadInput(
                f"log: expected with operator replay and only with it, got {self.log} with "
                f"{self.operator!r}"
            )
        for cell in self.cells():
            self.fleet(cell)

    def _check_scheduler(self) -> None:
        if self.scheduler is None:
            return
        if (
            re.fullmatch(r"(tcp|tls)://[^\s/]+:[0-9]+|slurm:[1-9][0-9]{0,4}", self.scheduler)
            is None
        ):
            raise BadInput(
                "scheduler: expected tcp://HOST:PORT (or tls://), or slurm:N with N workers, got "
                f"{short_repr(self.scheduler)}"
            )
        if self.workers is not None:
            raise BadInput(
                f"workers: expected none beside a scheduler, which has its own, got {self.workers}"
            )

    def _check_fixed(self) -> None:
        preset = PRESETS.get(self.preset or "")
        if preset is None or not preset.fixed:
            return
        if self.scenes is not None:
            raise BadInput(f"scenes: the preset {self.preset} samples its own, got {self.scenes}")
        for name in _SIZES:
            given = getattr(self, name)
            fixed = preset.tasks(0) if name == "tasks" else getattr(preset, name)
            if given is not None and given != fixed:
                raise BadInput(
                    f"{name}: fixed at {_words(fixed)} by the preset {self.preset}, "
                    f"got {_words(given)}; leave out one of the two"
                )

    def _check_lists(self) -> None:
        for name in ("robots", "policies"):
            given = getattr(self, name)
            if given is None:
                continue
            if len(given) == 0 or len(set(given)) < len(given):
                raise BadInput(
                    f"{name}: expected one or more, all different, got {_words(given) or 'none'}"
                )
        for robots in self.robots or ():
            check_int("robots", robots, 1)
        for policy in self.policies or ():
            check_choice("policies", policy, [*policy_names()])

    # -- what the fields come to ------------------------------------------------------------------

    def cells(self) -> tuple[Cell, ...]:
        """The cells, by policy, then by fleet size, in the order given."""
        sizes = PRESETS[self.preset] if self.preset is not None else DEFAULT
        return tuple(
            Cell(policy, robots, self.tasks if self.tasks is not None else sizes.tasks(robots))
            for policy in self.policies or sizes.policies
            for robots in self.robots or sizes.robots
        )

    def of_cell(self, cell: Cell) -> dict[str, object]:
        """The settings that decide on one cell, as arguments of a sweep of it alone.

        Without those of how and where it is computed, and without the paths in `INPUTS`.
        """
        own = {
            "robots": [cell.robots],
            "policies": [cell.policy],
            "tasks": cell.tasks,
            "scene_class": self.sampled_class(),
            "lanes": self.engine_lanes(),
        }
        settings = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in HOW + INPUTS
        }
        return settings | own

    def inputs(self) -> dict[str, str | None]:
        """Where the sweep's inputs lie, by field."""
        values = {name: getattr(self, name) for name in INPUTS}
        return {name: None if value is None else str(value) for name, value in values.items()}

    def fleet(self, cell: Cell) -> FleetConfig:
        """The configuration of one cell's fleet."""
        return FleetConfig(
            robots=cell.robots,
            tasks=cell.tasks,
            policy=cell.policy,
            operators=self.operators,
            window_s=self.window,
            service_mean_s=self.service_mean,
            service_sd_s=self.service_sd,
            context_switch_s=self.context_switch,
            rollout_time_s=self.rollout_time,
            rollouts=self.planner().rollouts,
            compute=self.compute,
            horizon_s=self.horizon,
            seed=self.seed,
        )

    def planner(self) -> Planner:
        """The planner's settings."""
        return Planner(
            update=self.update, cost=Cost(variant=self.cost), random_winner=self.random_winner
        )

    def sampled_class(self) -> str | None:
        """The class of the sampled scenes; None where they come from files."""
        return None if self.scenes is not None else self.scene_class or DEFAULT.scene_class

    def engine_lanes(self) -> int:
        """L."""
        return self.lanes if self.lanes is not None else LANES.get(self.engine, OTHER_LANES)

    def processes(self) -> int:
        """Worker processes, if there is work for so many."""
        many = len(cores.usable()) if self.engine == "planar" else 1
        return self.workers or many

    def needs_gains(self) -> bool:
        """Whether some policy bids predicted gains; a policy of the user's own is taken to."""
        return any(cell.policy not in GAINLESS for cell in self.cells())


def _words(value: object) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple | list) else str(value)
