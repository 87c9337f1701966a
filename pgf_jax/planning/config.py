"""Settings of the cost and the planner; no JAX here, since the command line reads them."""

import dataclasses
from typing import Annotated, Literal, Protocol

from pgf_jax.errors import BadInput
from pgf_jax.settings import Bounds, Count, check_choice, check_fields

CostVariant = Literal["source", "paper"]
Update = Literal["greedy", "stomp"]
Probability = Annotated[float, Bounds(0, 1)]
# The rollout of the nominal trajectory takes 1.5 s: no task takes less.
TaskLimit = Annotated[float, Bounds(1.5, unit="seconds")]


@dataclasses.dataclass(frozen=True)
class Cost:
    """Weights and thresholds of the cost terms (Papallas & Dogar 2022).

    Variant `source`, the default, follows the authors' published source, with an edge and a static
    term that the paper does not have. Variant `paper` follows the text of the paper:
    c_d = w_d |ee - goal|, c_f = w_f F over all contacts without a threshold, and no edge or static
    term. The text gives no number for feasible, so there it is d(goal) < 0.06 and c_b = 0.
    """

    variant: CostVariant = "source"
    w_d: float = 4000.0  # per m
    w_f: float = 0.3  # per N above `force_threshold`
    w_f_paper: float = 30.0  # per N
    w_b: float = 450.0  # per blocking object
    w_h: float = 300.0  # per m (the source: 4000)
    w_edge: float = 300.0  # per object and violated axis, each knot
    w_static: float = 300.0  # per knot in which the robot touches the shelf
    force_threshold: float = 40.0  # N
    force_not_finite: float = 30.0
    bearing_m_per_rad: float = 0.09
    goal_radius: float = 0.06  # m, with the bearing counted in
    blocking_radius: float = 0.075  # m, likewise
    target_radius: float = 0.05  # m, pushed object to its target
    feasible_cost: float = 20.0
    edge_x: tuple[float, float] = (0.20, 0.58)  # m
    edge_y: tuple[float, float] = (-0.38, 0.38)  # m


@dataclasses.dataclass(frozen=True)
class Planner:
    """Settings of the planner (Papallas & Dogar 2022, Alg. 1)."""

    rollouts: Count = 8  # K
    update: Update = "greedy"
    # m/s, m/s, rad/s: standard deviations, as in the published source (the paper says variances)
    sigma: tuple[float, float, float] = (0.04, 0.04, 0.04)
    stomp_h: float = 10.0
    stuck_count: int = 2
    stuck_change: float = 50.0
    stuck_excess: float = 1000.0
    # q, the probability that an iteration's winner is any of the K rollouts. This is an ablation:
    # the published source's rollouts share one simulator object, so that its choice among the K is
    # partly random.
    random_winner: Probability = 0.0
    cost: Cost = dataclasses.field(default_factory=Cost)

    def __post_init__(self) -> None:
        check_fields(self)
        check_choice("cost", self.cost.variant, ["source", "paper"])
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
    def cost(self) -> CostVariant:
        """Cost variant."""
        ...

    @property
    def update(self) -> Update:
        """How an iteration changes the best trajectory."""
        ...

    @property
    def lanes(self) -> int | None:
        """Robots in one call of the engine, L; None: the command's own number."""
        ...
