"""Pictures and films of a plan, of one robot's task, or of a whole fleet.

Read `command.py` first: it turns the settings into a picture or a film. `fleet_view.py` draws all
robots at one instant, `robot_view.py` one robot; both let a `ShelfView` draw the shelves (`top.py`
from above, `shelf3d.py` in three dimensions). `motion.py` simulates a plan again, `movie.py` writes
the files.

Imports `plans`, `sweeping` and what is below them.
"""
