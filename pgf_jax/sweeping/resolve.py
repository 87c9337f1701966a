"""What a sweep reads before it starts: scenes, predictors; and what its results depend on."""

import dataclasses
import hashlib
import json
from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np

from pgf_jax.batching.requests import GainPredictor
from pgf_jax.errors import BadInput
from pgf_jax.files import sha256
from pgf_jax.fleet import Fleet
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.robots import Robots
from pgf_jax.guidance.operators.base import AnyOperator
from pgf_jax.guidance.operators.registry import check_operator, make_operator
from pgf_jax.guidance.predictors.checkpoint import PAIR, checkpoint_name, shipped_checkpoints
from pgf_jax.guidance.predictors.registry import NETWORKS, PredictorSpec, predictor_spec
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.physics.config import PHYSICS
from pgf_jax.planning.config import Planner
from pgf_jax.provenance import DECISIVE, device, environment, versions
from pgf_jax.scene import Scene, load_scenes, sample_scene
from pgf_jax.scene.sampling import OBJECTS, PRESETS
from pgf_jax.simulation.recorded_operator import LIVE, REPLAY, Recording
from pgf_jax.streams import stream
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.tables.event_log import read_log

FORMAT = 3  # of the results folder


@dataclasses.dataclass(frozen=True)
class Setup:
    """A configuration and the contents of the files it names; can be sent to another process.

    Attributes:
      config: the sweep's.
      files: the scenes of its folder, or None where scenes are sampled.
      bidder: the predictor, or None where there is none and none is needed.
      classifier: what the policy `classifier` bids by; None where it is not run.
      predictor_files: per network: digest of its file, and what it was trained on.
      n_objects: N of every scene.
      recording: the operator of a recorded session, where there is one.
    """

    config: SweepConfig
    files: tuple[Scene, ...] | None
    bidder: GainPredictor | None
    classifier: GainPredictor | None
    predictor_files: Mapping[str, Mapping[str, Any]]
    n_objects: int
    recording: Recording | None = None

    def operator(self) -> AnyOperator:
        """Who gives the input."""
        return self.recording or make_operator(self.config.operator)

    def new_fleet(self, cell: Cell, planned: Robots) -> Fleet:
        """The fleet of a cell."""
        if self.recording is None:
            return Fleet(self.config.fleet(cell), planned)
        return Fleet(
            self.config.fleet(cell),
            planned,
            service=self.recording,
            attendance=self.recording.attendance,
        )

    def bidder_of(self, cell: Cell) -> GainPredictor | TrueGain | None:
        """Where the numbers come from that a cell's robots may bid; they are logged in any case."""
        if cell.policy == "oracle-gain":
            return TrueGain()
        return self.classifier if cell.policy == "classifier" else self.bidder

    def networks_of(self, cell: Cell) -> list[str]:
        """The networks in it."""
        if cell.policy == "oracle-gain":
            return []
        classify = cell.policy == "classifier"
        return [n for n in self.predictor_files if (n in NETWORKS["classifier"]) == classify]

    def compile_key(self) -> tuple[str, str, Planner, int, int]:
        """What is compiled for it: engine, physics, planner, lanes, N."""
        c = self.config
        return c.engine, c.physics, c.planner(), c.engine_lanes(), self.n_objects

    def cache_key(self) -> Hashable:
        """What a task's tree depends on (`trees.py`)."""
        c = self.config
        scenes = c.sampled_class() if self.files is None else scenes_digest(self.files)
        said = None if self.recording is None else self.recording.sha256
        return self.compile_key(), c.seed, scenes, c.operator, said

    def scene(self, robot: int, task: int) -> Scene:
        """The scene of a task: of (seed, robot, task), whatever the policy and the fleet's size."""
        return task_scene(self.config, self.files, robot, task)

    def scene_name(self, robot: int, task: int) -> str:
        """Its name, without packing a sampled scene again."""
        if self.files is not None:
            return self.scene(robot, task).name
        return _sampled_name(self.config, robot, task)


Loaded = dict[PredictorSpec, tuple[GainPredictor, dict[str, dict[str, Any]]]]


def prepare(config: SweepConfig, loaded: Loaded | None = None) -> Setup:
    """Load what a sweep is given, and check it.

    Args:
      config: the sweep's.
      loaded: predictors that other sweeps of the same run have loaded; added to.

    Raises:
      BadInput: one line that names the field or the file.
    """
    recording = None
    if config.operator == REPLAY:
        assert config.log is not None
        recording = Recording.of(read_log(config.log))
    elif config.operator != LIVE:
        check_operator(config.operator)
    files = None
    n_objects = OBJECTS
    if config.scenes is not None:
        files = tuple(load_scenes(config.scenes))
        n_objects = len(files[0].objects)
        for scene in files:
            if len(scene.objects) != n_objects:
                raise BadInput(
                    f"{config.scenes}: {scene.name} has {len(scene.objects)} objects, expected "
                    f"{n_objects} as in {files[0].name}"
                )
    loaded = {} if loaded is None else loaded

    def load(chosen: PredictorSpec) -> tuple[GainPredictor, dict[str, dict[str, Any]]]:
        if chosen not in loaded:
            loaded[chosen] = _load(chosen)
        return loaded[chosen]

    chosen = predictor_spec(config.predictor)
    policies = {cell.policy for cell in config.cells()}
    bidder, described = None, {}
    # Gains are logged under all policies alike, where there are networks to predict them.
    if config.predictor != "paper" or config.needs_gains() or _shipped():
        bidder, described = load(chosen)
    classifier = None
    if "classifier" in policies:
        classifier, more = load(PredictorSpec("classifier", chosen.folder))
        described = described | more
    return Setup(config, files, bidder, classifier, described, n_objects, recording)


def task_scene(
    config: SweepConfig, files: tuple[Scene, ...] | None, robot: int, task: int
) -> Scene:
    """The scene of a robot's task, by (seed, robot, task).

    Sampled scenes have the key [seed, robot, task]. Of scene files, each robot takes a permutation
    of all of them, then another one, and so on.

    Args:
      config: seed and class.
      files: scenes to draw from, or None to sample.
      robot, task: 0-based.
    """
    if files is None:
        key = np.array([config.seed, robot, task], np.uint32)
        return sample_scene(
            key, _class_of_task(config, robot, task), name=_sampled_name(config, robot, task)
        )
    turn, place = divmod(task, len(files))
    # Raw bits: NumPy keeps a bit generator's output fixed for ever, but not a Generator's.
    bits = stream(config.seed, "scenes", robot, turn).bit_generator.random_raw(len(files))
    return files[int(np.argsort(bits, kind="stable")[place])]


def _class_of_task(config: SweepConfig, robot: int, task: int) -> str:
    name = config.sampled_class()
    assert name is not None
    # In turn, and shifted from robot to robot: the classes are mixed over the fleet at all times.
    return [*PRESETS][(robot + task) % len(PRESETS)] if name == "all" else name


def _sampled_name(config: SweepConfig, robot: int, task: int) -> str:
    return f"{_class_of_task(config, robot, task)}_{config.seed}_{robot}_{task}"


def _load(chosen: PredictorSpec) -> tuple[GainPredictor, dict[str, dict[str, Any]]]:
    bidder, checkpoints = chosen.load()
    return bidder, {
        checkpoint.network: {
            "sha256": sha256((chosen.files() / checkpoint_name(checkpoint.network)).read_bytes()),
            "data_sha256": checkpoint.data_sha256,
            "scenes": checkpoint.scenes,
            "rows": checkpoint.rows,
            "figures": dict(checkpoint.figures),
        }
        for checkpoint in checkpoints
    }


def _shipped() -> bool:
    try:
        folder = shipped_checkpoints()
    except BadInput:
        return False
    return any((folder / checkpoint_name(network)).is_file() for network in PAIR)


def identity(setup: Setup, cell: Cell) -> dict[str, Any]:
    """Everything that a cell's results depend on, as JSON has it; not workers, not other cells."""
    config, files = setup.config, setup.files
    content = {
        "format": FORMAT,
        "fleet": dataclasses.asdict(config.fleet(cell)),
        "engine": config.engine,
        "lanes": config.engine_lanes(),
        "physics": dataclasses.asdict(PHYSICS[config.physics]),
        "planner": dataclasses.asdict(config.planner()),
        "scene_class": config.sampled_class(),
        "scenes": None if files is None else scenes_digest(files),
        "operator": config.operator,
        **({} if setup.recording is None else {"log": setup.recording.sha256}),
        "predictors": {n: setup.predictor_files[n]["sha256"] for n in setup.networks_of(cell)},
        "versions": {name: versions()[name] for name in DECISIVE},
        "device": device(),
    }
    return json.loads(json.dumps(content))


def provenance(setup: Setup, cell: Cell) -> dict[str, Any]:
    """Where a cell's results come from, for its file: to be understood, and computed, once more.

    Where its inputs lay (scenes, checkpoints, the log) is not in it, as that decides on nothing;
    their digests are, in `identity`.
    """
    content = {
        "identity": identity(setup, cell),
        "config": setup.config.of_cell(cell),
        **environment(),
    }
    return json.loads(json.dumps(content))


def scenes_digest(scenes: tuple[Scene, ...]) -> str:
    """Digest of scenes, their names and their order."""
    digest = hashlib.sha256()
    for scene in scenes:
        digest.update(f"{scene.name}\0{scene.goal}\0{len(scene.objects)}\0".encode())
        digest.update(np.ascontiguousarray(scene.objects, "<f8").tobytes())
    return digest.hexdigest()
