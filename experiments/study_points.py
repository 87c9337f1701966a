"""What the study computes: fleets of every setting, one factor at a time about a base.

The base is one operator with services of 8 s, the operator `heuristic`, the shipped predictors and
the solid world. A *set* is a class of scenes, or `N objects`; a *setting* says in words what is
changed, and is empty for the base.
"""

import dataclasses
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
TUNING = range(100, 108)  # seeds by which policies and their options are chosen


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


def scenes_of(name: str) -> dict[str, Any]:
    """The options of a sweep by which it has the scenes of a set."""
    if not name.endswith(" objects"):
        return {"scene_class": name}
    number = int(name.split()[0])
    # Only the number varies: standard objects in the rectangle of `crowded`, the goal at the back.
    sizes = Sizes(objects=(number, number))
    seeds = range(80_000, 80_200)
    return {"scenes": tuple(sample_scene(seed, "crowded", sizes=sizes) for seed in seeds)}


def services(mean_s: float, sd_s: float | None = None) -> dict[str, Any]:
    """Service times of a simulated operator; their spread is half of the mean unless given."""
    return {"service_mean": mean_s, "service_sd": mean_s / 2 if sd_s is None else sd_s}


EACH = "an operator each"  # as many operators as robots: nobody ever waits
ERROR = (("friction", 0.3), ("mass", 0.3), ("position", 0.005))  # the default


def error(times: float) -> dict[str, Any]:
    """A world in which robots act that is so many times as far from that in which they check."""
    return {"world_error": tuple(f"{name}={times * spread:g}" for name, spread in ERROR)}


SERVICE_TIMES = (2.0, 15.0, 30.0, 60.0)  # s, beside the base's 8 s
WINDOWS = (0.0, 4.0, 8.0)  # s, beside the base's 2 s
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

POINTS = (
    Point("ranking", "", SETS, RANKING, (10, 20), range(8)),
    Point("ranking", "", SETS, RANKING, (1,), range(8), tasks=20),
    Point("ranking", "", SETS, RANKING, (30,)),
    Point("oracle", "", HARD, ("oracle-time",), (10, 20)),
    *(
        Point("tuning", setting, HARD, policies, (20,), TUNING, 5, changes)
        for setting, policies, changes in (
            ("", ("time-saved", "gain-rate", "urgency"), {}),
            *(
                (f"reservation {value:g}", (policy,), {"reservation": value})
                for policy, values in (
                    ("time-saved", (4.0, 10.0)),
                    ("gain-rate", (0.5, 1.0, 2.0)),
                    ("urgency", (0.05, 0.1)),
                )
                for value in values
            ),
            ("failure cost 60 s", ("gain-rate",), {"failure_cost": 60.0}),
        )
    ),
    # How many robots one, two and four operators serve.
    Point("served", "", HARD, MAIN, (2, 5)),
    *(
        Point("served", f"{count} operators", HARD, MAIN, sizes, changes={"operators": count})
        for count, sizes in ((2, (5, 10, 20, 30)), (4, (10, 20, 30)))
    ),
    Point("served", EACH, HARD, MAIN, (2, 5, 10, 20, 30), changes={"operators": 30}),
    Point("served", "", ("all",), MAIN, (50, 100), range(2)),
    Point("served", EACH, ("all",), MAIN, (10, 30, 50, 100), range(2), changes={"operators": 100}),
    *(
        Point(
            "service time",
            f"services of {mean:g} s{each}",
            ("packed",),
            MAIN,
            (5, 10, 20),
            changes=services(mean) | more,
        )
        for mean in SERVICE_TIMES
        for each, more in (("", {}), (f", {EACH}", {"operators": 20}))
    ),
    *(
        Point(
            "window", f"window of {w:g} s", ("packed",), ("pgf",), (10, 20), changes={"window": w}
        )
        for w in WINDOWS
    ),
    Point("window", "", ("packed",), ("or-hitl-window",), (10, 20)),
    # The paper's figure 6, with fewer tasks than the paper's 100 and 50.
    Point(
        "figure 6",
        "figure 6",
        ("tight", "all"),
        (*PAPER, "or-hitl-window", "autonomous"),
        (10, 20, 30),
        tasks=20,
    ),
    Point(
        "figure 6",
        "figure 6",
        ("tight", "all"),
        (*PAPER, "or-hitl-window", "autonomous"),
        (1,),
        tasks=100,
    ),
    Point(
        "figure 6",
        "figure 6, 96 shared cores",
        ("tight",),
        PAPER,
        (10, 20, 30),
        tasks=20,
        changes={"compute": "shared:96"},
    ),
    Point(
        "figure 6",
        "figure 6, random winner",
        ("tight",),
        PAPER,
        (10, 20, 30),
        range(2),
        10,
        changes={"random_winner": 1.0},
    ),
    # From where autonomy alone does nearly all, to where it does a third.
    Point(
        "difficulty", "", tuple(f"{n} objects" for n in NUMBERS), ("autonomous", *RANKING), (10,)
    ),
    *(
        Point("robustness", setting, ("packed",), MAIN, (10,), range(3), changes=changes)
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
