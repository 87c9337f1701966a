"""Pictures and films: a plan, a robot's task, or a fleet's wall of shelves.

`wall.draw` is a fleet at an instant, `panel.draw` one robot; both take their shelves from a `View`,
`top.TopView` or `shelf3d.ShelfView`. `motion.Motion` is a plan in time, `movie` writes files.
"""
