"""Planning: the paper's planner for many robots at once (Papallas & Dogar 2022, Alg. 1).

Read `planner.py` first: a `Search` and the iterations that improve it. `cost.py` has the cost
terms, `nominal.py` the initial trajectories, `candidates.py` what becomes of an iteration whose
solutions are checked in a world, `config.py` the settings, and `types.py` the small types that
other rooms share. `config.py` and `types.py` import no JAX.

This room may import `physics` and the layers below it.
"""
