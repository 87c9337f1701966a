"""Checkpoint files of the predictors: one msgpack file a network, checked when it is read.

`phi_auto.msgpack`, `phi_human.msgpack`, `gain.msgpack`, `failure.msgpack`, `time_alone.msgpack` and
`time_helped.msgpack` (flax.serialization's msgpack, no pickle anywhere) hold

    {"version": 2, "sha256": hex digest of payload, "payload": bytes}

and the payload, again msgpack,

    {"network": one of NETWORKS, "hidden": [64, 32, 8], "members": E, "features": [F names],
     "params": {"Dense_0": {"kernel": [E, F, 64], "bias": [E, 64]}, ...}, "mean": [F],
     "scale": [F], "data_sha256": of the Parquet file it was trained on, "scenes": int,
     "rows": int, "config": {setting: value as text}, "figures": {name: number}}

with float32 arrays. Only the digest finds a flipped bit in a weight: the result is still a number.
"""

import dataclasses
import hashlib
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import serialization

from pgf_jax.errors import BadInput
from pgf_jax.files import MIB, read_file, write_atomically
from pgf_jax.guidance.predictors.features import AHEAD, STATE
from pgf_jax.guidance.predictors.network import Predictor

VERSION = 2
PAIR = ("phi_auto", "phi_human")  # the paper's
NETWORKS = (*PAIR, "gain", "failure", "time_alone", "time_helped")
_WHAT = "a predictor checkpoint (.msgpack)"
_LARGEST = 64 * MIB  # of a file; the shipped ones take 0.1 MiB
_FIELDS = {
    "network": str,
    "hidden": list,
    "members": int,
    "features": list,
    "params": dict,
    "mean": np.ndarray,
    "scale": np.ndarray,
    "data_sha256": str,
    "scenes": int,
    "rows": int,
    "config": dict,
    "figures": dict,
}


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained predictor, and the data and settings that it was trained with.

    Attributes:
      network: one of `NETWORKS`.
      predictor: the network and its normalisation.
      data_sha256: hex digest of the `runs.parquet` or `forks.parquet` it was trained on.
      scenes: scenes with at least one row, training and validation together.
      rows: rows, training and validation together.
      config: settings of the training, as text.
      figures: `loss_train`, `loss_val` and other results of the training; units of cost.
    """

    network: str
    predictor: Predictor
    data_sha256: str
    scenes: int
    rows: int
    config: Mapping[str, str]
    figures: Mapping[str, float]


def checkpoint_name(network: str) -> str:
    """The file name of a network's checkpoint."""
    return f"{network}.msgpack"


def save(path: Path | str, checkpoint: Checkpoint) -> None:
    """Write a checkpoint, whole or not at all.

    Raises:
      BadInput: the file would not load again (a weight is not finite, say) or cannot be written.
    """
    predictor = checkpoint.predictor
    content = {
        "network": checkpoint.network,
        "hidden": list(predictor.hidden),
        "members": len(predictor.params["Dense_0"]["bias"]),
        "features": list(predictor.features),
        "params": {
            layer: {name: np.asarray(value) for name, value in sorted(values.items())}
            for layer, values in sorted(predictor.params.items())
        },
        "mean": np.asarray(predictor.mean),
        "scale": np.asarray(predictor.scale),
        "data_sha256": checkpoint.data_sha256,
        "scenes": int(checkpoint.scenes),
        "rows": int(checkpoint.rows),
        "config": {name: str(value) for name, value in checkpoint.config.items()},
        "figures": {name: float(value) for name, value in checkpoint.figures.items()},
    }
    _from_content(content, str(path))
    payload = serialization.msgpack_serialize(content)
    digest = hashlib.sha256(payload).hexdigest()
    write_atomically(
        path,
        serialization.msgpack_serialize({"version": VERSION, "sha256": digest, "payload": payload}),
    )


def load(path: Path | str | Traversable) -> Checkpoint:
    """Read a checkpoint and check all of it.

    Raises:
      BadInput: one line that names the file: missing, truncated or corrupt, of another version, or
        with arrays of the wrong shape or type or that are not finite.
    """
    source = Path(path) if isinstance(path, str) else path
    if isinstance(source, Path):
        data = read_file(source, _WHAT, _LARGEST)
    elif source.is_file():
        data = source.read_bytes()  # a package's file, perhaps within a zip file
    else:
        raise BadInput(f"{source}: no such file, expected {_WHAT}")
    outer = _unpack(data, str(source))
    version, digest, payload = (outer.get(field) for field in ("version", "sha256", "payload"))
    # Check types before values: a foreign file may hold arrays, and comparing one gives no bool.
    if type(version) is not int:
        raise BadInput(f"{source}: not a predictor checkpoint, it has no version number")
    if version != VERSION:
        raise BadInput(f"{source}: checkpoint version {version}, expected {VERSION}")
    if type(payload) is not bytes or type(digest) is not str:
        raise BadInput(f"{source}: not a predictor checkpoint, it has no payload with a digest")
    if hashlib.sha256(payload).hexdigest() != digest:
        raise BadInput(f"{source}: corrupt checkpoint, its digest does not match its content")
    return _from_content(_unpack(payload, str(source)), str(source))


def load_network(folder: Traversable, network: str) -> Checkpoint:
    """Read one network of a folder; BadInput as `load`, or if the file holds another network."""
    source = folder / checkpoint_name(network)
    checkpoint = load(source)
    if checkpoint.network != network:
        raise BadInput(f"{source}: holds {checkpoint.network}, expected {network}")
    return checkpoint


def _file_names() -> str:
    return " and ".join(map(checkpoint_name, PAIR))


def shipped_checkpoints() -> Traversable:
    """The checkpoints that ship with pgf_jax: inside the wheel, or beside the package's sources."""
    package = resources.files("pgf_jax")
    inside = package / "checkpoints"
    if inside.is_dir():
        return inside
    # A source tree (an editable install too) keeps them one level up; the build moves them in.
    # site-packages may hold another package's folder `checkpoints`, so look for pyproject as well.
    root = Path(str(package)).parent
    if (root / "pyproject.toml").is_file() and (root / "checkpoints").is_dir():
        return root / "checkpoints"
    raise BadInput(f"{inside}: no shipped checkpoints, expected a folder with {_file_names()}")


def _unpack(data: bytes, name: str) -> dict[str, Any]:
    try:
        content = serialization.msgpack_restore(data)
    except Exception as error:  # msgpack, numpy and flax raise many types on foreign bytes
        raise BadInput(f"{name}: truncated or corrupt, not a predictor checkpoint") from error
    if not isinstance(content, dict):
        raise BadInput(f"{name}: not a predictor checkpoint, expected a mapping")
    return content


def _from_content(content: dict[str, Any], name: str) -> Checkpoint:
    """Check the payload and build the checkpoint."""
    for field, kind in _FIELDS.items():
        if type(content.get(field)) is not kind:
            got = type(content[field]).__name__ if field in content else "nothing"
            raise BadInput(f"{name}: field {field} must be a {kind.__name__}, got {got}")
    if content["network"] not in NETWORKS:
        expected = " or ".join(NETWORKS)
        raise BadInput(f"{name}: network is {content['network']!r}, expected {expected}")
    features = content["features"]
    # Check that names are text first: other values may not be hashable.
    named = all(type(feature) is str for feature in features)
    if not named or not features or not set(features) <= {*STATE, AHEAD}:
        raise BadInput(f"{name}: features are not all among {', '.join((*STATE, AHEAD))}")
    if len(set(features)) != len(features):
        raise BadInput(f"{name}: features are named twice")
    hidden = content["hidden"]
    if not hidden or not all(type(width) is int and width > 0 for width in hidden):
        raise BadInput(f"{name}: hidden must be a list of one or more positive widths")
    for count, least in (("scenes", 0), ("rows", 0), ("members", 1)):
        if content[count] < least:
            raise BadInput(f"{name}: {count} must be {least} or more, got {content[count]}")
    if not all(type(t) is str for pair in content["config"].items() for t in pair):
        raise BadInput(f"{name}: config must be texts by name")
    for figure, value in content["figures"].items():
        if type(value) is not float or not np.isfinite(value):
            raise BadInput(f"{name}: figure {figure!r} must be a finite number")

    widths = (len(features), *hidden, 1)
    params = _check_params(content["params"], content["members"], widths, name)
    for field in ("mean", "scale"):
        _check_array(content[field], (len(features),), f"{name}: {field}")
    if not (content["scale"] > 0).all():
        raise BadInput(f"{name}: scale must be positive, got {content['scale'].min():g}")
    return Checkpoint(
        network=content["network"],
        predictor=Predictor(
            params=params,
            mean=jnp.asarray(content["mean"]),
            scale=jnp.asarray(content["scale"]),
            hidden=tuple(hidden),
            features=tuple(features),
        ),
        data_sha256=content["data_sha256"],
        scenes=content["scenes"],
        rows=content["rows"],
        config=content["config"],
        figures=content["figures"],
    )


def _check_params(
    params: dict[str, Any], members: int, widths: tuple[int, ...], name: str
) -> dict[str, Any]:
    layers = [f"Dense_{i}" for i in range(len(widths) - 1)]
    if set(params) != set(layers):
        raise BadInput(f"{name}: layers are {list(params)}, expected {layers}")
    checked = {}
    for i, layer in enumerate(layers):
        values = params[layer]
        if not isinstance(values, dict) or set(values) != {"kernel", "bias"}:
            raise BadInput(f"{name}: {layer} must hold a kernel and a bias")
        shapes = {
            "kernel": (members, widths[i], widths[i + 1]),
            "bias": (members, widths[i + 1]),
        }
        for part, shape in shapes.items():
            _check_array(values[part], shape, f"{name}: {layer} {part}")
        checked[layer] = {part: jnp.asarray(values[part]) for part in shapes}
    return checked


def _check_array(value: object, shape: tuple[int, ...], what: str) -> None:
    if not isinstance(value, np.ndarray) or value.dtype != np.float32:
        got = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
        raise BadInput(f"{what} must be a float32 array, got {got}")
    if value.shape != shape:
        raise BadInput(f"{what} has shape {value.shape}, expected {shape}")
    if not np.isfinite(value).all():
        raise BadInput(f"{what} holds a number that is not finite")
