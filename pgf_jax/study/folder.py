"""A folder of results: whose it is, what of it is finished, and what a cell of it is made from."""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgf_jax.errors import BadInput, shown
from pgf_jax.study import cells
from pgf_jax.study.sweep_config import INPUTS, Cell, SweepConfig
from pgf_jax.study.sweep_setup import Setup, identity

MANIFEST, RUN = "manifest.json", "run.json"
RESULTS = ("tasks.parquet", "events.parquet", "summary.csv", "paired.csv", "fig6.png")


def keys_of(setup: Setup) -> dict[Cell, str]:
    """The names of a sweep's cells."""
    return {cell: cells.key(identity(setup, cell)) for cell in setup.config.cells()}


def check_folder(setup: Setup, keys: Mapping[Cell, str]) -> set[Cell]:
    """Compare the results in a sweep's folder, if any, with its configuration.

    Returns:
      The cells that are finished and to be kept: none unless the configuration says `resume`.

    Raises:
      BadInput: the folder holds results of another configuration, or something that is neither;
        or, on resuming, a file that is not as it was written.
    """
    config, out = setup.config, setup.config.out
    if not out.exists():
        return set()
    if not out.is_dir():
        raise BadInput(f"out: {out} is a file, expected a folder")
    folder = out / cells.FOLDER
    old = sorted(folder.glob("*/cell.json"))
    if old:
        raise _foreign(old[0], "of an older version of pgf_jax", out)
    known = {key: cell for cell, key in keys.items()}
    found: set[Cell] = set()
    for key in sorted(cells.finished(out)):
        file = cells.path(out, key)
        if key not in known:
            raise _other(setup, file)
        found.add(known[key])
        if config.resume:
            cells.check(file)
    leftover = [name for name in (*RESULTS, MANIFEST) if (out / name).exists()]
    if leftover and not found:
        # Their cells are gone, and only they could say what these were computed from.
        raise _foreign(out / leftover[0], "without the cells they were merged from", out)
    return found if config.resume else set()


def check_writable(out: Path) -> None:
    """That a folder cannot be written should not turn up after hours.

    Raises:
      BadInput: it cannot.
    """
    for folder in (out, out / cells.FOLDER):
        if not os.access(folder, os.W_OK | os.X_OK):
            raise BadInput(f"out: {out} cannot be written to")


def reopen(out: Path) -> None:
    """Take away what was made from the cells: there will be others, and it is made again.

    So there is a manifest where a sweep is finished, and only there.

    Raises:
      BadInput: it cannot be taken away.
    """
    for name in (MANIFEST, RUN, *RESULTS):
        try:
            (out / name).unlink(missing_ok=True)
        except OSError as error:
            raise BadInput(f"{out / name}: cannot be replaced ({error.strerror})") from error


def _other(setup: Setup, file: Path) -> BadInput:
    """What to say about a cell that is none of this sweep's."""
    out = setup.config.out
    theirs = cells.decode(cells.check(file), file).about["identity"]
    fleet = theirs.get("fleet")
    for cell in setup.config.cells():
        if isinstance(fleet, dict) and (fleet.get("policy"), fleet.get("robots")) == (
            cell.policy,
            cell.robots,
        ):
            words = differences(theirs, identity(setup, cell)) or "by its name"
            return _foreign(file, f"of another configuration ({words})", out)
    what = "an unknown cell"
    if isinstance(fleet, dict):
        policy, robots = (shown(fleet.get(name), 40) for name in ("policy", "robots"))
        what = f"{policy} with {robots} robots, a cell"
    return _foreign(file, f"of {what} that this configuration has not", out)


def _foreign(file: Path, what: str, out: Path) -> BadInput:
    return BadInput(f"{file}: results {what}; choose another folder with --out, or delete {out}")


def differences(theirs: Any, ours: Mapping[str, Any]) -> str:
    """Where two identities differ, in words; empty where they do not."""
    if not isinstance(theirs, dict):
        return "it does not say which"
    words = []
    for key in [*ours, *(key for key in theirs if key not in ours)]:
        a, b = theirs.get(key), ours.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            inner = differences(a, b)
            words += [inner] if inner else []
        elif a != b or (key in theirs) != (key in ours):
            words.append(f"{_short(key)} {_short(a)}, now {_short(b)}")
    return "; ".join(words)


def _short(value: object) -> str:
    text = value if isinstance(value, str) and value.isprintable() else shown(value, 40)
    return text if len(text) <= 40 else text[:37] + "..."


def config_of(content: cells.Content, inputs: Mapping[str, Any], out: Path) -> SweepConfig:
    """The sweep of one cell alone.

    Args:
      content: the cell.
      inputs: where scenes, checkpoints and log lie, see `INPUTS`.
      out: folder for the results.

    Raises:
      BadInput: what the cell says of its configuration cannot be one.
    """
    settings = content.about.get("config")
    if not isinstance(settings, dict):
        raise BadInput("it does not say what its configuration was")
    known = {field.name for field in dataclasses.fields(SweepConfig)}
    unknown = sorted(settings.keys() - known)
    if unknown:
        raise BadInput(f"its configuration has {unknown[0]}, which a sweep has not")
    given: dict[str, Any] = {**settings, "out": out}
    for name in ("robots", "policies"):
        if isinstance(given.get(name), list):
            given[name] = tuple(given[name])
    for name in INPUTS:
        if inputs.get(name) is not None:
            given[name] = inputs[name] if name == "predictor" else Path(inputs[name])
    return SweepConfig(**given)
