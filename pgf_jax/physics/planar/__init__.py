"""Engine `planar`: MuJoCo's contact problem for disks on a plane with a kinematic hand, in JAX.

Read `engine.py` first. Below it: `reach.py` finds the objects that can move in a knot, `motion.py`
does a knot's substeps, `contact.py` has the contact problem of a substep and `solver.py` its
solution, `constants.py` the numbers. README.md lists what was tried for speed.

This room may import its parent room, `scene` and the layers below it.
"""
