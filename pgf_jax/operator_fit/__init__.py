"""`fit-operator`: fits the service time distribution of sweeps to recorded sessions.

Read `command.py` first: it reads services from event logs, fits, prints and draws. `lognormal.py`
is the statistics: a log-normal fit to right-censored times, with bootstrap intervals.

May import `tables`, `fleet` and the modules below them; it needs nothing of JAX.
"""
