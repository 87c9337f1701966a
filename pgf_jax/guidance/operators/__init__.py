"""Operators: simulated persons, who look at a robot and tell it which object to push where.

Read `base.py` first: the two protocols, and how an operator is asked. `registry.py` finds operators
by name. `heuristic.py` weighs pushes by geometry, `noisy.py` adds a person's errors to it, and
`oracle.py` tries pushes by rollouts, as an upper bound.

This room may import `fleet` and the layers below it, and of `guidance` only `view`, `geometry` and
`trials`. `base.py` and `registry.py` import no JAX, since the command line lists the operators.
"""
