"""Collection of data to train the predictors on: runs, forks, recorded sessions.

Read `collect.py` first; `dataset.py` is the folder on disk, `scenes.py` computes its scenes in one
process or several, `fork.py` one fork, and `sessions.py` replays what people did.

Imports `sweeping` (for replays), `simulation` and what is below them.
"""
