"""Settings of `console`; no JAX here, so that help is instant."""

import dataclasses
import ipaddress
from pathlib import Path
from typing import Annotated, Any

from pgf_jax.errors import BadInput
from pgf_jax.fleet.config import (
    CLOCK_OPTIONS,
    INDEX_OPTIONS,
    MEANWHILE_OPTIONS,
    ClockSeconds,
    Gain,
    Meanwhile,
)
from pgf_jax.fleet.policies import check_policy
from pgf_jax.guidance.operators.registry import operator_names
from pgf_jax.physics.config import PhysicsName
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
)
from pgf_jax.settings import Bounds, Count, Seconds, Seed, check_choice, check_fields
from pgf_jax.sweeping.config import SampledClass, SweepConfig

LOOPBACK = "127.0.0.1"
_SERVICE = ("service_mean", "service_sd", *MEANWHILE_OPTIONS, *INDEX_OPTIONS)
# Settings that a sweep does not have; a sweep has all others under the same name.
_OWN = ("robots", "policy", "speed", "patience", "host", "port")


@dataclasses.dataclass(frozen=True)
class ConsoleConfig:
    """Guide a fleet from a browser: it runs in real time, and asks the person at the page.

    The clock starts when an operator has come. Everything is recorded as it happens: the log
    replays bit for bit (`sweep --operator replay --log OUT`), and a server that was killed goes on
    from it with --resume.

    Attributes:
      robots: fleet size.
      policy: when robots ask, and who is served: pgf (by predicted gain), or-hitl (when stuck, and
        refused while the operator is busy), or-hitl-window (when stuck, in windows), always (before
        planning), autonomous (never), random, queue (when stuck, in line), classifier (by predicted
        failure), oracle-gain (by the true gain; with a simulated operator only), pgf+plan and
        or-hitl+plan (which plan on meanwhile), or a registered one.
      tasks: tasks of each robot.
      speed: simulated seconds in a real second.
      patience: simulated time after which a robot that gets no answer goes on alone, s.
      host: address to listen on; any other than 127.0.0.1 needs the token that is printed.
      port: port to listen on; 0: any free one.
      seed: seed of scenes, planning noise, service times and ties.
      operator: who gives input (what to push where): live (the person at the page), a simulated
        operator (heuristic, noisy, oracle, clairvoyant, none, or a registered one), or replay
        (whoever gave it in a recorded session, to watch).
      log: the session to replay, with operator replay only: its folder, or its event log; None:
        nothing is replayed.
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
      compute: dedicated (each robot has its own computer), or shared:C (all robots share a computer
        with C cores).
      horizon: simulated time at which a fleet stops, s; None: when its tasks are done.
      predictor: what predicts the gain of input (the cost that it saves): paper or best, as
        shipped; first or first-best, those that shipped before solutions were checked in a world; a
        folder of checkpoints, for the paper's pair of networks in it; or best:FOLDER.
      scene_class: class of the sampled scenes: tight, medium, wide, or all (the three in turn);
        crowded, packed (36 and 44 objects), mixed (of different sizes), or every (all six);
        None: tight.
      scenes: scenes from which the tasks are drawn: a folder of scene files (*.xml, *.json), or a
        file of scenes (*.json). None: scenes are sampled.
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
      world: in which world solutions are checked before a robot executes them, and pushes are
        executed: solid (a shelf in 3-D of our own), scene (that of the scene file), none (the
        engine is believed).
      while_asking: what a robot does between its ask and the operator's turn: wait, or plan on;
        None: as its policy does.
      while_served: what a robot does until the operator's answer: wait, or plan on; None: as its
        policy does. A robot that is solved meanwhile withdraws its request.
      reservation: index that a robot must exceed to be served by a policy that ranks by time, in
        its unit; None: the policy's own.
      failure_cost: what a task that is not solved costs such a policy beside the time, s.
      lanes: robots computed in one call of the engine (L); results are bit-equal for equal L only.
        None: 64 for planar, 1 for native, else 8.
      out: folder of the session: its event log, written as it happens, and its tables at the end.
      resume: go on with what is in the folder: the session whose server was killed.
    """

    robots: Annotated[int, Bounds(1, 100)] = 6
    policy: str = "pgf"
    tasks: Count = 10
    speed: Annotated[float, Bounds(1e-3)] = 1.0
    patience: Annotated[float, Bounds(1e-3, unit="seconds")] = 60.0
    host: str = LOOPBACK
    port: Annotated[int, Bounds(0, 65535)] = 8080
    seed: Seed = 0
    operator: str = "live"
    log: Path | None = None
    service_mean: Seconds = 8.0
    service_sd: Seconds = 4.0
    window: Seconds = 2.0
    rollout_time: ClockSeconds = 1.5
    compute: str = "dedicated"
    horizon: ClockSeconds | None = None
    predictor: str = "paper"
    scene_class: SampledClass | None = None
    scenes: Path | None = None
    engine: str = "planar"
    physics: PhysicsName = "default"
    cost: CostVariant = "source"
    update: Update = "greedy"
    random_winner: Probability = 0.0
    lanes: Count | None = None
    out: Path = Path("results/session")
    resume: bool = False
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
    while_asking: Meanwhile | None = None
    while_served: Meanwhile | None = None
    reservation: Annotated[float, Bounds()] | None = None
    failure_cost: Seconds = 0.0

    GROUPS = (  # of options, for the help
        ("fleet", ("robots", "policy", "tasks", "seed")),
        ("scene", ("scene_class", "scenes")),
        ("planning", PLANNER_OPTIONS),
        ("operator", ("operator", "log", "patience", "predictor", *_SERVICE)),
        ("clock", ("speed", "window", "bid_threshold", *CLOCK_OPTIONS, "compute", "horizon")),
        ("server", ("host", "port")),
        ("output", ("out", "resume")),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        check_host(self.host)
        check_choice("operator", self.operator, ["live", "replay", *operator_names()])
        check_policy(self.policy)
        if self.policy == "oracle-gain" and self.operator in ("live", "replay"):
            raise BadInput(
                "policy: oracle-gain asks the operator at every iteration what they would say; "
                f"expected another one with operator {self.operator}"
            )
        if self.resume and self.operator != "live":
            raise BadInput(f"resume: only live sessions are resumed, got {self.operator!r}")
        self.sweep()

    def sweep(self) -> SweepConfig:
        """The sweep of one cell that has the session's settings; its operator may be `live`."""
        settings: dict[str, Any] = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in _OWN
        }
        return SweepConfig(robots=(self.robots,), policies=(self.policy,), **settings)

    @property
    def needs_token(self) -> bool:
        """Whether other computers can connect."""
        return not ipaddress.ip_address(self.host).is_loopback


def check_host(host: str) -> None:
    """BadInput unless `host` is an address to listen on."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        raise BadInput(
            f"host: expected an address such as {LOOPBACK} or 0.0.0.0, got {host!r}"
        ) from None
