"""Plugins: policies, operators and engines of the user's own, found by name.

Read `registry.py` first: a registry holds the built-in objects of one kind, and those that plugins
register. `loading.py` imports plugins, also in worker processes. `digest.py` computes the digests
by which results say what a plugin was made of.

Imports only the modules of helpers (`settings`, `files`, `errors`).
"""
