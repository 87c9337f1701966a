"""Settings of `plan`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pgf_jax.errors import BadInput
from pgf_jax.fleet.config import CLOCK_OPTIONS, ClockSeconds, FleetConfig, Gain
from pgf_jax.fleet.policies import after, check_ask
from pgf_jax.guidance.operators.registry import check_operator
from pgf_jax.physics.config import PhysicsName, physics_of
from pgf_jax.physics.engine import check_engine
from pgf_jax.physics.worlds.config import WorldName, world_error_of
from pgf_jax.planning.config import (
    PLANNER_OPTIONS,
    SIGMA,
    CostVariant,
    NotNegative,
    Positive,
    Probability,
    Sigma,
    TaskLimit,
    Update,
    planner_of,
)
from pgf_jax.scene import SceneClass
from pgf_jax.settings import MAX_SEED, Count, Seconds, Seed, check_fields, check_int


@dataclasses.dataclass(frozen=True)
class PlanConfig:
    """How scenes are planned; BadInput where a value is wrong.

    Attributes:
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
      operator: who gives input (what to push where): heuristic (geometry), noisy (heuristic with
        errors), oracle (tries pushes in simulation), clairvoyant (the same with the robot's own
        noise), none, or a registered one.
      ask: when the robot asks for input: stuck, gain (the predicted gain is high enough), after:N
        (after N reach iterations since each restart or input), or never.
      world: in which world solutions are checked before a robot executes them, and pushes are
        executed: solid (a shelf in 3-D of our own), scene (that of the scene file), none (the
        engine is believed).
      lanes: robots computed in one call of the engine (L); results are bit-equal for equal L only.
      predictor: what predicts the gain of input (the cost that it saves): paper or best, as
        shipped; first or first-best, those that shipped before solutions were checked in a world; a
        folder of checkpoints, for the paper's pair of networks in it; or best:FOLDER.
      service_mean: mean of a simulated operator's log-normal service time, s.
      service_sd: standard deviation of a simulated operator's service time, s; 0 makes it constant.
      window: time for which bids are collected before the highest is served, s (T_window of Alg.
        2).
      bid_threshold: a predicted gain must exceed it to be bid; in units of cost.
      task_limit: simulated time for planning, waiting and interaction in a task, s.
      push_limit: simulated time for planning a push, s, and no more than is left of the task.
      push_execution: simulated time of the execution of a push, s.
      retreat: simulated time of the hand's retreat after a push, s.
      reach_execution: simulated time of the execution of the reach, s.
      rollout_time: simulated time that it takes to compute one rollout, s; an iteration takes two.
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
    window: Seconds = 2.0
    bid_threshold: Gain = 1.0
    push_limit: Seconds = 30.0
    rollout_time: ClockSeconds = 1.5
    push_execution: Seconds = 3.0
    retreat: Seconds = 1.0
    reach_execution: Seconds = 3.0
    random_winner: Probability = 0.0
    rollouts: Count = 8
    sigma: Sigma = SIGMA
    stomp_h: Positive = 10.0
    stuck_count: Count = 2
    stuck_change: NotNegative = 50.0
    stuck_excess: NotNegative = 1000.0
    cost_weights: tuple[str, ...] = ()
    physics_constants: tuple[str, ...] = ()
    world: WorldName = "solid"

    def __post_init__(self) -> None:
        check_fields(self)
        check_engine(self.engine)
        check_operator(self.operator)
        check_ask(self.ask)
        self.fleet(0)
        planner_of(self)
        physics_of(self.physics, self.physics_constants)

    @property
    def policy(self) -> str:
        """The fleet policy of `ask`; without an operator nothing is asked."""
        if self.operator == "none" or self.ask == "never":
            return "autonomous"
        if self.ask.startswith("after:"):
            return after(check_ask(self.ask))
        # One robot has its operator for itself: an ask when stuck is granted at once.
        return {"stuck": "or-hitl", "gain": "pgf"}[self.ask]

    def fleet(self, seed: int) -> FleetConfig:
        """The fleet of one robot with one task that a plan is."""
        return FleetConfig(
            robots=1,
            tasks=1,
            policy=self.policy,
            window_s=self.window,
            service_mean_s=self.service_mean,
            service_sd_s=self.service_sd,
            rollout_time_s=self.rollout_time,
            rollouts=self.rollouts,
            bid_threshold=self.bid_threshold,
            task_limit_s=self.task_limit,
            push_limit_s=self.push_limit,
            push_execution_s=self.push_execution,
            retreat_s=self.retreat,
            reach_execution_s=self.reach_execution,
            seed=seed,
        )


@dataclasses.dataclass(frozen=True)
class PlanCommand:
    """Plan scenes, from files or sampled, all in one batch.

    A scene that is not solved has a plan too: the best one that was found.

    Attributes:
      scene: scene files to plan: one's own (*.json), or the authors' published MJCF (*.xml), in
        which object_3 is the goal.
      scene_class: sample scenes of this class instead of reading files: tight, medium or wide;
        crowded, packed (36 and 44 objects), mixed (of different sizes); None: the files' scenes.
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
        ("planning", PLANNER_OPTIONS),
        ("operator", ("operator", "ask", "predictor", "service_mean", "service_sd")),
        ("clock", ("window", "bid_threshold", *CLOCK_OPTIONS)),
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


@dataclasses.dataclass(frozen=True)
class ExecuteConfig:
    """How plans are executed; BadInput where a value is wrong.

    Attributes:
      world: in which world: solid (a shelf in 3-D of our own) or scene (that of the scene file);
        None: the one in which the plan was checked, or else solid.
      world_error: how far that world is from the one in which the plan was checked, drawn once for
        each repeat: default, or spreads as in friction=0.3 mass=0.3 position=0.005 (shares, and m);
        the names are the fields of WorldError.
      repeats: how often each plan is executed, each time under another draw of the world's error.
      scenes: folder of the scene files (*.xml), for world scene; None: there is none.
    """

    world: Literal["solid", "scene"] | None = None
    world_error: tuple[str, ...] = ()
    repeats: Count = 1
    scenes: Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        world_error_of(self.world_error, self.world or "solid")
        if self.repeats > 1 and not self.world_error:
            raise BadInput(
                f"repeats: expected with world_error only, got {self.repeats}: without one all "
                "executions of a plan are the same"
            )


@dataclasses.dataclass(frozen=True)
class ExecuteCommand:
    """Execute plans in a world in three dimensions, and say whether they grasp their goals.

    Attributes:
      plans: files of plans, NAME.plan.json.
      out: folder for a table of the executions, executions.parquet; None: none is written.
      json: print one JSON object instead of a table.
      config: how the plans are executed.
    """

    plans: tyro.conf.Positional[tuple[Path, ...]] = ()
    out: Path | None = None
    json: bool = False
    config: Annotated[ExecuteConfig, tyro.conf.arg(name="")] = dataclasses.field(
        default_factory=ExecuteConfig
    )

    GROUPS = (  # of options, for the help
        ("world", ("world", "world_error", "repeats", "scenes")),
        ("output", ("out", "json")),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.plans:
            raise BadInput("plans: expected one or more files of plans, got none")
