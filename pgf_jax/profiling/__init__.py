"""`profile`: measures the throughput of the physics engines, and the parts of an iteration.

Read `profile.py`; `config.py` has the settings.

May import `planning`, `physics`, `scene` and the modules below them.
"""
