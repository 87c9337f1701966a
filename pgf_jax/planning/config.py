"""Static settings of cost and planner; no JAX here, the command line is built from them."""

import dataclasses
from typing import Literal, Protocol

from pgf_jax.errors import BadInput
from pgf_jax.physics.engine import engine_names
from pgf_jax.settings import check_choice, check_int


@dataclasses.dataclass(frozen=True)
class Cost:
    """Cost weights and thresholds (D3). `source` follows the authors' published source.

    `paper` is the text of the paper: c_d = w_d |ee - goal|, c_f = w_f F over all contacts without a
    threshold, no edge or static term; it gives no number for feasible, so there it is
    d(goal) < 0.06 and c_b = 0.
    """

    variant: Literal["source", "paper"] = "source"
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
    """Settings of Alg. 1 (D4)."""

    rollouts: int = 8  # K
    update: Literal["greedy", "stomp"] = "greedy"
    sigma: tuple[float, float, float] = (0.04, 0.04, 0.04)  # m/s, m/s, rad/s: standard deviations
    stomp_h: float = 10.0
    stuck_count: int = 2
    stuck_change: float = 50.0
    stuck_excess: float = 1000.0
    # q, of an iteration's winner being any of the K: an ablation, for the published rollouts share
    # one simulator object, which makes the source's choice among the K partly random (D9).
    random_winner: float = 0.0
    cost: Cost = dataclasses.field(default_factory=Cost)

    def __post_init__(self) -> None:
        if self.rollouts < 1:
            raise BadInput(f"rollouts: expected a positive number, got {self.rollouts}")
        if self.update not in ("greedy", "stomp"):
            raise BadInput(f"update: expected greedy or stomp, got {self.update!r}")
        q = self.random_winner
        if not isinstance(q, int | float) or isinstance(q, bool) or not 0 <= q <= 1:
            raise BadInput(f"random_winner: expected a number within 0..1, got {q!r}")
        if q > 0 and self.update == "stomp":
            raise BadInput(f"random_winner: expected 0 with update stomp (no winner), got {q!r}")
        if self.cost.variant not in ("source", "paper"):
            raise BadInput(f"cost: expected source or paper, got {self.cost.variant!r}")


class Planning(Protocol):
    """Settings of planning that several commands share."""

    @property
    def engine(self) -> str:
        """Physics engine."""
        ...

    @property
    def physics(self) -> str:
        """Name of the physics constants."""
        ...

    @property
    def cost(self) -> Literal["source", "paper"]:
        """Cost variant."""
        ...

    @property
    def update(self) -> Literal["greedy", "stomp"]:
        """How an iteration changes the best trajectory."""
        ...

    @property
    def lanes(self) -> int | None:
        """L."""
        ...


def check_planning(config: Planning) -> None:
    """BadInput unless the engine, physics, cost, update and lanes of `config` exist."""
    check_choice("engine", config.engine, engine_names())
    check_choice("physics", config.physics, ["default", "paper"])
    check_choice("cost", config.cost, ["source", "paper"])
    check_choice("update", config.update, ["greedy", "stomp"])
    check_int("lanes", config.lanes, 1)
