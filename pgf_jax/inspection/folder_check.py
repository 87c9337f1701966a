"""Checks every file in a folder of results against the other files there."""

import dataclasses
import json
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from pgf_jax.errors import BadInput
from pgf_jax.files import MIB, read_file, read_json, sha256
from pgf_jax.fleet.config import Cell
from pgf_jax.settings import stored_settings
from pgf_jax.sweeping import cell_file, columns
from pgf_jax.sweeping.cell_store import MANIFEST, RESULTS, RUN
from pgf_jax.sweeping.config import INPUTS, SCENES, SweepConfig
from pgf_jax.sweeping.manifest import settings
from pgf_jax.sweeping.resolve import differences
from pgf_jax.sweeping.summary import (
    csv,
    fleets_frame,
    over_fleets,
    paired_differences,
    paired_frame,
    summary_frame,
    summary_of,
)
from pgf_jax.tables import results
from pgf_jax.tables.parquet import decode_table

# A setting that a stored cell lacks has the value that was built in then.
_DEFAULTS = json.loads(json.dumps(settings(SweepConfig())))
_ALONE = "there is no file beside it that says how it was computed"
_LARGEST_FILE = 2048 * MIB
# A manifest has these of its cells, too.
_COMMON = ("format", "seed", "engine", "lanes", "planner", "versions", "device")


class Finding(NamedTuple):
    """A file that is not as it was written.

    Attributes:
      path: of the file.
      what: truncated, edited, duplicate, foreign, missing; and why.
    """

    path: Path
    what: str


@dataclasses.dataclass(frozen=True)
class Checked:
    """The outcome of a check of a folder.

    Attributes:
      findings: what is wrong.
      sound: the cells that are as they were written: file -> content.
      complete: whether the sweep was finished: there is a manifest.
    """

    findings: tuple[Finding, ...]
    sound: Mapping[Path, cell_file.Content]
    complete: bool


def check_files(out: Path) -> Checked:
    """Check every file of a folder of results.

    Raises:
      BadInput: it is none.
    """
    if not (out / cell_file.FOLDER).is_dir():
        raise BadInput(f"{out}: holds no results of a sweep (no folder {cell_file.FOLDER})")
    findings: list[Finding] = []
    sound = _cells(out, findings)
    manifest = _manifest(out, findings)
    if manifest is None:
        sound = _of_one_sweep(sound, findings)
        for name in RESULTS:
            if (out / name).exists():
                findings.append(Finding(out / name, f"foreign: without a {MANIFEST}"))
    else:
        sound = _against_manifest(out, manifest, sound, findings)
        _merged(out, manifest, sound, findings)
    known = {*(RESULTS if manifest is None else _listed(manifest)), MANIFEST, RUN, SCENES}
    known.add(cell_file.FOLDER)
    for path in sorted(out.iterdir()):
        if path.name not in known:
            findings.append(Finding(path, "foreign: no sweep writes it"))
    return Checked(tuple(findings), sound, manifest is not None)


def _cells(out: Path, findings: list[Finding]) -> dict[Path, cell_file.Content]:
    """The sound cells, by file; the others are added to the findings."""
    folder = out / cell_file.FOLDER
    sound: dict[Path, cell_file.Content] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix == ".parquet" and path.is_file() and not path.name.startswith("."):
            try:
                data = cell_file.check(path)
                content = cell_file.decode(data, path)
            except BadInput as error:
                findings.append(Finding(path, _reason(path, error)))
                continue
            if not cell_file.sidecar(path).exists():
                findings.append(Finding(path, f"foreign: {_ALONE}"))
            name = cell_file.key(content.about["identity"])
            if name == path.stem:
                sound[path] = content
            elif cell_file.path(out, name).exists():
                findings.append(Finding(path, f"duplicate: it is the cell of {name}.parquet"))
            else:
                findings.append(Finding(path, f"edited or renamed: it says it is {name}"))
        elif path.suffix == ".json" and cell_file.is_key(path.stem):
            if not path.with_suffix(".parquet").exists():
                findings.append(Finding(path, "foreign: without the cell that it is about"))
        else:
            findings.append(Finding(path, "foreign: no finished sweep leaves it"))
    return sound


def _reason(path: Path, error: BadInput) -> str:
    """Why a cell cannot be read."""
    words = str(error).removeprefix(f"{path}: ")
    if not cell_file.sidecar(path).exists():
        words = f"foreign: {_ALONE}, and it is no cell ({words})"
    elif words.startswith("truncated or edited"):
        length = cell_file.read_account(path).get("bytes")
        found = path.stat().st_size
        if isinstance(length, int) and found < length:
            return f"truncated: {found} of {length} bytes"
        return "edited: its digest is not the one in the file beside it"
    return words


def _manifest(out: Path, findings: list[Finding]) -> dict[str, Any] | None:
    if not (out / MANIFEST).exists():
        return None
    try:
        manifest = read_json(out / MANIFEST)
        listed = [(cell["file"], cell["sha256"], cell["policy"]) for cell in manifest["cells"]]
        named = [manifest["files"][name] for name in _listed(manifest)]
        if not all(isinstance(text, str) for row in (*listed, named) for text in row):
            raise TypeError
        # A name that is none of a cell's may lead anywhere.
        names = [(file, Path(file).stem) for file, *_ in listed]
        good = (cell_file.is_key(key) and out / f == cell_file.path(out, key) for f, key in names)
        if not names or not all(good):
            raise KeyError
        return manifest
    except BadInput as error:
        findings.append(Finding(out / MANIFEST, str(error).removeprefix(f"{out / MANIFEST}: ")))
    except (KeyError, TypeError):
        findings.append(Finding(out / MANIFEST, "edited: it does not list cells and files"))
    return None


def _of_one_sweep(
    sound: Mapping[Path, cell_file.Content], findings: list[Finding]
) -> dict[Path, cell_file.Content]:
    """The cells of an unfinished sweep: those with the settings that most cells have."""

    def common(content: cell_file.Content) -> str:
        config = content.about.get("config")
        own = ("robots", "policies", "tasks", "seed")
        shared = _DEFAULTS | stored_settings(config) if isinstance(config, dict) else {}
        return str({name: value for name, value in shared.items() if name not in own})

    counts = Counter(map(common, sound.values()))
    usual = counts.most_common(1)[0][0] if counts else ""
    ours = {}
    for path, content in sound.items():
        if common(content) == usual:
            ours[path] = content
        else:
            findings.append(Finding(path, "foreign: of another configuration than the others"))
    return ours


def _against_manifest(
    out: Path,
    manifest: Mapping[str, Any],
    sound: Mapping[Path, cell_file.Content],
    findings: list[Finding],
) -> dict[Path, cell_file.Content]:
    listed = {out / cell["file"]: cell for cell in manifest["cells"]}
    for path, cell in listed.items():
        if not path.exists():
            findings.append(Finding(path, f"missing: {MANIFEST} lists it"))
        elif path in sound and sha256(path.read_bytes()) != cell["sha256"]:
            findings.append(Finding(path, f"edited: its digest is not the one in {MANIFEST}"))
    ours = {}
    for path, content in sound.items():
        if path not in listed:
            findings.append(Finding(path, f"foreign: {MANIFEST} does not list it"))
            continue
        said = _in_manifest(manifest, listed[path])
        words = differences({name: _in_cell(content.about, name) for name in said}, said)
        if words:
            findings.append(Finding(out / MANIFEST, f"edited: of {path.name} {words}"))
        ours[path] = content
    return ours


def _in_manifest(manifest: Mapping[str, Any], cell: Mapping[str, Any]) -> dict[str, Any]:
    """The values that a manifest has for a cell, by name."""
    said = {name: manifest.get(name) for name in _COMMON}
    if said["seed"] is None:  # the sweep has several
        said["seed"] = cell.get("seed")
    versions = said["versions"]
    if isinstance(versions, dict):  # an identity has those that decide
        said["versions"] = {
            n: v for n, v in versions.items() if n not in ("python", "flax", "numpy")
        }
    config = manifest.get("config")
    if isinstance(config, dict):
        config = stored_settings(config)
        # Those two are None where the sweep was to choose; and a cell has not all fleets.
        chosen = {n for n in ("scene_class", "lanes") if config.get(n) is None}
        left_out = {*INPUTS, "robots", "policies", "tasks", "seed", "seeds"} | chosen
        said |= {f"config.{n}": value for n, value in config.items() if n not in left_out}
    return said | {name: cell.get(name) for name in ("policy", "robots", "tasks")}


def _in_cell(about: Mapping[str, Any], name: str) -> Any:
    """The value of that name in the cell itself."""
    place, within, default = about["identity"], name, None
    if name.startswith("config."):
        place, within = about.get("config"), name.removeprefix("config.")
        place = stored_settings(place) if isinstance(place, dict) else place
        default = _DEFAULTS.get(within)
    elif name in ("policy", "robots", "tasks", "seed"):
        place = place.get("fleet")
    return place.get(within, default) if isinstance(place, dict) else None


def _merged(
    out: Path,
    manifest: Mapping[str, Any],
    sound: Mapping[Path, cell_file.Content],
    findings: list[Finding],
) -> None:
    """Check the merged files against the manifest, and against the cells they were merged from."""
    whole = all(out / cell["file"] in sound for cell in manifest["cells"])
    expected = _remade(out, manifest, sound) if whole else {}
    for name in _listed(manifest):
        path = out / name
        try:
            data = read_file(path, "results of a sweep", _LARGEST_FILE)
        except BadInput as error:
            words = str(error).removeprefix(f"{path}: ")
            findings.append(Finding(path, f"missing: {words}" if not path.exists() else words))
            continue
        if sha256(data) != manifest["files"][name]:
            findings.append(Finding(path, f"edited: its digest is not the one in {MANIFEST}"))
        elif name in expected and not _is(expected[name], path, data):
            findings.append(Finding(path, "edited: it does not follow from the cells"))


@np.errstate(all="ignore")  # of times that no sweep has, but an edited cell may
def _remade(
    out: Path, manifest: Mapping[str, Any], sound: Mapping[Path, cell_file.Content]
) -> dict[str, Any]:
    """Merge the cells again, by file; empty where that is impossible."""
    try:
        tables = {}
        for listed in manifest["cells"]:
            seed = listed.get("seed", manifest.get("seed"))  # earlier versions had one for all
            cell = Cell(listed["policy"], listed["robots"], listed["tasks"], seed)
            tables[cell] = sound[out / listed["file"]]
        records = {cell: content.records for cell, content in tables.items()}
        summaries = [*map(summary_of, tables.values())]
        merged = {name: columns.merged(tables.values(), name) for name in cell_file.TABLES}
    except (BadInput, KeyError, TypeError, ZeroDivisionError, pl.exceptions.PolarsError):
        return {}
    return {
        "tasks.parquet": merged["tasks"],
        "events.parquet": merged["events"],
        "summary.csv": summary_frame(summaries),
        "fleets.csv": fleets_frame(over_fleets(summaries)),
        "paired.csv": paired_frame(paired_differences(records)),
    }


# What earlier versions did not write yet: a file, columns, rows.
_ADDED = "fleets.csv"
_EARLIER: Mapping[str, Callable[[pl.DataFrame], pl.DataFrame]] = {
    "summary.csv": lambda frame: frame.select(pl.exclude("^task_time_s.*$")),
    "paired.csv": lambda frame: frame.filter(pl.col("value") != "task_time_s"),
}


def _listed(manifest: Mapping[str, Any]) -> list[str]:
    """Names of the merged files of a sweep."""
    return [name for name in RESULTS if name != _ADDED or name in manifest["files"]]


def _is(expected: pl.DataFrame, path: Path, data: bytes) -> bool:
    if path.suffix == ".csv":
        earlier = _EARLIER.get(path.name)
        return csv(expected) == data or (earlier is not None and csv(earlier(expected)) == data)
    schema = results.MERGED_TASK_SCHEMA if path.stem == "tasks" else results.MERGED_EVENT_SCHEMA
    try:
        found = results.conform(decode_table(data, path)[0], path, schema, others=True)
        if set(results.EXTRA_SCHEMA) & (set(expected.columns) - set(found.columns)):
            return False
        # Tables of earlier versions have no columns of settings.
        return found.equals(expected.select(found.columns))
    except (BadInput, pl.exceptions.PolarsError):
        return False
