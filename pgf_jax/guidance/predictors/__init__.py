"""Predictors: what a robot would gain from input, which is what it bids.

Read `features.py` first: the numbers that describe a robot's reach. `network.py` has the networks
that predict from them (Papallas & Dogar 2022, Alg. 3), `survival.py` predicts the time that a reach
still takes, `checkpoint.py` has their files, and `registry.py` finds predictors by name.
`true_gain.py` computes the gain instead, by rollouts.

This room may import `fleet` and the layers below it, and of `guidance` only `view`, `geometry` and
`trials`.
"""
