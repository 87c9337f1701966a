"""Settings of `sweep`, its presets and its cells; no JAX here, so that help is instant."""

import dataclasses
import re
from pathlib import Path
from typing import Annotated, Literal

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.fleet.compute import parse_compute
from pgf_jax.fleet.config import (
    CLOCK_OPTIONS,
    INDEX_OPTIONS,
    MEANWHILE_OPTIONS,
    Cell,
    ClockSeconds,
    FleetConfig,
    Gain,
    Meanwhile,
)
from pgf_jax.fleet.policies import check_policy
from pgf_jax.physics.config import Physics, PhysicsName, physics_of
from pgf_jax.physics.engine import check_engine, default_lanes, default_processes
from pgf_jax.physics.worlds.config import WorldName, world_error_of
from pgf_jax.planning.config import (
    PLANNER_OPTIONS,
    SIGMA,
    CostVariant,
    NotNegative,
    Planner,
    Positive,
    Probability,
    Sigma,
    TaskLimit,
    Update,
    planner_of,
)
from pgf_jax.scene import Scene, SceneClass
from pgf_jax.settings import Bounds, CommandLine, Count, Seconds, Seed, check_fields
from pgf_jax.sweeping.presets import DEFAULT, PRESETS

# all: the three of the published scenes in turn; every: all six
SampledClass = Literal[SceneClass, "all", "every"]

# Fields that decide on no result: they say how and where a sweep is computed.
HOW = ("preset", "workers", "scheduler", "out", "resume", "json")
# Fields that say where a sweep's inputs lie; the inputs' content decides on results.
INPUTS = ("scenes", "predictor", "log")
SCENES = "scenes.json"  # in the folder of the results: the scenes that were given as objects
# Policies that need no network that predicts a gain.
GAINLESS = {
    *("autonomous", "or-hitl", "or-hitl+plan", "or-hitl-window", "queue", "always", "random"),
    *("classifier", "oracle-gain"),
    *("time-saved", "gain-rate", "urgency", "oracle-time"),
}


_SERVICE = ("service_mean", "service_sd", "context_switch", *MEANWHILE_OPTIONS, *INDEX_OPTIONS)
_SIZES = ("robots", "policies", "tasks", "scene_class")


@dataclasses.dataclass(frozen=True)
class SweepConfig:
    """Simulate fleets of several sizes under several policies on the same scenes.

    Every robot works through scenes of its own, drawn by (seed, robot, task): they are the same for
    every policy and every fleet size, as are the planner's noise and the operators' service times.
    In Python, `scenes` may also be a list of `Scene`, which is saved beside the results.

    Attributes:
      preset: sizes by name. quick: robots 1 and 4, 4 tasks each, policies pgf and or-hitl, tight
        scenes, none of which can be changed; paper: the sizes of the paper's figure 6, with 100
        tasks of one robot and 50 of each of 10, 20 and 30; None: 10 tasks of each of 1, 10, 20 and
        30 robots.
      robots: fleet sizes; None: those of the preset.
      policies: when robots ask, and who is served: pgf (by predicted gain), or-hitl (when stuck,
        and refused while the operator is busy), or-hitl-window (when stuck, in windows), always
        (before planning), autonomous (never), random, queue (when stuck, in line), classifier (by
        predicted failure), oracle-gain (by the true gain; slow: it plans every robot's future
        twice), pgf+plan and or-hitl+plan (which plan on meanwhile), time-saved, gain-rate and
        urgency (a free operator takes the robot that help saves most time, most time for each
        second of service, or that is least likely to get on alone), oracle-time (time-saved by the
        true times; slow), or a registered one; None: or-hitl, pgf and gain-rate.
      tasks: tasks of each robot; None: those of the preset.
      seed: seed of scenes, planning noise, service times and ties.
      seeds: several seeds, in place of seed: a fleet of each for every policy and fleet size, so
        that the table and the figure can have intervals over fleets; None: seed alone.
      engine: physics engine: planar (fast, disks on a plane), mjx (MuJoCo in JAX), native (MuJoCo
        in C), solid (the solid world; slow), or a registered one.
      physics: physics constants of the engines on the plane: default (fitted to the solid world),
        authors (to the published simulation), or paper (its time step and softness of contacts).
      physics_constants: physics constants that are to be others than those, as in mass=1.2
        object_friction=0.4; the names are the fields of Physics.
      cost: cost terms: source (as the authors' published source has them), or paper (as its text).
      cost_weights: weights and thresholds of the cost that are to be others than the variant's, as
        in w_d=2000 feasible_cost=10; the names are the fields of Cost.
      update: how an iteration changes the best trajectory: greedy takes the cheapest rollout, as
        the paper does; stomp blends the noise of all rollouts by weight.
      random_winner: probability that an iteration takes any of its noisy rollouts instead of the
        cheapest one: an ablation of a fault in the published source. 0 is the paper's.
      rollouts: K, noisy rollouts of an iteration.
      sigma: standard deviations of the noise on the hand's velocity, m/s, m/s and rad/s.
      stomp_h: sensitivity of the weights that update stomp gives to rollouts.
      stuck_count: iterations with hardly any change after which a robot is stuck.
      stuck_change: a change of the cost below this is hardly any.
      stuck_excess: a winner whose cost is above the best one by more than this counts as no change.
      scene_class: class of the sampled scenes: tight, medium, wide, or all (the three in turn);
        crowded, packed (36 and 44 objects), mixed (of different sizes), or every (all six);
        None: tight, or that of the preset.
      scenes: scenes from which the tasks are drawn: a folder of scene files (*.xml, *.json), or a
        file of scenes (*.json). None: scenes are sampled.
      operator: who gives input (what to push where): heuristic (geometry), noisy (heuristic with
        errors), oracle (tries pushes in simulation), clairvoyant (the same with the robot's own
        noise), none, or a registered one; replay: whoever gave it in a recorded session, whose
        settings are taken over.
      log: the session to replay, with operator replay only: its folder, or its event log; None:
        nothing is replayed.
      operators: number of operators who help the fleet.
      service_mean: mean of a simulated operator's log-normal service time, s.
      service_sd: standard deviation of a simulated operator's service time, s; 0 makes it constant.
      context_switch: time added to a service when the operator served another robot before, s.
      window: time for which bids are collected before the highest is served, s (T_window of Alg.
        2).
      bid_threshold: a predicted gain must exceed it to be bid; in units of cost.
      task_limit: simulated time for planning, waiting and interaction in a task, s.
      push_limit: simulated time for planning a push, s, and no more than is left of the task.
      push_execution: simulated time of the execution of a push, s.
      retreat: simulated time of the hand's retreat after a push, s.
      reach_execution: simulated time of the execution of the reach, s.
      rollout_time: simulated time that it takes to compute one rollout, s; an iteration takes two.
      compute: dedicated (each robot has its own computer), or shared:C (all robots share a computer
        with C cores).
      predictor: what predicts the gain of input (the cost that it saves): paper or best, as
        shipped; first or first-best, those that shipped before solutions were checked in a world; a
        folder of checkpoints, for the paper's pair of networks in it; or best:FOLDER.
      horizon: simulated time at which a fleet stops, s; None: when its tasks are done.
      workers: cores of this computer that share the work with planar, processes with other engines;
        results do not depend on how many. None: all cores for planar, else 1.
      world: in which world solutions are checked before a robot executes them, and pushes are
        executed: solid (a shelf in 3-D of our own), scene (that of the scene file), none (the
        engine is believed).
      world_error: how far the world in which robots act is from the one in which they check, drawn
        once a task: default, or spreads as in friction=0.3 mass=0.3 position=0.005 (shares, and m);
        a grasp that misses is planned again. The names are the fields of WorldError.
      while_asking: what a robot does between its ask and the operator's turn: wait, or plan on;
        None: as its policy does.
      while_served: what a robot does until the operator's answer: wait, or plan on; None: as its
        policy does. A robot that is solved meanwhile withdraws its request.
      reservation: index that a robot must exceed to be served by a policy that ranks by time, in
        its unit; None: the policy's own.
      failure_cost: what a task that is not solved costs such a policy beside the time, s.
      lanes: robots computed in one call of the engine (L); results are bit-equal for equal L only.
        None: 64 for planar, 1 for native, else 8.
      out: folder of the results.
      resume: go on with what is in the folder: finished cells are kept, the others are computed.
      scheduler: compute on other machines, by the workers of the Dask scheduler at tcp://HOST:PORT
        (or tls://), or by N workers that Slurm starts (slurm:N); needs pgf_jax[cluster]. None: on
        this computer.
      json: print one JSON object for each finished cell instead of tables.

    Raises:
      BadInput: a value is wrong, or contradicts another. Files, folders and the operator are
        checked by `sweep`.
    """

    preset: Literal["quick", "paper"] | None = None
    robots: tuple[Count, ...] | None = None
    policies: tuple[str, ...] | None = None
    tasks: Count | None = None
    seed: Seed = 0
    engine: str = "planar"
    physics: PhysicsName = "default"
    cost: CostVariant = "source"
    update: Update = "greedy"
    random_winner: Probability = 0.0
    scene_class: SampledClass | None = None
    scenes: Annotated[Path | tuple[Scene, ...] | None, CommandLine(Path | None)] = None
    operator: str = "heuristic"
    log: Path | None = None
    operators: Count = 1
    service_mean: Seconds = 8.0
    service_sd: Seconds = 4.0
    context_switch: Seconds = 0.0
    window: Seconds = 2.0
    rollout_time: ClockSeconds = 1.5
    compute: str = "dedicated"
    predictor: str = "paper"
    horizon: ClockSeconds | None = None
    workers: Count | None = None
    lanes: Count | None = None
    out: Path = Path("results/sweep")
    resume: bool = False
    scheduler: str | None = None
    json: bool = False
    seeds: tuple[Seed, ...] | None = None
    bid_threshold: Gain = 1.0
    task_limit: TaskLimit = 180.0
    push_limit: Seconds = 30.0
    push_execution: Seconds = 3.0
    retreat: Seconds = 1.0
    reach_execution: Seconds = 3.0
    rollouts: Count = 8
    sigma: Sigma = SIGMA
    stomp_h: Positive = 10.0
    stuck_count: Count = 2
    stuck_change: NotNegative = 50.0
    stuck_excess: NotNegative = 1000.0
    cost_weights: tuple[str, ...] = ()
    physics_constants: tuple[str, ...] = ()
    world: WorldName = "solid"
    world_error: tuple[str, ...] = ()
    while_asking: Meanwhile | None = None
    while_served: Meanwhile | None = None
    reservation: Annotated[float, Bounds()] | None = None
    failure_cost: Seconds = 0.0

    GROUPS = (  # of options, for the help
        ("fleet", ("preset", "robots", "policies", "tasks", "seed", "seeds")),
        ("scene", ("scene_class", "scenes")),
        ("planning", (*PLANNER_OPTIONS, "world_error")),
        ("operator", ("operator", "log", "operators", "predictor", *_SERVICE)),
        ("clock", ("window", "bid_threshold", *CLOCK_OPTIONS, "compute", "horizon")),
        ("computing", ("workers", "scheduler")),
        ("output", ("out", "resume", "json")),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.seeds is not None and len(self.seeds) == 1 and self.seed == 0:
            object.__setattr__(self, "seed", self.seeds[0])
            object.__setattr__(self, "seeds", None)
        self._check_fixed()
        self._check_scheduler()
        check_engine(self.engine)
        if self.scenes is not None and self.scene_class is not None:
            where = f" {self.scenes}" if isinstance(self.scenes, Path) else ""
            raise BadInput(
                f"scene_class: expected none beside scenes{where}, got {self.scene_class!r}"
            )
        if self.scenes == ():
            raise BadInput("scenes: expected one or more, got none")
        if self.service_mean == 0 and self.service_sd > 0:
            raise BadInput(f"service_sd: expected 0 with service_mean 0, got {self.service_sd!r}")
        parse_compute(self.compute)
        self._check_lists()
        if (self.log is not None) != (self.operator == "replay"):
            raise BadInput(
                f"log: expected with operator replay and only with it, got {self.log} with "
                f"{self.operator!r}"
            )
        if self.log is not None and self.seeds is not None:
            raise BadInput("seeds: a recorded session has one of its own; leave them out")
        world_error_of(self.world_error, self.world)
        self.planner()
        self.physics_values()
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
            raise BadInput(f"scenes: the preset {self.preset} samples its own; leave them out")
        for name in _SIZES:
            given = getattr(self, name)
            fixed = preset.tasks(0) if name == "tasks" else getattr(preset, name)
            if given is not None and given != fixed:
                raise BadInput(
                    f"{name}: fixed at {_words(fixed)} by the preset {self.preset}, "
                    f"got {_words(given)}; leave out one of the two"
                )

    def _check_lists(self) -> None:
        if self.seeds is not None and self.seed != 0:
            raise BadInput(f"seed: expected none beside seeds, got {self.seed}")
        for name in ("robots", "policies", "seeds"):
            given = getattr(self, name)
            if given is None:
                continue
            if len(given) == 0 or len(set(given)) < len(given):
                raise BadInput(
                    f"{name}: expected one or more, all different, got {_words(given) or 'none'}"
                )
        for policy in self.policies or ():
            check_policy(policy, "policies")

    def cells(self) -> tuple[Cell, ...]:
        """The cells, by policy, then by fleet size, then by seed, in the order given."""
        sizes = PRESETS[self.preset] if self.preset is not None else DEFAULT
        return tuple(
            Cell(policy, robots, self.tasks or sizes.tasks(robots), seed)
            for policy in self.policies or sizes.policies
            for robots in self.robots or sizes.robots
            for seed in self.seeds or (self.seed,)
        )

    def of_cell(self, cell: Cell) -> dict[str, object]:
        """The settings that decide on one cell, as arguments of a sweep of this cell alone.

        The fields in `HOW` and the paths in `INPUTS` are left out.
        """
        own = {
            "robots": [cell.robots],
            "policies": [cell.policy],
            "tasks": cell.tasks,
            "seed": cell.seed,
            "scene_class": self.sampled_class(),
            "lanes": self.engine_lanes(),
        }
        settings = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in (*HOW, *INPUTS, "seeds")
        }
        return settings | own

    def inputs(self) -> dict[str, str | None]:
        """Paths of the sweep's inputs, by field."""
        values = {name: getattr(self, name) for name in INPUTS}
        if isinstance(self.scenes, tuple):
            values["scenes"] = self.out / SCENES
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
            rollouts=self.rollouts,
            compute=self.compute,
            horizon_s=self.horizon,
            bid_threshold=self.bid_threshold,
            task_limit_s=self.task_limit,
            push_limit_s=self.push_limit,
            push_execution_s=self.push_execution,
            retreat_s=self.retreat,
            reach_execution_s=self.reach_execution,
            seed=cell.seed,
            while_asking=self.while_asking,
            while_served=self.while_served,
            reservation=self.reservation,
            failure_cost_s=self.failure_cost,
        )

    def planner(self) -> Planner:
        """The planner's settings."""
        return planner_of(self)

    def physics_values(self) -> Physics:
        """The physics constants."""
        return physics_of(self.physics, self.physics_constants)

    def sampled_class(self) -> str | None:
        """The class of the sampled scenes; None where they come from files."""
        return None if self.scenes is not None else self.scene_class or DEFAULT.scene_class

    def engine_lanes(self) -> int:
        """L, robots in one call of the engine."""
        return self.lanes if self.lanes is not None else default_lanes(self.engine)

    def processes(self) -> int:
        """Worker processes, if there is work for so many."""
        return self.workers or default_processes(self.engine)

    def needs_gains(self) -> bool:
        """Whether some policy bids predicted gains; a registered policy counts as one that does."""
        return any(cell.policy not in GAINLESS for cell in self.cells())


def _words(value: object) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple | list) else str(value)


_NAMES = [field.name for field in dataclasses.fields(SweepConfig)]
# Fields that were added later: stored results lack them, and were made with their defaults.
ADDED = _NAMES[_NAMES.index("json") + 1 :]
