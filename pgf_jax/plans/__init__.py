"""Plans of single scenes, without a fleet, and the files that hold them.

Read `plan.py` first; `file.py` has the `Plan` and its JSON, `command.py` is `pgf-jax plan`.

Imports `simulation` and what is below it.
"""
