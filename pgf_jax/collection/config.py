"""Settings of `collect`; no JAX here, so that help is instant."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators.registry import check_operator
from pgf_jax.physics.config import PhysicsName, physics_of
from pgf_jax.physics.engine import check_engine, default_lanes
from pgf_jax.physics.worlds.config import WorldName
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
from pgf_jax.scene import PRESETS, PUBLISHED_CLASSES, SceneClass
from pgf_jax.settings import MAX_SEED, Count, Index, Seed, check_fields, check_int

_BESIDE_LOG = ("mode", "out", "log", "resume")


Classes = tuple[SceneClass, ...]


@dataclasses.dataclass(frozen=True)
class CollectConfig:
    """Plan sampled scenes, or replay sessions, and keep every iteration, to train on.

    Attributes:
      mode: autonomous (nobody helps), human (input is given once in each run that lasts so long),
        forks (a state of each such run is carried on with input and without, for the true gain), or
        futures (the same, until it is solved or the task's time is up).
      out: folder of the data: autonomous/runs.parquet, human/runs.parquet, forks/forks.parquet or
        futures/futures.parquet.
      scenes: how many scenes to sample; None: none, with --log.
      log: recorded sessions to take human runs from, instead of planning scenes: their folders, or
        event logs. They have their own settings, so that no others can be given.
      classes: classes of the sampled scenes, in turn: tight, medium, wide, crowded, packed, mixed.
      seed: seed of the first scene and its noise; the next scenes count on from there.
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
      operator: who gives input (what to push where) in human runs and forks: heuristic (geometry),
        noisy (heuristic with errors), oracle (tries pushes in simulation), clairvoyant (the same
        with the robot's own noise), or a registered one.
      world: in which world solutions are checked before a robot executes them, and pushes are
        executed: solid (a shelf in 3-D of our own), scene (that of the scene file), none (the
        engine is believed).
      lanes: robots computed in one call of the engine (L); results are bit-equal for equal L only.
        None: 64 for planar, 1 for native, else 8.
      task_limit: simulated time for planning, waiting and interaction in a task, s. The default
        ends an unsolved run after reach iteration 39; in human runs at least 10 reach iterations
        (the predictors' look-ahead) after the input, however long its push took to plan.
      ask_from: human: input comes after a reach iteration drawn evenly from ask_from..ask_to, of
        which the third is the first with a full history; forks and futures: states are drawn from
        the unsolved ones among these.
      ask_to: the last of these reach iterations.
      keys: forks and futures: number of futures of each state, each under noise of its own, with
        input and without.
      workers: cores of this computer that share the work with planar, processes with other engines;
        results do not depend on how many. None: all cores for planar, else 1.
      chunk: finished runs are written this many at a time: as many can be lost by an interruption.
      resume: go on with what is in the folder: finished runs are kept, the others are planned.
      states: forks and futures: how many states of each scene, where it has as many.
    """

    mode: tyro.conf.Positional[Literal["autonomous", "human", "forks", "futures"]]
    out: Path
    scenes: Annotated[Count | None, tyro.conf.arg(aliases=["--count"])] = None
    log: tuple[Path, ...] = ()
    classes: Annotated[Classes, tyro.conf.arg(aliases=["--scene-classes"])] = PUBLISHED_CLASSES
    seed: Seed = 0
    engine: str = "planar"
    physics: PhysicsName = "default"
    cost: CostVariant = "source"
    update: Update = "greedy"
    operator: str = "heuristic"
    lanes: Count | None = None
    task_limit: TaskLimit = 120.0
    ask_from: Index = 3
    ask_to: Index = 12
    keys: Count = 8
    workers: Count | None = None
    chunk: Count = 20
    resume: bool = False
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
    states: Count = 1

    GROUPS = (  # of options, for the help
        ("scene", ("scenes", "classes", "seed", "log")),
        ("planning", (*PLANNER_OPTIONS, "task_limit")),
        ("operator", ("operator", "ask_from", "ask_to", "keys", "states")),
        ("computing", ("workers", "chunk")),
        ("output", ("out", "resume")),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.log:
            self._check_log()
            return
        if self.scenes is None:
            raise BadInput("scenes: expected how many (or log, with recorded sessions), got none")
        check_int("seed", self.seed, 0, MAX_SEED - self.scenes + 1)
        if self.lanes is None:
            object.__setattr__(self, "lanes", default_lanes(self.engine))
        check_engine(self.engine)
        planner_of(self)
        physics_of(self.physics, self.physics_constants)
        if self.mode != "autonomous":
            check_operator(self.operator)
            if self.operator == "none":
                raise BadInput(f"operator: {self.mode} runs need one that gives input, got 'none'")
        if not self.classes:
            raise BadInput(f"classes: expected one or more of {', '.join(PRESETS)}, got none")
        if len(set(self.classes)) != len(self.classes):
            raise BadInput(f"classes: expected each at most once, got {' '.join(self.classes)}")
        # Forks are described by a full history.
        check_int("ask_from", self.ask_from, 3 if self.forks else 0)
        check_int("ask_to", self.ask_to, self.ask_from)

    @property
    def forks(self) -> bool:
        """Whether states are forked."""
        return self.mode in ("forks", "futures")

    def _check_log(self) -> None:
        if self.mode != "human":
            raise BadInput(f"log: expected with mode human only, got {self.mode}")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name not in _BESIDE_LOG and value != field.default:
                raise BadInput(
                    f"{field.name}: expected none beside log (sessions have their own settings), "
                    f"got {value!r}"
                )
