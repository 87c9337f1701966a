"""A folder of collected data: its settings, its parts, and the file that they are merged into.

Scenes are written in parts as they end, and merged when all of them have ended. What a run holds
depends on its scene and the settings alone. So the merged file is the same to the last bit, however
often the collection was interrupted.
"""

import dataclasses
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from pgf_jax.collection.config import CollectConfig
from pgf_jax.errors import BadInput
from pgf_jax.files import MIB, json_bytes, parse_json, read_file, write_atomically
from pgf_jax.guidance.operators.registry import world_plugins
from pgf_jax.plugins.registry import plugins_record
from pgf_jax.provenance import environment
from pgf_jax.settings import stored_settings
from pgf_jax.tables.forks import FORK, read_forks, read_futures, write_forks, write_futures
from pgf_jax.tables.parquet import read_provenance
from pgf_jax.tables.runs import RUN, Mode, read_runs, runs_path, write_runs

SETTINGS, PARTS = "collect.json", "parts"
_MOST_SCENES = 10_000_000  # what a file says may not fill the memory
# Settings that must be as they were for runs to be continued; more scenes may always be added.
_KEPT = (
    "mode",
    "classes",
    "seed",
    "engine",
    "physics",
    "cost",
    "update",
    "operator",
    "lanes",
    "task_limit",
    "ask_from",
    "ask_to",
    "keys",
)
# Settings that were added later, with the values that were built in before: data of those keep
# their bytes, and may be continued.
_FIELDS = [(field.name, field.default) for field in dataclasses.fields(CollectConfig)]
_LATER = dict(_FIELDS[_FIELDS.index(("resume", False)) + 1 :])


@dataclasses.dataclass(frozen=True)
class Dataset:
    """The data of one collection on disk; can be sent to another process.

    Attributes:
      config: of the collection.
      missing: numbers of the scenes that are not there yet.
      about: where the data come from, for the files' metadata.
    """

    config: CollectConfig
    missing: tuple[int, ...]
    about: Mapping[str, Any]

    @classmethod
    def open(cls, config: CollectConfig) -> "Dataset":
        """Begin a collection, or go on with an earlier one.

        Raises:
          BadInput: there are data already and `resume` is off, or they were made with other
            settings, or a file is corrupt, or the folder cannot be written.
        """
        assert config.scenes is not None
        _write_settings(config)
        about = {"settings": _settings(config), "versions": environment()["versions"]}
        files = _files(config)
        _read_all(config, files)  # a broken one is named before anything is computed
        done = set().union(*map(_scenes_in, files))
        return cls(config, tuple(i for i in range(config.scenes) if i not in done), about)

    def append(self, indices: list[int], frames: list[pl.DataFrame]) -> None:
        """Write scenes that have ended as a new part, named after the first: no other holds that.

        Args:
          indices: numbers of the scenes.
          frames: their runs or forks; a scene may have given none.
        """
        folder = data_path(self.config).parent / PARTS
        path = folder / f"part_{indices[0]:07d}.parquet"
        _writer(self.config)(path, frames, {**self.about, "indices": indices})

    def merge(self) -> pl.DataFrame:
        """Merge the parts into one file, which then holds every scene; returns its rows.

        Raises:
          BadInput: no scene has given any row.
        """
        files, path = _files(self.config), data_path(self.config)
        frame = _read_all(self.config, files)
        scenes = self.config.scenes
        assert scenes is not None
        if frame is None:
            raise BadInput(f"scenes: all {scenes} were solved too soon for a fork")
        if len(files) > 1 or files[0] != path or _scenes_in(path) != set(range(scenes)):
            _writer(self.config)(path, [frame], {**self.about, "scenes": scenes})
        shutil.rmtree(path.parent / PARTS, ignore_errors=True)
        return frame


def _settings(config: CollectConfig) -> dict[str, Any]:
    """The settings that decide on what runs hold."""
    # The world always: data of before there were worlds do not say it.
    later = [
        name
        for name, default in _LATER.items()
        if getattr(config, name) != default or name == "world"
    ]
    settings = {name: getattr(config, name) for name in (*_KEPT, *later)}
    plugins = _plugins(config)
    return {**settings, "plugins": plugins} if plugins else settings


def _plugins(config: CollectConfig) -> dict[str, Any]:
    """What the runs use of plugins, and what that is made of."""
    operator = None if config.mode == "autonomous" else config.operator
    return plugins_record(world_plugins(config.engine, operator))


def _as_json(settings: Mapping[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps(settings, default=str))


def data_path(config: CollectConfig) -> Path:
    """The merged file of a collection."""
    return runs_path(config.out, Mode(config.mode))


def existing(config: CollectConfig) -> list[Path]:
    """What earlier calls have left in the folder of these data."""
    path = data_path(config)
    return [p for p in (path, path.parent / SETTINGS, path.parent / PARTS) if p.exists()]


def _write_settings(config: CollectConfig) -> None:
    """Write the settings, or check them against those of earlier calls."""
    settings = data_path(config).parent / SETTINGS
    found = existing(config)
    if found and not config.resume:
        raise BadInput(f"{found[0]}: exists; expected a new folder, or --resume to continue it")
    wanted = _as_json(dataclasses.asdict(config))
    defaults = _as_json({name: _LATER[name] for name in _LATER})
    if found:
        before = stored_settings(_read_settings(settings))
        for name in (*_KEPT, *_LATER):
            if before.get(name, defaults.get(name)) != wanted[name]:
                raise BadInput(
                    f"{name}: runs in {settings.parent} were collected with "
                    f"{before.get(name)!r}, expected the same to resume, got {wanted[name]!r}"
                )
        if before.get("plugins", {}) != _plugins(config):
            raise BadInput(
                f"{settings}: runs were collected with another version of a plugin; expected the "
                "same to resume, or another folder"
            )
        if wanted["scenes"] < before["scenes"]:
            raise BadInput(f"scenes: expected {before['scenes']} or more, got {wanted['scenes']}")
    kept = _settings(config) | {"scenes": wanted["scenes"]}
    write_atomically(settings, json_bytes({**kept, **environment()}))


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        settings = parse_json(read_file(path, "settings", MIB))
    except ValueError:  # a BadInput is one, too
        settings = None
    if not isinstance(settings, dict) or type(settings.get("scenes")) is not int:
        raise BadInput(f"{path}: not readable; expected the settings of the runs to resume")
    return settings


def _files(config: CollectConfig) -> list[Path]:
    path = data_path(config)
    return [p for p in [path, *sorted((path.parent / PARTS).glob("part_*.parquet"))] if p.exists()]


def _scenes_in(file: Path) -> set[int]:
    """Numbers of the scenes that a file holds, those that gave no rows included."""
    about = read_provenance(file)
    indices, scenes = about.get("indices"), about.get("scenes")
    if isinstance(indices, list) and all(type(i) is int for i in indices):
        return set(indices)
    if type(scenes) is not int or not 0 <= scenes <= _MOST_SCENES:
        raise BadInput(f"{file}: does not say which scenes it holds")
    return set(range(scenes))


def _read_all(config: CollectConfig, files: list[Path]) -> pl.DataFrame | None:
    """All rows of the files; a part that was merged before an interruption counts once."""
    read = {Mode.FORKS: read_forks, Mode.FUTURES: read_futures}.get(Mode(config.mode), read_runs)
    row = [*RUN, "iteration"] if read is read_runs else [*FORK, "key"]
    frames = [read(file) for file in files]
    return pl.concat(frames).unique(row, keep="first") if frames else None


def _writer(config: CollectConfig) -> Any:
    return {Mode.FORKS: write_forks, Mode.FUTURES: write_futures}.get(Mode(config.mode), write_runs)
