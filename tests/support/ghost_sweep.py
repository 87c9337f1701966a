"""A sweep of the toy engine as a script, with worker processes: to be killed by tests.

Arguments: the folder; then --slow: each call of the engine takes a while; --deadly: the process
that computes a certain cell ends in the midst of it; and more of `pgf-jax sweep`.
"""

import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import sweep_toys  # registers the toys, in the processes too

from pgf_jax.cli import main

if "--slow" in sys.argv or "--deadly" in sys.argv:
    rollout = sweep_toys.Ghost.rollout

    def troubled(self, *arguments, **more):
        time.sleep(0.02 if "--slow" in sys.argv else 0.0)
        return rollout(self, *arguments, **more)

    sweep_toys.Ghost.rollout = troubled

if "--deadly" in sys.argv:
    from pgf_jax.simulation import planned_robots

    begin = planned_robots.PlannedRobots.begin

    def begin_or_die(self, robot, task):
        # The one fleet of so many robots.
        if len(self._to_do) == 3 and robot == 2 and task == 1:
            os._exit(9)
        return begin(self, robot, task)

    planned_robots.PlannedRobots.begin = begin_or_die


if __name__ == "__main__":
    fleets = "--policies or-hitl autonomous always queue --robots 1 2 3 --tasks 2"
    # Nothing that a ghost does is true in any world.
    toys = "--engine ghost --operator nudge --lanes 4 --world none --physics authors"
    own = [word for word in sys.argv[2:] if word not in ("--slow", "--deadly")]
    workers = [] if "--scheduler" in own else ["--workers", "2"]
    sys.exit(main(["sweep", *fleets.split(), *toys.split(), *workers, "--out", sys.argv[1], *own]))
