"""`profile`: measures the throughput of the physics engines, and the parts of an iteration.

Read `profile.py`: it decides whose turn it is. `measure.py` is what the measured processes do,
`report.py` the printed tables, `config.py` the settings.

May import `planning`, `physics`, `scene`, `parallel` and the modules below them.
"""
