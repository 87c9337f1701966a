"""Makes the data of figure 5: chooses a window of a fleet, and looks up its bidders' tasks.

Part of `figures_2_4_5.py`, which runs the sweep.
"""

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import polars as pl
from figures_2_4_5_drawing import rounded, scene_content

from pgf_jax import BadInput, SweepConfig
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.sweeping.resolve import task_scenes
from pgf_jax.sweeping.summary import csv
from pgf_jax.sweeping.sweep import SweepResult
from pgf_jax.tables import results

POLICIES = ("pgf", "or-hitl")  # the window is one of the first
BIDDERS = 5  # most bidders of the window that is shown
OUTCOME = (
    "status",
    "reach_iterations",
    "first_bid",
    "first_grant",
    "grants",
    "pushes_succeeded",
    "planning_time_s",
)
RULE = (
    f"of the windows under pgf with 2 to {BIDDERS} bids, all finite, of robots that have had no "
    "input in that task (so that the scene is as it was sampled), the winner given a push: the "
    "first of those with the most bidders"
)


@dataclasses.dataclass(frozen=True)
class Window:
    """A window of Alg. 2: its bids, and the robots granted and refused when it closed."""

    bids: list[Event]
    close_ns: int
    granted: list[int]  # robots
    refused: list[int]

    def finite(self) -> bool:
        """Whether there are several bids, all finite: a stuck robot bids +inf."""
        gains = [bid.gain for bid in self.bids]
        return len(gains) > 1 and all(gain is not None and math.isfinite(gain) for gain in gains)

    def fits(self, events: Sequence[Event]) -> bool:
        """Whether the window fits `RULE`."""
        if not self.finite() or len(self.bids) > BIDDERS or len(self.granted) != 1:
            return False
        # A robot whose time ran out in the window is neither granted nor refused.
        all_there = len(self.granted) + len(self.refused) == len(self.bids)
        (winner,) = [bid for bid in self.bids if bid.robot == self.granted[0]]
        given = answer(events, winner)
        pushed = given is not None and given.object is not None
        return all_there and pushed and all(bid.request == 0 for bid in self.bids)


def windows(events: Sequence[Event]) -> list[Window]:
    """The windows of a fleet, in time order."""
    found: list[Window] = []
    bids: list[Event] = []
    for event in events:
        if event.kind is EventKind.WINDOW_OPEN:
            bids = []
        elif event.kind is EventKind.BID:
            bids.append(event)
        elif event.kind is EventKind.WINDOW_CLOSE:
            found.append(Window(bids, event.time_ns, [], []))
        elif event.robot is not None and found and found[-1].bids is bids:
            # The decisions of a window are logged when it closes, before the next one opens.
            if event.kind is EventKind.GRANT:
                found[-1].granted.append(event.robot)
            elif event.kind is EventKind.REFUSED:
                found[-1].refused.append(event.robot)
    return found


def answer(events: Sequence[Event], bid: Event) -> Event | None:
    """The end of the first service of the bidder's task, if there was a service."""
    for event in events:
        of_task = (event.robot, event.task, event.request) == (bid.robot, bid.task, 0)
        if of_task and event.kind is EventKind.SERVICE_END:
            return event
    return None


def figure5(config: SweepConfig, outcome: SweepResult) -> dict[str, Any]:
    """Make the data of figure 5: the bidders of a window, and the outcomes of their tasks.

    Args:
      config: of a sweep of one fleet size under `POLICIES`.
      outcome: results of that sweep.

    Raises:
      BadInput: no window fits `RULE`.
    """
    cell = config.cells()[0]
    content = outcome.cell(cell)
    events = results.event_log(content.events)
    found = windows(events)
    fitting = [window for window in found if window.fits(events)]
    if not fitting:
        raise BadInput(
            f"figure 5: none of {len(found)} windows with seed {config.seed} fits its rule; "
            "expected a seed, or a preset, with one that does"
        )
    most = max(len(window.bids) for window in fitting)
    chosen = next(window for window in fitting if len(window.bids) == most)
    sizes = Counter(len(window.bids) for window in fitting)
    tasks = outcome.tasks()
    return {
        "rule": RULE,
        "networks": content.about["identity"]["predictors"],
        "sweep": {
            "robots": cell.robots,
            "tasks_each": cell.tasks,
            "policies": list(POLICIES),
            "predictor": config.predictor,
            "operator": config.operator,
            "window_s": config.window,
        },
        "windows": {
            "all": len(found),
            "of_several_bids": sum(len(window.bids) > 1 for window in found),
            "of_several_finite_bids": sum(window.finite() for window in found),
            "fitting": len(fitting),
            "fitting_by_bidders": {str(n): sizes[n] for n in sorted(sizes)},
        },
        "window": {"number": found.index(chosen), "closed_at_s": chosen.close_ns / 1e9},
        "bidders": [
            bidder(config, events, tasks, bid, won=bid.robot in chosen.granted)
            for bid in sorted(chosen.bids, key=lambda bid: -(bid.gain or 0.0))
        ],
    }


def bidder(
    config: SweepConfig, events: Sequence[Event], tasks: pl.DataFrame, bid: Event, *, won: bool
) -> dict[str, Any]:
    """The data of a bidder: scene, bid, first input under pgf, and the outcomes of its task."""
    assert bid.robot is not None and bid.task is not None
    given, push = answer(events, bid), None
    if given is not None and given.object is not None:
        push = {"object": given.object, "target": rounded([given.x, given.y])}
    rows = tasks.filter((pl.col("robot") == bid.robot) & (pl.col("task") == bid.task))
    of_policy = {row["policy"]: row for row in rows.iter_rows(named=True)}
    return {
        "robot": bid.robot,
        "task": bid.task,
        "won": won,
        "gain": rounded(bid.gain, 2),
        # There was no input before, so no push: all iterations were of reaching.
        "iteration": bid.iteration,
        "scene": scene_content(task_scenes(config).scene(bid.robot, bid.task)),
        "first_input": None if given is None else given.outcome,
        "first_push": push,
        "outcomes": {
            policy: {column: of_policy[policy][column] for column in OUTCOME} for policy in POLICIES
        },
    }


def table(content: dict[str, Any]) -> bytes:
    """Content of `figure5.csv`: one row per bidder."""
    rows = []
    for bidder in content["bidders"]:
        push = bidder["first_push"] or {"object": None, "target": (None, None)}
        x, y = push["target"]
        row = {name: bidder[name] for name in ("robot", "task", "won", "gain", "iteration")}
        row |= {"scene": bidder["scene"]["name"], "first_input": bidder["first_input"]}
        row |= {"push_object": push["object"], "push_x": x, "push_y": y}
        for policy, outcome in bidder["outcomes"].items():
            row |= {f"{policy}_{name}": value for name, value in outcome.items()}
        rows.append(row)
    return csv(pl.DataFrame(rows, infer_schema_length=None))
