"""Tables on disk: results and event logs of fleets, and training data (runs and forks).

Read `parquet.py` first: it reads and writes one table with fixed columns. `results.py` has the
tables of tasks and events, `event_log.py` the logs of sessions and sweeps, `runs.py` and `forks.py`
the training data. `decoder.py` decodes Parquet files of unknown origin in a separate process.

May import `guidance`, `fleet`, `planning` and the modules below them.
"""
