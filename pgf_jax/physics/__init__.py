"""Physics: the planar world, and the engines that roll out a hand's motion in it.

Read `engine.py` first: the protocol `Engine` and the registry. `config.py` has the constants,
`hand.py` the hand's shape, and `model.py` the MuJoCo model that all engines share. The engines are
`planar/` (the default), `native.py` (MuJoCo's C engine, the reference) and `mjx.py`. `flops.py`
counts the floating-point operations of an engine's step. `worlds/` has the worlds in three
dimensions that judge what an engine proposes.

This room may import `scene` and the layers below it.
"""
