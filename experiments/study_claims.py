"""What became of the paper's claims (section VI): a table of the study, from stored rows alone.

Differences are PGF less OR-HITL on the same scenes, noise and service times. A claim holds where
the whole interval is where the claim puts it, and does not where none of it is.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator

import polars as pl
from study_rows import difference, over_seeds, table, text
from study_tables import BASE, PGF, fleets, less, section, sizes

from pgf_jax.metrics.summary import Interval

PANELS = ("tight", "all", "every", "crowded", "packed")  # sets of scenes, the paper's own first
AT = 20  # robots, where the paper gives numbers
FEW, MANY = 1, 30
LIKE, SIMILAR, AS_HIGH = 0.05, 0.10, 0.01  # of OR-HITL's time; of utilisation; of success
WORDS = f"""PGF less OR-HITL, and whether the claim holds: yes where the whole interval is where the
claim puts it, no where none of it is. `alike`: by less than {100 * LIKE:.0f} % of OR-HITL's time;
`similar`: by less than {100 * SIMILAR:.0f} % of the operator's time; `as high`: at most a point
lower."""
FASTER, MORE = (-math.inf, 0.0), (0.0, math.inf)
Bounds = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Measured:
    """What the rows say of a claim on one set of scenes.

    Attributes:
      found: the interval of what it is about.
      bounds: where the claim puts it.
    """

    found: Interval
    bounds: Bounds

    @property
    def holds(self) -> str:
        """Whether the claim does."""
        low, high = self.bounds
        if low <= self.found.low and self.found.high <= high:
            return "yes"
        return "no" if self.found.high < low or self.found.low > high else "not decided"


Measure = Callable[[pl.DataFrame, str], Measured]  # of rows and a set


@dataclasses.dataclass(frozen=True)
class Claim:
    """A claim of the paper.

    Attributes:
      words: what it is about.
      paper: what the paper says of it.
      measure: it here.
      unit: of the numbers; `points` are hundredths.
    """

    words: str
    paper: str
    measure: Measure
    unit: str = "s"


def _less(column: str, robots: int, bounds: Bounds) -> Measure:
    """The measure of a claim about a difference of the policies."""
    return lambda rows, name: Measured(less(rows, name, robots, (PGF, BASE), column), bounds)


def _like(robots: int) -> Measure:
    """The same planning time, within a share of OR-HITL's."""

    def measure(rows: pl.DataFrame, name: str) -> Measured:
        found = less(rows, name, robots, (PGF, BASE), "planning_time_s")
        within = LIKE * over_seeds(fleets(rows, name, robots, BASE), "planning_time_s").mean
        return Measured(found, (-within, within))

    return measure


def _rise(rows: pl.DataFrame, name: str) -> Measured:
    """PGF's planning time with many robots less that with few."""
    many, few = (fleets(rows, name, robots, PGF) for robots in (MANY, FEW))
    return Measured(difference(many, few, "planning_time_s"), MORE)


def _shrinks(rows: pl.DataFrame, name: str) -> Measured:
    """The lead over OR-HITL with many robots less that with few."""

    def lead(robots: int) -> pl.DataFrame:
        ours, theirs = (fleets(rows, name, robots, policy) for policy in (PGF, BASE))
        gap = pl.col("planning_time_s") - pl.col("planning_time_s_theirs")
        both = ours.join(theirs, on="seed", suffix="_theirs")
        return both.select("seed", planning_time_s=gap)

    return Measured(difference(lead(MANY), lead(FEW), "planning_time_s"), MORE)


def _robots(number: int) -> str:
    return f"{number} robot{'s' * (number > 1)}"


def claims() -> Iterator[Claim]:
    """The claims, in the order of the table."""
    for robots in (1, 10, 20):
        measure = _less("planning_time_s", robots, FASTER)
        yield Claim(f"planning time, {_robots(robots)}", "PGF faster", measure)
    yield Claim("planning time, 30 robots", "alike", _like(30))
    yield Claim(f"PGF's planning time, {MANY} robots less {FEW}", "rises", _rise)
    yield Claim(f"PGF's lead, {MANY} robots less {FEW}", "shrinks", _shrinks)
    for words, column in (("bid", "first_bid"), ("grant", "first_grant")):
        words = f"iteration of the first {words}, {AT} robots"
        yield Claim(words, "earlier (6, 25)", _less(column, AT, FASTER), "iterations")
    words = f"tasks with a grant, {AT} robots"
    yield Claim(words, "more (31, 18 %)", _less("helped", AT, MORE), "points")
    words, bounds = f"the operator's utilisation, {AT} robots", (-SIMILAR, SIMILAR)
    yield Claim(words, "similar", _less("utilisation", AT, bounds), "points")
    for robots in (1, 10, 20, 30):
        measure = _less("success", robots, (-AS_HIGH, math.inf))
        yield Claim(f"success, {_robots(robots)}", "as high", measure, "points")


def panels_of(rows: pl.DataFrame) -> list[str]:
    """Those of `PANELS` that have rows."""
    return [name for name in PANELS if sizes(rows, name, policy=BASE)]


def paper_claims(rows: pl.DataFrame) -> str:
    """Each claim on each set of scenes that has rows of two seeds."""
    there, lines = panels_of(rows), []
    for claim in claims():
        cells = []
        for name in there:
            measured = claim.measure(rows, name)
            scale = 100 if claim.unit == "points" else 1
            words = f"{text(measured.found, 1, scale)} {claim.unit}: {measured.holds}"
            cells.append(words if measured.found.n > 1 else "")
        lines.append([claim.words, claim.paper, *cells])
    return section(
        "The paper's claims", [WORDS, table(["claim", "paper", *there], lines)] if there else []
    )
