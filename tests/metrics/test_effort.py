"""Metrics of human effort, against a fleet done by hand."""

import math

import pytest
from fleet_script import PUSH, run

from pgf_jax.metrics.effort import effort, extra_solved_per_minute


def test_by_hand():
    """Robot 0 is stuck at 4.5 and served until 12.5; robot 1, stuck at 7.5, waits until then."""
    fleet, _ = run({0: ". s f", 1: ". . s f"}, robots=2, policy="queue", service=8.0)
    got = effort(fleet.config, fleet.records, fleet.events)
    assert (got.services, got.switches) == (2, 1)
    assert got.operator_minutes == pytest.approx(16 / 60)
    assert got.return_on_effort == pytest.approx(2 / (16 / 60))
    assert got.interaction_time_s == 8.0
    assert got.wait_in_queue_s == pytest.approx(2.5) and got.longest_wait_s == 5.0
    # Tasks: 4.5 + 8 + 3 + 1.5 + 3 = 20 s, and 7.5 + 5 + 8 + 3 + 1.5 + 3 = 28 s.
    assert [round((r.end_ns - r.start_ns) / 1e9, 6) for r in fleet.records] == [20.0, 28.0]
    assert got.neglect_time_s == pytest.approx((48 - 16) / 2)
    assert got.attention_demand == pytest.approx(1 / 3) and got.fan_out == pytest.approx(3.0)
    assert extra_solved_per_minute(got, 2, 1) == pytest.approx(1 / (16 / 60))


def test_a_service_that_was_withdrawn_counts_until_then():
    """Served from 4.5 to 12.5; the robot, which plans on, is solved at 9 s."""
    fleet, _ = run({0: ". s f"}, policy="or-hitl+plan", service=8.0, inputs={(0, 0, 0): PUSH})
    got = effort(fleet.config, fleet.records, fleet.events)
    assert got.operator_minutes == pytest.approx(4.5 / 60) and got.services == 1
    assert got.interaction_time_s == 4.5


def test_without_any_service():
    fleet, _ = run({0: ". . f"}, policy="autonomous")
    got = effort(fleet.config, fleet.records, fleet.events)
    assert (got.services, got.switches, got.operator_minutes) == (0, 0, 0.0)
    assert math.isnan(got.fan_out) and math.isnan(got.return_on_effort)
    assert math.isnan(got.longest_wait_s)
