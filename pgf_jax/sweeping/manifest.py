"""`manifest.json`: what the results of a sweep are and where they come from; `run.json`: how.

The first is the same whenever and wherever the sweep is computed on one type of processor; times,
hosts and workers are in the second.
"""

import dataclasses
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pgf_jax.files import sha256
from pgf_jax.fleet.config import Cell
from pgf_jax.physics.config import PHYSICS
from pgf_jax.physics.engine import MAX_CONTACTS
from pgf_jax.provenance import environment, host
from pgf_jax.sweeping.cell_store import FOLDER, Content
from pgf_jax.sweeping.config import HOW, SweepConfig
from pgf_jax.sweeping.resolve import FORMAT, Setup, scenes_digest
from pgf_jax.sweeping.run_cells import BatchStats


def settings(config: SweepConfig) -> dict[str, Any]:
    """A sweep's configuration, as JSON, without how and where it is computed."""
    return {
        name: str(value) if isinstance(value, Path) else value
        for name, value in dataclasses.asdict(config).items()
        if name not in HOW
    }


def about(setup: Setup) -> dict[str, Any]:
    """Where the merged results come from, for the metadata of their files."""
    config = setup.config
    return {
        "format": FORMAT,
        "config": settings(config),
        "predictors": {name: file["sha256"] for name, file in setup.predictor_files.items()},
        **environment(),
    }


def origins(tables: Iterable[Content]) -> list[dict[str, Any]]:
    """The types of processor, and the code, that cells were computed by: one, or else mixed."""
    counts: dict[str, int] = {}
    for content in tables:
        origin = {name: content.about.get(name) for name in ("processor", "code")}
        text = json.dumps(origin, sort_keys=True)
        counts[text] = counts.get(text, 0) + 1
    return [json.loads(text) | {"cells": counts[text]} for text in sorted(counts)]


def manifest(
    setup: Setup,
    keys: Mapping[Cell, str],
    tables: Mapping[Cell, Content],
    digests: Mapping[Cell, str],
    files: Mapping[str, bytes],
) -> dict[str, Any]:
    """The manifest of a sweep that has ended.

    Args:
      setup: of the sweep.
      keys: names of its cells.
      tables: what is in them.
      digests: of its cells' files.
      files: the merged results, by name.
    """
    config = setup.config
    physics = PHYSICS[config.physics]
    return {
        "format": FORMAT,
        "config": settings(config),
        "cells": [
            {
                **dataclasses.asdict(cell),
                "file": f"{FOLDER}/{keys[cell]}.parquet",
                "sha256": digests[cell],
            }
            for cell in config.cells()
        ],
        "seed": config.seed,
        "engine": config.engine,
        "lanes": config.engine_lanes(),
        "rollouts": config.planner().rollouts,
        "physics": dataclasses.asdict(physics)
        | {"substep_s": physics.substep_s, "contact_slots": MAX_CONTACTS},
        "planner": dataclasses.asdict(config.planner()),
        "scenes": _scenes(setup),
        "predictors": setup.predictor_files,
        **environment(),
        "origins": origins(tables.values()),
        "files": {name: sha256(data) for name, data in files.items()},
    }


def run_record(
    config: SweepConfig,
    *,
    kept: Iterable[Cell],
    efforts: Iterable[BatchStats],
    wall_s: float,
    cells_s: float,
    together: int,
    again: int,
) -> dict[str, Any]:
    """How a sweep was run, the last time.

    Args:
      config: of the sweep.
      kept: cells that were finished before.
      efforts: one a batch.
      wall_s: time of this run, s, compilation included.
      cells_s: of it, until the last cell was there.
      together: sweeps that were run as one; efforts and time are of all of them.
      again: cells that were sent again, after a worker's death.
    """
    efforts, kept = list(efforts), set(kept)
    used, computed = sum(e.used for e in efforts), sum(e.computed for e in efforts)
    return {
        "out": str(config.out),
        "host": host(),
        "workers": config.scheduler or config.processes(),
        "batches": len(efforts),
        "cells_kept": [cell.name for cell in config.cells() if cell in kept],
        "cells_sent_again": again,
        "wall_clock": {
            "wall_s": wall_s,
            "cells_s": cells_s,
            "compile_s": [effort.compile_s for effort in efforts],
            "engine_s": [effort.engine_s for effort in efforts],
            "answering_s": [effort.answering_s for effort in efforts],
            "batch_s": [effort.wall_s for effort in efforts],
            "sweeps_run_together": together,
            "note": "wall_s is of the cells that were not kept, of all sweeps that were run "
            "together; a batch's time includes compile_s, of a process's first call, with the "
            "compilation of its programs where they were not cached",
        },
        "iterations": {
            "of_robots": sum(e.iterations for e in efforts),
            "computed": sum(e.steps for e in efforts),
            "note": "computed: once for all fleets of a batch that go the same way; with those "
            "that operators imagine",
        },
        "occupancy": {
            "calls": sum(e.calls for e in efforts),
            "used": used,
            "computed": computed,
            "share": used / computed if computed else None,
        },
    }


def _scenes(setup: Setup) -> dict[str, Any]:
    if setup.files is None:
        return {"class": setup.config.sampled_class(), "objects": setup.n_objects}
    return {
        "folder": str(setup.config.scenes),
        "files": len(setup.files),
        "sha256": scenes_digest(setup.files),
        "objects": setup.n_objects,
    }
