"""Executors for work on several cores and computers; each is one of `concurrent.futures`.

`local.py` has the worker processes of this computer, `dask_executor.py` the workers of a Dask
scheduler, which `cluster.py` opens where Dask is installed.

Imports only `plugins` and the layers below it.
"""
