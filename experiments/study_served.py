"""The largest fleet that operators serve: tables of the study, from its stored rows alone.

A fleet of R robots counts as served where it is within 5 % of a fully served one, that is of the
same robots with an operator each, who never wait: the whole 95 % interval of the paired difference
is. Beside it stand the analytic fan-out (Z + S) / S, with Z the robot's own time between two
services (Olsen & Wood 2004), and what the machine-repair model M/M/c//R says.
"""

import math

import polars as pl
from study_points import EACH, HARD, MAIN, OWN, SERVED
from study_rows import difference, over_seeds, table, text
from study_tables import TIME, fleets, section

LOSS = 0.05  # accepted, against a fleet that is fully served
OPERATORS = {"": 1, "2 operators": 2, "4 operators": 4}  # setting -> operators
MEASURES = {  # name -> (column, whether more is better)
    "grasps an hour": ("rate", True),
    "time in the task": (TIME, False),
    "planning time": ("planning_time_s", False),
    "success": ("success", True),
}
WORK = {"utilisation": "operator busy", "fairness_throughput": "fairness (Jain, tasks per hour)"}
THERE = "There: with the largest fleet that is served by time in the task."


def fully_served(setting: str) -> str:
    """The setting in which the fleets of a setting have an operator each."""
    return EACH if setting in OPERATORS else f"{setting}, {EACH}"


def with_rate(rows: pl.DataFrame) -> pl.DataFrame:
    """Rows with `rate`: tasks solved per hour that robots spend on tasks."""
    return rows.with_columns(rate=pl.col("solved") / pl.col("robot_hours"))


def within(ours: pl.DataFrame, full: pl.DataFrame, measure: str) -> bool:
    """Whether fleets are within `LOSS` of fully served ones, for certain (95 %)."""
    column, more = MEASURES[measure]
    found, reference = difference(ours, full, column), over_seeds(full, column).mean
    end = -found.low if more else found.high
    return end <= LOSS * reference


def largest_size(
    rows: pl.DataFrame, name: str, policy: str, settings: tuple[str, str], measure: str
) -> tuple[int, list[int]]:
    """The largest fleet that is within the loss, as all smaller ones that were computed are.

    Args:
      rows: of the study, with `rate`.
      name: of the set.
      policy: of both fleets.
      settings: that of the fleets, and that in which they are fully served.
      measure: one of `MEASURES`.

    Returns:
      The size, 0 where none is within; and the sizes that were computed.
    """
    best, tried = 0, []
    for robots in sorted(set(rows.filter(set=name, policy=policy)["robots"])):
        ours, full = (fleets(rows, name, robots, policy, setting) for setting in settings)
        if len(ours) < 2 or len(full) < 2:
            continue
        tried.append(robots)
        if best == ([0, *tried])[-2] and within(ours, full, measure):
            best = robots
    return best, tried


def largest(
    rows: pl.DataFrame, name: str, policy: str, settings: tuple[str, str], measure: str
) -> str:
    """`largest_size` in words: `N+` where it is the largest of all, or `under N`."""
    best, tried = largest_size(rows, name, policy, settings, measure)
    if not tried:
        return ""
    if not best:
        return f"under {tried[0]}"
    return f"{best}+" if best == tried[-1] else str(best)


def cycle(served: pl.DataFrame) -> tuple[float, float]:
    """Robot time between two services (planning and executing), and time of a service, s."""
    hours, grants = float(served["robot_hours"].sum()), int(served["grants"].sum())
    busy = float((served["utilisation"] * served["hours"] * served["operators"]).sum())
    if not grants:
        return math.inf, 0.0
    return 3600 * (hours - busy) / grants, 3600 * busy / grants


def waiting_s(robots: int, operators: int, think_s: float, service_s: float) -> float:
    """Mean time in line of the machine-repair model M/M/c//R, s; all times exponential.

    Robots work for `think_s`, then need one of c operators for `service_s`, in line if none is
    free. Source: birth and death, as in any textbook of queues.
    """
    weights = [1.0]  # of n robots that wait or are served
    for n in range(robots):
        rate_up = (robots - n) / think_s
        rate_down = min(n + 1, operators) / service_s
        weights.append(weights[-1] * rate_up / rate_down)
    total = sum(weights)
    waiting = sum((n - operators) * w for n, w in enumerate(weights) if n > operators) / total
    served = sum((robots - n) * w for n, w in enumerate(weights)) / total / think_s  # per s
    return waiting / served


def repairable(operators: int, think_s: float, service_s: float) -> int:
    """The largest fleet whose robots lose at most `LOSS` of their time in line, by that model."""
    robots = operators
    while robots < 1000:
        wait = waiting_s(robots + 1, operators, think_s, service_s)
        if wait > LOSS * (think_s + service_s):
            break
        robots += 1
    return robots


def served(rows: pl.DataFrame) -> str:
    """The answer: by set, number of operators, service time and policy."""
    rows = with_rate(rows)
    of: list[tuple[str, str, int]] = []  # set, setting, operators
    for name in (*HARD, "all"):
        of += [(name, setting, count) for setting, count in OPERATORS.items()]
    of += [("packed", setting, 1) for setting in SERVED]
    of += [("tight", OWN, 1)]
    lines = [line for one in of for line in _lines(rows, *one)]
    headings = ["set", "setting", "policy", *MEASURES]
    headings += [f"{words} there" for words in WORK.values()]
    headings += ["fully served, s", "fan-out by (Z + S) / S", "by the machine-repair model"]
    return section("How many robots are served", [table(headings, lines), THERE] if lines else [])


def _lines(rows: pl.DataFrame, name: str, setting: str, operators: int) -> list[list[str]]:
    lines, settings = [], (setting, fully_served(setting))
    for policy in MAIN:
        found = [largest(rows, name, policy, settings, measure) for measure in MEASURES]
        if not any(found):
            continue
        size, _ = largest_size(rows, name, policy, settings, "time in the task")
        its = fleets(rows, name, size, policy, setting)
        found += [text(over_seeds(its, column), 2) for column in WORK]
        full = rows.filter(pl.col("seed") < 100, set=name, policy=policy, setting=settings[1])
        full = full.filter(robots=full["robots"].max())
        think_s, service_s = cycle(full)
        fan_out, model = "-", "-"
        if service_s:
            fan_out = f"{operators * (think_s + service_s) / service_s:.1f}"
            model = str(repairable(operators, think_s, service_s))
        label = setting or "1 operator"
        lines.append(
            [name, label, f"`{policy}`", *found, text(over_seeds(full, TIME)), fan_out, model]
        )
    return lines
