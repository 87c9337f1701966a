"""When a person is asked: `after:N` and `once-after:N` on stub robots, worked by hand."""

import pytest
from registered import registered

from pgf_jax.errors import BadInput
from pgf_jax.fleet import Fleet, FleetConfig, TaskRecord
from pgf_jax.fleet.policies import after, check_ask, once_after
from pgf_jax.fleet.robots import Work
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.guidance.operators.base import NoOperator
from pgf_jax.guidance.operators.registry import OPERATORS
from pgf_jax.planning.types import Push, Status
from pgf_jax.plans.config import PlanConfig

PUSH = Push(0, 0.4, 0.1)


def run(policy: str, iterate, decide=lambda work: None, limit_s: float = 60.0) -> TaskRecord:
    """One robot, one task, inputs of 8 s."""
    robots = StubRobots(iterate, decide)
    config = FleetConfig(tasks=1, policy=policy, service_sd_s=0.0, task_limit_s=limit_s)
    fleet = Fleet(config, robots)
    drive([(fleet, robots)])
    (record,) = fleet.records
    return record


def never_feasible(work: Work):
    return outcome()


def test_after_2_asks_after_every_second_iteration_when_told_to_go_on():
    # Iterations 0, 1, 2 end at 1.5, 4.5, 7.5 s; input until 15.5. Then 3, 4 at 18.5, 21.5; input
    # until 29.5; 5, 6 at 35.5; until 43.5; 7, 8 at 49.5; until 57.5, and no iteration ends by 60.
    record = run(after(2), never_feasible)
    assert record.grants_at == (2, 4, 6, 8)
    assert record.planning_time_s == 1.5 + 8 * 3.0
    assert record.interaction_s == 4 * 8.0
    assert record.refusals == 0
    assert record.end_ns == 57_500_000_000
    assert record.status is Status.TIMED_OUT


def test_after_2_counts_from_the_restart_after_a_push():
    # Work numbers: reach 0, 1, 2; the push's nominal is 3, feasible at once; reach again 4, 5, 6.
    record = run(
        after(2),
        lambda work: outcome(feasible=work.iteration == 3),
        lambda work: PUSH if work.request == 0 else None,
        limit_s=40.0,
    )
    # Asks at 7.5 s; push planned 15.5..17, executed until 21; iterations 0, 1, 2 end at 22.5, 25.5,
    # 28.5: the second ask, although two iterations of the task had passed at 22.5 too. Its input
    # comes at 36.5, the limit (put off by the 4 s of execution) is at 44: two more iterations.
    assert record.successful_grants_at == (2,)
    assert record.grants_at == (2, 4)
    assert record.reach_iterations == 6
    assert record.iterations == 6


def test_after_1_counts_from_the_restart_after_a_dropped_push():
    # The push is never feasible: it is given up after 30 s, and reaching restarts.
    record = run(
        after(1),
        never_feasible,
        lambda work: PUSH if work.request == 0 else None,
        limit_s=50.0,
    )
    # Ask at 4.5, input at 12.5, pushing until 12.5 + 1.5 + 9 * 3 = 41 (the tenth would end at 44,
    # after 42.5); reaching restarts: 42.5, 45.5: the second ask, with 1 + 1 reach iterations. At
    # 42.5 one iteration of the task had passed too. The second input would come after the limit.
    assert record.grants_at == (1, 2)
    assert record.expired == 1
    assert record.pushes_succeeded == 0


def test_after_0_asks_right_after_the_nominal():
    record = run(after(0), never_feasible, limit_s=12.0)
    assert record.grants_at == (0,)


def test_after_n_asks_nothing_where_the_reach_is_feasible_first():
    record = run(after(2), lambda work: outcome(feasible=work.iteration == 2))
    assert record.requests == 0
    assert record.status is Status.SOLVED


def test_after_n_does_not_ask_because_the_robot_is_stuck():
    record = run(after(3), lambda work: outcome(stuck=True), limit_s=11.0)
    assert record.reach_iterations == 3  # at 10.5 s, when no time is left to ask
    assert record.requests == 0


def test_once_after_3_asks_once():
    record = run(once_after(3), lambda work: outcome(stuck=True))
    assert record.grants_at == (3,)
    assert record.requests == 1


@pytest.mark.parametrize(("ask", "n"), [("stuck", 0), ("after:0", 0), ("after:12", 12)])
def test_ask_is_read(ask, n):
    assert check_ask(ask) == n


@pytest.mark.parametrize("ask", ["", "after", "after:", "after:-1", "after:1.5", "after:٣", "now"])
def test_a_wrong_ask_is_refused(ask):
    with pytest.raises(BadInput, match="ask: expected stuck, gain, never or after:N"):
        PlanConfig(ask=ask)


@pytest.mark.parametrize(
    ("operator", "ask", "policy"),
    [
        ("none", "stuck", "autonomous"),
        ("none", "after:3", "autonomous"),
        ("somebody", "never", "autonomous"),
        ("somebody", "stuck", "or-hitl"),
        ("somebody", "gain", "pgf"),
        ("somebody", "after:3", "after:3"),
    ],
)
def test_asks_name_policies(operator, ask, policy):
    with registered(OPERATORS, somebody=NoOperator):
        assert PlanConfig(operator=operator, ask=ask).policy == policy
