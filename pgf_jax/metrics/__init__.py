"""Metrics of a fleet, from its records and events alone: of tasks, of the operators' attention.

Read `summary.py` first; `attention.py` and `effort.py` are about the operators, and `identities.py`
holds what is true of every fleet, to the nanosecond.
"""
