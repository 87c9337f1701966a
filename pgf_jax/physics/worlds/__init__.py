"""Worlds in three dimensions, in which plans are checked and executed: by MuJoCo in C.

Read `world.py` first: what a world is, and how a segment is executed in it. `solid.py` is the world
of our own, with its model in `solid_model.py`; `scene.py` is the world that a published scene file
describes, with its reader in `scene_model.py`. `engine.py` makes the solid world an engine, so that
anything can be planned in it.

This room may import its parent room, `scene` and the layers below it.
"""
