"""The tables of the study, as Markdown, from its stored rows alone.

A table of which there are no rows yet is left out.
"""

from collections.abc import Callable, Iterable

import polars as pl
from study_points import NAMED, NUMBERS, VARIANTS, WINDOWS, Difference
from study_rows import difference, over_seeds, table, text

from pgf_jax.metrics.summary import Interval

BEST, BASE, PGF, ORACLE = "gain-rate", "or-hitl", "pgf", "oracle-time"
TIME = "task_time_s"  # by which policies are judged


def fleets(
    rows: pl.DataFrame, name: str, robots: int, policy: str, setting: str = ""
) -> pl.DataFrame:
    """The fleets of a set, size, policy and setting by which policies are judged: one a seed."""
    return rows.filter(
        pl.col("seed") < 100, set=name, robots=robots, policy=policy, setting=setting
    )


def less(
    rows: pl.DataFrame,
    name: str,
    robots: int,
    policies: tuple[str, str],
    value: str = TIME,
    setting: str = "",
) -> Interval:
    """The first policy less the second, paired by seed."""
    ours, theirs = (fleets(rows, name, robots, policy, setting) for policy in policies)
    return difference(ours, theirs, value)


def sizes(rows: pl.DataFrame, name: str, setting: str = "", policy: str = BEST) -> list[int]:
    """The fleet sizes of a setting that have rows."""
    of_setting = rows.filter(pl.col("seed") < 100, set=name, setting=setting, policy=policy)
    return sorted(set(of_setting["robots"]))


def sets(rows: pl.DataFrame) -> list[str]:
    """The sets that have rows of the base, in the order of the rows."""
    base = rows.filter(pl.col("seed") < 100, setting="", policy=BEST)
    return [name for name in dict.fromkeys(base["set"]) if not name.endswith(" objects")]


def ranking(rows: pl.DataFrame) -> str:
    """Every policy against `BEST`, by set and fleet size."""
    headings = ["robots", "policy", "seeds", "success, %", "planning, s", "in the task, s"]
    headings += [f"`{BEST}` less it, s", "success, points"]
    headings += ["utilisation", "solved an operator minute", "fan-out"]
    parts = []
    for name in sets(rows):
        lines = []
        for robots in sizes(rows, name):
            of_size = rows.filter(pl.col("seed") < 100, set=name, setting="", robots=robots)
            for policy in dict.fromkeys(of_size["policy"]):
                its = of_size.filter(policy=policy)
                cells = [str(robots), f"`{policy}`", str(len(its))]
                cells += [text(over_seeds(its, "success"), scale=100)]
                cells += [text(over_seeds(its, c)) for c in ("planning_time_s", TIME)]
                both = (BEST, policy)
                cells += (
                    ["", ""]
                    if policy == BEST
                    else [
                        text(less(rows, name, robots, both)),
                        text(less(rows, name, robots, both, "success"), scale=100),
                    ]
                )
                cells += [
                    text(over_seeds(its, c), 2)
                    for c in ("utilisation", "return_on_effort", "fan_out")
                ]
                lines.append(cells)
        parts += [f"### {name}", table(headings, lines), way_to_oracle(rows, name)]
        parts += [served_like_base(rows, name)]
    return section("Policies", parts)


def section(title: str, parts: Iterable[str]) -> str:
    """A section of the report; empty where there is nothing in it."""
    there = [part for part in parts if part]
    return "\n\n".join([f"## {title}", *there]) if there else ""


def way_to_oracle(rows: pl.DataFrame, name: str) -> str:
    """How much of what `ORACLE` saves against `BASE`, `BEST` saves; a line a fleet size."""
    lines = []
    for robots in sizes(rows, name, policy=ORACLE):
        seeds = fleets(rows, name, robots, ORACLE)["seed"].implode()  # the others have more
        both = rows.filter(pl.col("seed").is_in(seeds))
        most, saved = (less(both, name, robots, (BASE, policy)) for policy in (ORACLE, BEST))
        share = f"{100 * saved.mean / most.mean:.0f} %" if most.mean > 0 else "no share"
        lines.append(
            f"With {robots} robots `{ORACLE}` saves {text(most)} s against `{BASE}`, and `{BEST}` "
            f"{text(saved)}: {share} of it (seeds: {most.n})."
        )
    return "\n\n".join(lines)


def served_like_base(rows: pl.DataFrame, name: str) -> str:
    """The largest fleet of `BEST` whose time in the task is no longer than that of `BASE` with 10.

    Between two sizes that were computed the time is taken to grow in a straight line.
    """

    def mean_s(policy: str, robots: int) -> float:
        return over_seeds(fleets(rows, name, robots, policy), TIME).mean

    limit_s, tried = mean_s(BASE, 10), sizes(rows, name)
    times = [mean_s(BEST, robots) for robots in tried]
    within = [i for i, time_s in enumerate(times) if time_s <= limit_s]
    if not within:
        return ""
    last = within[-1]
    most = f"{tried[last]} robots or more"
    if last + 1 < len(tried):
        part = (limit_s - times[last]) / (times[last + 1] - times[last])
        most = f"{int(tried[last] + part * (tried[last + 1] - tried[last]))} robots"
    return f"`{BEST}` serves {most} at the {limit_s:.1f} s that `{BASE}` needs with 10."


def planning_on(rows: pl.DataFrame) -> str:
    """What going on planning gains by itself: a policy with it less the one without."""
    lines = []
    for name in sets(rows):
        for robots in sizes(rows, name, policy=f"{PGF}+plan"):
            cells = [name, str(robots)]
            for policy in (PGF, BASE):
                both = (f"{policy}+plan", policy)
                cells += [text(less(rows, name, robots, both))]
                cells += [text(less(rows, name, robots, both, "success"), scale=100)]
            lines.append(cells)
    headings = ["set", "robots"]
    headings += [f"`{p}+plan` less `{p}`{unit}" for p in (PGF, BASE)
                 for unit in (", s", ", success, points")]  # fmt: skip
    return section("Going on planning", [table(headings, lines) if lines else ""])


def tuning(rows: pl.DataFrame) -> str:
    """By what policies and options were chosen: the mean over the sets, less that of `BEST`."""
    its = rows.filter(pl.col("seed") >= 100)
    lines = []
    for policy, setting in dict.fromkeys(its.select("policy", "setting").rows()):
        mine, base = its.filter(policy=policy, setting=setting), its.filter(policy=BEST, setting="")
        both = mine.join(base, on=("set", "robots", "seed"), suffix="_base")
        cells = [f"`{policy}`", setting or "default", str(len(both))]
        for value, scale in ((TIME, 1), ("success", 100)):
            per_set = [
                (part[value] - part[f"{value}_base"]).mean()
                for part in both.partition_by("set", maintain_order=True)
            ]
            mean = pl.Series(per_set).mean()
            assert isinstance(mean, float)
            cells.append(f"{scale * mean:.1f}")
        lines.append(cells)
    headings = ["policy", "setting", "fleets", f"in the task less `{BEST}`, s", "success, points"]
    return section("How policy and options were chosen", [table(headings, lines) if lines else ""])


def difficulty(rows: pl.DataFrame) -> str:
    """Fleets on shelves of which only the number of objects varies."""
    policies = ("autonomous", BASE, PGF, f"{PGF}+plan", BEST)
    lines = []
    for number in NUMBERS:
        name = f"{number} objects"
        for robots in sizes(rows, name):
            cells = [str(number)]
            for policy in policies:
                its = fleets(rows, name, robots, policy)
                success = text(over_seeds(its, "success"), 0, 100)
                cells.append(f"{text(over_seeds(its, TIME))}; {success}")
            lines.append(cells)
    headings = ["objects", *(f"`{policy}`: s; solved, %" for policy in policies)]
    return section("Difficulty", [table(headings, lines) if lines else ""])


def _leads(rows: pl.DataFrame, name: str, settings: Iterable[str], robots: int) -> str:
    """`BEST` less `BASE` and `PGF`, and `PGF` less `BASE`, of one fleet size by setting."""
    pairs = ((BEST, BASE), (BEST, PGF), (PGF, BASE))
    lines = []
    for setting in settings:
        found = [less(rows, name, robots, both, setting=setting) for both in pairs]
        if any(one.n for one in found):
            mean = over_seeds(fleets(rows, name, robots, BEST, setting), TIME)
            lines.append([setting or "base", text(mean), *map(text, found)])
    headings = [f"{name}, {robots} robots", f"`{BEST}`, s"]
    headings += [f"`{ours}` less `{theirs}`, s" for ours, theirs in pairs]
    return table(headings, lines) if lines else ""


def robustness(rows: pl.DataFrame) -> str:
    """Do the conclusions hold in other worlds, with other operators, by other services?"""
    return section("Robustness", [_leads(rows, "packed", ("", *VARIANTS), 10)])


def windows(rows: pl.DataFrame) -> str:
    """What the window costs."""
    lines = []
    for robots in sizes(rows, "packed", policy=PGF):
        for setting in ("", *(f"window of {w:g} s" for w in WINDOWS)):
            its = fleets(rows, "packed", robots, PGF, setting)
            base = fleets(rows, "packed", robots, BASE)
            if len(its) and len(base):
                cells = [str(robots), setting or "window of 2 s", text(over_seeds(its, TIME))]
                lines.append([*cells, text(difference(its, base, TIME))])
    headings = ["robots", f"`{PGF}` on `packed`", "in the task, s", f"less `{BASE}`, s"]
    return section("The window", [table(headings, lines) if lines else ""])


def decided(rows: pl.DataFrame) -> str:
    """The named differences, and whether their intervals are narrow enough to decide."""

    def line(one: Difference) -> list[str]:
        found = less(rows, one.set, one.robots, (one.ours, one.theirs), setting=one.setting)
        sign = "behind" if found.low > 0 else "ahead" if found.high < 0 else "undecided"
        narrow = found.high - found.low <= one.width_s
        word = "alike" if sign == "undecided" and narrow else sign
        cells = [one.set, str(one.robots), f"`{one.ours}` less `{one.theirs}`", str(found.n)]
        return [*cells, text(found), word]

    headings = ["set", "robots", "difference", "seeds", "s", ""]
    lines = [line(one) for one in NAMED]
    return section("What is decided", [table(headings, [one for one in lines if one[3] != "0"])])


TABLES: tuple[Callable[[pl.DataFrame], str], ...] = (
    ranking,
    planning_on,
    decided,
    tuning,
    windows,
    difficulty,
    robustness,
)
