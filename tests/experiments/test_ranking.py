"""The report of the study of ranking, from rows made up by hand."""

import polars as pl
import pytest
import ranking


def frame(times: dict[tuple[str, int], list[float]]) -> pl.DataFrame:
    """Rows of fleets whose mean times in the task are given by seed."""
    return pl.DataFrame(
        [
            {
                "set": "packed",
                "robots": robots,
                "policy": policy,
                "seed": seed,
                "task_time_s": seconds,
                "planning_time_s": seconds,
                "success": 0.5,
                "utilisation": 0.5,
                "return_on_effort": 2.0,
                "fan_out": 3.0,
            }
            for (policy, robots), per_seed in times.items()
            for seed, seconds in enumerate(per_seed)
        ]
    )


def test_the_way_to_the_oracle():
    rows = frame(
        {("or-hitl", 10): [50, 60], ("gain-rate", 10): [40, 52], ("oracle-time", 10): [38, 48]}
    )
    line, _ = ranking.way_to_oracle(rows)
    # 9 s of 12.
    assert line.startswith("With 10 robots `oracle-time` saves 12.0 (12.0..12.0) s")
    assert line.endswith("75 % of it.")
    assert ranking.way_to_oracle(rows.filter(policy="gain-rate")) == []


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ([30, 40, 60], "serves 15 robots at the 50.0 s"),
        ([30, 40, 50], "serves 20 robots or more at"),
        ([30, 55, 90], "serves 8 robots at"),
        ([51, 55, 90], ""),
    ],
)
def test_the_fleet_that_is_served(times, says):
    sizes = {("gain-rate", robots): [s] for robots, s in zip((1, 10, 20), times, strict=True)}
    found = ranking.served(frame({("or-hitl", 10): [50], **sizes}))
    assert says in found and bool(says) == bool(found)


def test_the_table_pairs_fleets_by_seed():
    text = ranking.tables(frame({("or-hitl", 10): [50, 60], ("gain-rate", 10): [40, 52]}))
    assert "| 10 | `or-hitl` | 2 |" in text
    assert "| -9.0 (-21.7..3.7) | 0.0 (0.0..0.0) |" in text
