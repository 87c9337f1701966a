"""Guidance: operators, who give input, and predictors of the gain from input.

Read `view.py` first: what an operator sees of a robot. `operators/` has the simulated operators,
`predictors/` the paper's networks (Papallas & Dogar 2022, Alg. 3). Both use `trials.py`, which
simulates an input by rollouts, and `geometry.py`, which measures a view.

This room may import `fleet` and the layers below it.
"""
