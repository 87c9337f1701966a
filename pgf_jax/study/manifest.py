"""`manifest.json`: how the results of a sweep came about; times of the wall clock are here only."""

import dataclasses
import importlib.metadata
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax

import pgf_jax
from pgf_jax.physics.config import PHYSICS
from pgf_jax.physics.engine import MAX_CONTACTS
from pgf_jax.study.results import cell_folder, json_bytes, sha256
from pgf_jax.study.sweep_config import Cell
from pgf_jax.study.sweep_run import Effort
from pgf_jax.study.sweep_setup import FORMAT, PACKAGES, Setup, identity, scenes_digest


def manifest(
    setup: Setup,
    *,
    kept: Iterable[Cell],
    efforts: Iterable[Effort],
    wall_s: float,
    together: int,
    files: Mapping[str, bytes],
) -> dict[str, Any]:
    """The manifest of a sweep that has ended.

    Args:
      setup: of the sweep.
      kept: cells that were finished before.
      efforts: one a process.
      wall_s: time of this run, s, compilation included.
      together: sweeps that were run as one; efforts and time are of all of them.
      files: the results, by name.
    """
    config, efforts, kept = setup.config, list(efforts), set(kept)
    physics = PHYSICS[config.physics]
    used, computed = sum(e.used for e in efforts), sum(e.computed for e in efforts)
    lanes = config.engine_lanes()
    return {
        "format": FORMAT,
        "config": {
            name: str(value) if isinstance(value, Path) else value
            for name, value in dataclasses.asdict(config).items()
        },
        "cells": [
            {
                **dataclasses.asdict(cell),
                "folder": str(cell_folder(Path(), cell)),
                "identity_sha256": sha256(json_bytes(identity(setup, cell))),
                "kept": cell in kept,
            }
            for cell in config.cells()
        ],
        "seed": config.seed,
        "engine": config.engine,
        "lanes": lanes,
        "rollouts": config.planner().rollouts,
        "physics": dataclasses.asdict(physics) | {"substep_s": physics.substep_s},
        "planner": dataclasses.asdict(config.planner()),
        "scenes": _scenes(setup),
        "predictors": setup.predictor_files,
        "workers": len(efforts),
        "wall_clock": {
            "wall_s": wall_s,
            "compile_s": [effort.compile_s for effort in efforts],
            "sweeps_run_together": together,
            "note": "wall_s includes compile_s: each process's first call, with the compilation of "
            "its programs where they were not cached; it covers the cells that were not kept, of "
            "all sweeps that were run together",
        },
        "iterations": {
            "of_robots": sum(e.iterations for e in efforts),
            "computed": sum(e.steps for e in efforts),
            "note": "computed: once for all fleets that go the same way; with those that operators "
            "imagine",
        },
        "occupancy": {
            "calls": sum(e.calls for e in efforts),
            "used": used,
            "computed": computed,
            "share": used / computed if computed else None,
        },
        "contact_slots": {
            "rollouts_with_all_in_use": sum(e.saturated for e in efforts),
            "note": f"at a knot end, of {MAX_CONTACTS}; contacts beyond them are dropped",
        },
        **environment(),
        "files": {name: sha256(data) for name, data in files.items()},
    }


def environment() -> dict[str, Any]:
    """Versions, platform, device and commit."""
    return {
        "versions": {"python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in PACKAGES},
        "platform": f"{platform.platform()}, {os.cpu_count()} CPUs ({sys.byteorder} endian)",
        "device": {
            "backend": jax.default_backend(),
            "kind": jax.devices()[0].device_kind,
            "count": jax.device_count(),
        },
        "git": git_commit(Path(pgf_jax.__file__).resolve().parents[1]),
    }


def git_commit(root: Path) -> dict[str, Any] | None:
    """The commit checked out in a folder, and whether files differ from it; None if unknown."""
    if not (root / ".git").exists():  # installed: a repository around it would be another one
        return None
    try:
        commit, status = (
            subprocess.run(
                ["git", "-C", str(root), *words],
                capture_output=True,
                text=True,
                check=True,
                timeout=10,
            ).stdout
            for words in (["rev-parse", "HEAD"], ["status", "--porcelain"])
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit.strip(), "modified": bool(status.strip())}


def _scenes(setup: Setup) -> dict[str, Any]:
    if setup.files is None:
        return {"class": setup.config.sampled_class(), "objects": setup.n_objects}
    return {
        "folder": str(setup.config.scenes),
        "files": len(setup.files),
        "sha256": scenes_digest(setup.files),
        "objects": setup.n_objects,
    }
