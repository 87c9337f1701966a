"""The contents of `manifest.json` and `run.json`.

The manifest says what the results of a sweep are and where they come from; it is the same whenever
and wherever the sweep is computed on one type of processor. Times, hosts and workers are in
`run.json`.
"""

import dataclasses
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pgf_jax.files import sha256
from pgf_jax.fleet.config import Cell
from pgf_jax.physics.engine import contact_slots
from pgf_jax.plugins.registry import plugins_record
from pgf_jax.provenance import host, origin
from pgf_jax.sweeping.cell_file import FOLDER, Content
from pgf_jax.sweeping.config import HOW, SCENES, SweepConfig
from pgf_jax.sweeping.resolve import FORMAT, ResolvedSweep
from pgf_jax.sweeping.run_cells import BatchStats


def settings(config: SweepConfig) -> dict[str, Any]:
    """A sweep's configuration, as JSON, without how and where it is computed."""
    values = {
        field.name: getattr(config, field.name)
        for field in dataclasses.fields(config)
        if field.name not in HOW
    }
    if isinstance(config.scenes, tuple):
        values["scenes"] = SCENES
    return {name: str(v) if isinstance(v, Path) else v for name, v in values.items()}


def about(sweep: ResolvedSweep) -> dict[str, Any]:
    """Where the merged results come from, for the metadata of their files."""
    return {
        "format": FORMAT,
        "config": settings(sweep.config),
        "predictors": {name: file["sha256"] for name, file in sweep.predictor_files.items()},
        "plugins": _plugins(sweep),
        **origin(),
    }


def origins(tables: Iterable[Content]) -> list[dict[str, Any]]:
    """The types of processor and code that cells were computed by, with their counts."""
    counts: dict[str, int] = {}
    for content in tables:
        origin = {name: content.about.get(name) for name in ("processor", "code")}
        text = json.dumps(origin, sort_keys=True)
        counts[text] = counts.get(text, 0) + 1
    return [json.loads(text) | {"cells": counts[text]} for text in sorted(counts)]


def manifest(
    sweep: ResolvedSweep,
    tables: Mapping[Cell, Content],
    digests: Mapping[Cell, str],
    files: Mapping[str, bytes],
) -> dict[str, Any]:
    """The manifest of a sweep that has ended.

    Args:
      sweep: with its inputs.
      tables: the content of its cells.
      digests: of its cells' files.
      files: the merged results, by name.
    """
    config = sweep.config
    physics = config.physics_values()
    return {
        "format": FORMAT,
        "config": settings(config),
        "cells": [
            {
                **dataclasses.asdict(spec.cell),
                "file": f"{FOLDER}/{spec.key}.parquet",
                "sha256": digests[spec.cell],
            }
            for spec in sweep.cells
        ],
        "seed": None if config.seeds else config.seed,
        "engine": config.engine,
        "lanes": config.engine_lanes(),
        "rollouts": config.planner().rollouts,
        "physics": dataclasses.asdict(physics)
        | {"substep_s": physics.substep_s, "contact_slots": contact_slots(sweep.scenes.n_objects)},
        "planner": dataclasses.asdict(config.planner()),
        "scenes": _scenes(sweep),
        "predictors": sweep.predictor_files,
        "plugins": _plugins(sweep),
        **origin(),
        "origins": origins(tables.values()),
        "files": {name: sha256(data) for name, data in files.items()},
    }


def run_record(
    config: SweepConfig,
    *,
    kept: Iterable[str],
    stats: Iterable[BatchStats],
    wall_s: float,
    cells_s: float,
    together: int,
    retried: int,
) -> dict[str, Any]:
    """The content of `run.json`: how a sweep was run the last time.

    Args:
      config: of the sweep.
      kept: names of the cells that were finished before.
      stats: of each batch.
      wall_s: time of this run, s, compilation included.
      cells_s: of it, until the last cell was there.
      together: sweeps that were run as one; stats and time are of all of them.
      retried: cells that were computed again, after a worker's death.
    """
    stats = list(stats)
    used, computed = sum(s.used for s in stats), sum(s.computed for s in stats)
    return {
        "out": str(config.out),
        "host": host(),
        "workers": config.scheduler or config.processes(),
        "batches": len(stats),
        "cells_kept": list(kept),
        "cells_sent_again": retried,
        "wall_clock": {
            "wall_s": wall_s,
            "cells_s": cells_s,
            "compile_s": [batch.compile_s for batch in stats],
            "engine_s": [batch.engine_s for batch in stats],
            "answering_s": [batch.answering_s for batch in stats],
            "batch_s": [batch.wall_s for batch in stats],
            "sweeps_run_together": together,
            "note": "wall_s is of the cells that were not kept, of all sweeps that were run "
            "together; a batch's time includes compile_s, of a process's first call, with the "
            "compilation of its programs where they were not cached",
        },
        "iterations": {
            "of_robots": sum(s.iterations for s in stats),
            "computed": sum(s.steps for s in stats),
            "note": "computed: once for all fleets of a batch that go the same way; with those "
            "that operators imagine",
        },
        "occupancy": {
            "calls": sum(s.calls for s in stats),
            "used": used,
            "computed": computed,
            "share": used / computed if computed else None,
        },
    }


def _plugins(sweep: ResolvedSweep) -> dict[str, Any]:
    """What the sweep uses of plugins."""
    return plugins_record(plugin for cell in sweep.cells for plugin in cell.plugins)


def _scenes(sweep: ResolvedSweep) -> dict[str, Any]:
    scenes = sweep.scenes
    if scenes.files is None:
        return {"class": scenes.scene_class, "objects": scenes.n_objects}
    return {
        "folder": settings(sweep.config)["scenes"],
        "files": len(scenes.files),
        "sha256": scenes.digest,
        "objects": scenes.n_objects,
    }
