"""Checks stored results: files against what was written, and cells by computing them again.

Read `verify.py` first; `folder_check.py` checks every file of a sweep's folder, `reproduce.py`
computes one iteration again, and `iteration.py` says what its rollouts did.

Imports `sweeping` and what is below it.
"""
