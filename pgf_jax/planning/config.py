"""Settings of the cost and the planner; no JAX here, since the command line reads them."""

import dataclasses
from typing import Annotated, Literal, Protocol

from pgf_jax.errors import BadInput
from pgf_jax.settings import Bounds, Count, check_choice, check_fields, named_values

CostVariant = Literal["source", "paper"]
Update = Literal["greedy", "stomp"]
Probability = Annotated[float, Bounds(0, 1)]
# The rollout of the nominal trajectory takes 1.5 s: no task takes less.
TaskLimit = Annotated[float, Bounds(1.5, unit="seconds")]
Positive = Annotated[float, Bounds(above=0)]
NotNegative = Annotated[float, Bounds(0)]
Range = Annotated[tuple[float, float], Bounds()]  # low and high
Sigma = Annotated[tuple[float, float, float], Bounds(0)]
EDGE_X, EDGE_Y = (0.20, 0.58), (-0.38, 0.38)  # m, where the centre of an object is on the shelf
# Raised by whoever changes what the planner computes: it is in the identity of a sweep's cells.
PLANNER_REVISION = 1
# Options of the commands that plan, in their order in the help.
PLANNER_OPTIONS = (
    *("engine", "world", "physics", "physics_constants", "cost", "cost_weights", "update"),
    *("random_winner", "rollouts"),
    *("sigma", "stomp_h", "stuck_count", "stuck_change", "stuck_excess", "lanes"),
)
SIGMA = (0.04, 0.04, 0.04)  # m/s, m/s, rad/s


@dataclasses.dataclass(frozen=True)
class Cost:
    """Weights and thresholds of the cost terms (Papallas & Dogar 2022).

    Variant `source`, the default, follows the authors' published source, with an edge and a static
    term that the paper does not have. Variant `paper` follows the text of the paper:
    c_d = w_d |ee - goal|, c_f = w_f F over all contacts without a threshold, and no edge or static
    term. The text gives no number for feasible, so there it is d(goal) < 0.06 and c_b = 0.
    """

    variant: CostVariant = "source"
    w_d: NotNegative = 4000.0  # per m
    w_f: NotNegative = 0.3  # per N above `force_threshold`
    w_f_paper: NotNegative = 30.0  # per N
    w_b: NotNegative = 450.0  # per blocking object
    w_h: NotNegative = 300.0  # per m (the source: 4000)
    w_edge: NotNegative = 300.0  # per object and violated axis, each knot
    w_static: NotNegative = 300.0  # per knot in which the robot touches the shelf
    force_threshold: NotNegative = 40.0  # N
    force_not_finite: NotNegative = 30.0
    bearing_m_per_rad: NotNegative = 0.09
    goal_radius: NotNegative = 0.06  # m, with the bearing counted in
    blocking_radius: NotNegative = 0.075  # m, likewise
    target_radius: NotNegative = 0.05  # m, pushed object to its target
    feasible_cost: NotNegative = 20.0
    edge_x: Range = EDGE_X
    edge_y: Range = EDGE_Y


@dataclasses.dataclass(frozen=True)
class Planner:
    """Settings of the planner (Papallas & Dogar 2022, Alg. 1)."""

    rollouts: Count = 8  # K
    update: Update = "greedy"
    # Standard deviations of the noise, as in the published source (the paper says variances).
    sigma: Sigma = SIGMA
    stomp_h: Positive = 10.0
    stuck_count: Count = 2
    stuck_change: NotNegative = 50.0
    stuck_excess: NotNegative = 1000.0
    # q, the probability that an iteration's winner is any of the K rollouts. This is an ablation:
    # the published source's rollouts share one simulator object, so that its choice among the K is
    # partly random.
    random_winner: Probability = 0.0
    cost: Cost = dataclasses.field(default_factory=Cost)

    def __post_init__(self) -> None:
        check_fields(self)
        check_choice("cost", self.cost.variant, ["source", "paper"])
        check_fields(self.cost)
        if len(self.sigma) != 3:
            raise BadInput(f"sigma: expected three numbers (x, y, turn), got {self.sigma}")
        if self.random_winner > 0 and self.update == "stomp":
            raise BadInput(
                "random_winner: expected 0 with update stomp (no winner), "
                f"got {self.random_winner!r}"
            )


class Planning(Protocol):
    """Settings of planning that several commands have in common."""

    @property
    def engine(self) -> str:
        """Physics engine."""
        ...

    @property
    def physics(self) -> str:
        """Name of the physics constants."""
        ...

    @property
    def physics_constants(self) -> tuple[str, ...]:
        """Physics constants that differ from those named by `physics`, as NAME=VALUE."""
        ...

    @property
    def cost(self) -> CostVariant:
        """Cost variant."""
        ...

    @property
    def update(self) -> Update:
        """How an iteration changes the best trajectory."""
        ...

    @property
    def cost_weights(self) -> tuple[str, ...]:
        """Weights and thresholds of the cost that differ from `Cost`, as NAME=VALUE."""
        ...

    @property
    def rollouts(self) -> int:
        """K, noisy rollouts of an iteration."""
        ...

    @property
    def sigma(self) -> tuple[float, float, float]:
        """Standard deviations of the noise, m/s, m/s, rad/s."""
        ...

    @property
    def random_winner(self) -> float:
        """See `Planner`."""
        ...

    @property
    def stomp_h(self) -> float:
        """See `Planner`."""
        ...

    @property
    def stuck_count(self) -> int:
        """See `Planner`."""
        ...

    @property
    def stuck_change(self) -> float:
        """See `Planner`."""
        ...

    @property
    def stuck_excess(self) -> float:
        """See `Planner`."""
        ...

    @property
    def lanes(self) -> int | None:
        """Robots in one call of the engine, L; None: the command's own number."""
        ...


_WEIGHTS = {field.name: field.default for field in dataclasses.fields(Cost)[1:]}


def planner_of(config: Planning) -> Planner:
    """The planner's settings, out of a command's; BadInput where they cannot be."""
    weights = named_values("cost_weights", config.cost_weights, _WEIGHTS)
    return Planner(
        rollouts=config.rollouts,
        update=config.update,
        sigma=config.sigma,
        stomp_h=config.stomp_h,
        stuck_count=config.stuck_count,
        stuck_change=config.stuck_change,
        stuck_excess=config.stuck_excess,
        random_winner=config.random_winner,
        cost=Cost(variant=config.cost, **weights),
    )
