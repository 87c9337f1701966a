"""What the study computes: fleets of every setting, one factor at a time about a base.

The base is one operator with services of 8 s, the operator `heuristic`, the shipped predictors and
the solid world. A *set* is a class of scenes, or `N objects`; a *setting* says in words what is
changed, and is empty for the base.
"""

import collections
import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

from pgf_jax import sample_scene
from pgf_jax.scene import Sizes

PAPER = ("or-hitl", "pgf")
MAIN = (*PAPER, "gain-rate")
RANKING = (*PAPER, "or-hitl+plan", "pgf+plan", "gain-rate")
HARD = ("packed", "every")
SETS = (*HARD, "crowded", "all")
NUMBERS = (20, 28, 36, 44, 50)  # of objects
TUNING = range(100, 102)  # seeds by which policies and their options are chosen
# Variations have few tasks, and a seed less: a task on a packed shelf takes two to four seconds of
# a core, most of them checks in the solid world.
TASKS, SEEDS = 2, range(3)


@dataclasses.dataclass(frozen=True)
class Point:
    """Fleets of one setting.

    Attributes:
      part: of the study.
      setting: in words; empty: the base.
      sets: of scenes.
      policies, robots: every combination.
      seeds: of the fleets.
      tasks: of each robot.
      changes: options of the sweep that are other than the base's.
    """

    part: str
    setting: str
    sets: tuple[str, ...]
    policies: tuple[str, ...]
    robots: tuple[int, ...]
    seeds: range = range(4)
    tasks: int = 5
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@functools.cache
def scenes_of(name: str) -> dict[str, Any]:
    """The options of a sweep by which it has the scenes of a set."""
    if not name.endswith(" objects"):
        return {"scene_class": name}
    number = int(name.split()[0])
    # Only the number varies: standard objects in the rectangle of `crowded`, the goal at the back.
    sizes = Sizes(objects=(number, number))
    seeds = range(80_000, 80_100)
    return {"scenes": tuple(sample_scene(seed, "crowded", sizes=sizes) for seed in seeds)}


def services(mean_s: float, sd_s: float | None = None) -> dict[str, Any]:
    """Service times of a simulated operator; their spread is half of the mean unless given."""
    return {"service_mean": mean_s, "service_sd": mean_s / 2 if sd_s is None else sd_s}


EACH = "an operator each"  # as many operators as robots: nobody ever waits
ERROR = (("friction", 0.3), ("mass", 0.3), ("position", 0.005))  # the default


def error(times: float) -> dict[str, Any]:
    """A world in which robots act that is so many times as far from that in which they check."""
    return {"world_error": tuple(f"{name}={times * spread:g}" for name, spread in ERROR)}


SERVICE_TIMES = (2.0, 30.0, 60.0)  # s, beside the base's 8 s
WINDOWS = (0.0, 8.0)  # s, beside the base's 2 s
VARIANTS = {  # of the world, the operator and the service times
    "no world": {"world": "none"},
    "world error": error(1),
    "half the world error": error(0.5),
    "twice the world error": error(2),
    "operator noisy": {"operator": "noisy"},
    "operator oracle": {"operator": "oracle"},
    "constant services": services(8.0, 0.0),
    "scattered services": services(8.0, 16.0),
}

SERVED = {  # settings of which it is asked how many robots are served, beside the base
    f"services of {mean:g} s": services(mean) for mean in SERVICE_TIMES
}
OWN = "the paper's own"  # planner and computers, as far as they are known
CAUSES = {  # of what differs from the paper's figure
    "96 shared cores": {"compute": "shared:96"},
    "random winner": {"random_winner": 1.0},
}

FIGURE_6 = (*PAPER, "autonomous")
DIFFICULTY = ("autonomous", *PAPER, "pgf+plan", "gain-rate")
RESERVATIONS = {"time-saved": (4.0, 10.0), "gain-rate": (0.5, 1.0, 2.0), "urgency": (0.05, 0.1)}


def _tuning(setting: str, *policies: str, **changes: float) -> Point:
    return Point("tuning", setting, HARD, policies, (20,), TUNING, changes=changes)


def _served(
    setting: str, operators: int, sets: tuple[str, ...], *robots: int, tasks: int = 5
) -> Point:
    changes = {} if operators == 1 else {"operators": operators}
    return Point("served", setting, sets, MAIN, robots, SEEDS, tasks, changes)


def _fully(
    setting: str, name: str, policies: tuple[str, ...], changes: Mapping[str, Any], *robots: int
) -> tuple[Point, Point]:
    """Fleets of a setting, and the same with an operator each."""
    one = Point("served", setting, (name,), policies, robots, SEEDS, TASKS, changes)
    changes = dict(changes) | {"operators": max(robots)}
    return one, dataclasses.replace(one, setting=f"{setting}, {EACH}", changes=changes)


POINTS = (
    Point("ranking", "", SETS, RANKING, (10, 20)),
    Point("ranking", "", SETS, RANKING, (1,), tasks=20),
    Point("ranking", "", SETS, RANKING, (30,), range(2)),
    Point("ranking", "", SETS, MAIN, (30,)),
    Point("ranking", "", SETS, MAIN, (10,), range(8)),
    Point("ranking", "", SETS, MAIN, (1,), range(8), tasks=20),
    # Two futures are planned to their ends after each iteration: half a minute of a core a task.
    Point("oracle", "", ("every",), ("oracle-time",), (10,), range(2)),
    _tuning("", "time-saved", "gain-rate", "urgency"),
    _tuning("failure cost 60 s", "gain-rate", failure_cost=60.0),
    *(
        _tuning(f"reservation {value:g}", policy, reservation=value)
        for policy, values in RESERVATIONS.items()
        for value in values
    ),
    # How many robots one, two and four operators serve.
    _served("", 1, HARD, 2, 3, 5),
    _served(EACH, 20, HARD, 2, 3, 5, 10, 20),
    _served("2 operators", 2, ("packed",), 5, 10),
    _served("4 operators", 4, ("packed",), 10, 20),
    Point("served", "", HARD, ("autonomous",), (20,), SEEDS),
    _served("", 1, ("all",), 50, 100, tasks=TASKS),
    _served(EACH, 100, ("all",), 10, 20),
    _served(EACH, 100, ("all",), 50, 100, tasks=TASKS),
    *(
        point
        for setting, changes in SERVED.items()
        for point in _fully(setting, "packed", MAIN, changes, 2, 5, 10)
    ),
    *_fully(OWN, "tight", PAPER, dict(collections.ChainMap(*CAUSES.values())), 10, 20, 30),
    *(
        Point("window", f"window of {w:g} s", ("packed",), ("pgf",), (10,), SEEDS, 5, {"window": w})
        for w in WINDOWS
    ),
    Point("window", "", ("packed",), ("or-hitl-window",), (10,), SEEDS),
    # The paper's figure 6; its other set, `all`, is of the ranking.
    Point("figure 6", "", ("tight",), FIGURE_6, (10, 20, 30)),
    Point("figure 6", "", ("tight",), FIGURE_6, (1,), tasks=20),
    *(
        Point("figure 6", setting, ("tight",), PAPER, (10, 20, 30), SEEDS, TASKS, changes)
        for setting, changes in CAUSES.items()
    ),
    # From where autonomy alone does nearly all, to where it does a third.
    *(Point("difficulty", "", (f"{n} objects",), DIFFICULTY, (10,), tasks=TASKS) for n in NUMBERS),
    *(
        Point("robustness", setting, ("packed",), MAIN, (10,), SEEDS, TASKS, changes)
        for setting, changes in VARIANTS.items()
    ),
)


@dataclasses.dataclass(frozen=True)
class Difference:
    """A difference of two fleets that gets seeds until its interval is narrow enough.

    Attributes:
      set, setting, robots: of both fleets.
      ours, theirs: policies; the difference is the first less the second.
      width_s: of the 95 % interval of the difference of times in the task, s.
      seeds: at most.
    """

    set: str
    setting: str
    robots: int
    ours: str
    theirs: str
    width_s: float = 8.0
    seeds: int = 24


NAMED = tuple(
    Difference(name, "", robots, ours, theirs)
    for name in HARD
    for robots in (10, 20)
    for ours, theirs in (("gain-rate", "or-hitl"), ("gain-rate", "pgf"), ("pgf", "or-hitl"),
                         ("pgf+plan", "pgf"))
)  # fmt: skip
