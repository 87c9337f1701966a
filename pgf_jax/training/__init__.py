"""Training: fits the predictors' networks to collected data (Papallas & Dogar 2022, Alg. 3).

Read `train.py` first: from a folder of data to checkpoints. `rows.py` makes training rows of
runs and forks, `fit.py` fits one network to rows, `config.py` has the settings, and `command.py`
shows the results on the command line.

This room may import `tables` and the layers below it. `config.py` and `rows.py` import no JAX.
"""
