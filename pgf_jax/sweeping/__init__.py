"""Sweeps: fleets of several sizes under several policies on the same scenes.

Read `sweep.py` first: it resolves the configuration (`resolve.py`), looks for finished cells
(`cell_store.py`, `cell_file.py`), computes the missing ones (`dispatch.py`, `worker.py`,
`run_cells.py`), and writes the tables, the figure and the manifest.

Imports `simulation` and what is below it, `parallel` too.
"""
