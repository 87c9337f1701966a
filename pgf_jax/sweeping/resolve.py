"""Resolves a sweep's configuration: reads its inputs, and says what each cell is computed from.

The configuration stops here: what computes a cell knows its `CellSpec` alone.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import sha256
from pgf_jax.fleet.config import Cell, FleetConfig
from pgf_jax.fleet.policies import POLICIES
from pgf_jax.guidance.operators.registry import OPERATORS, check_operator, world_plugins
from pgf_jax.guidance.predictors.checkpoint import PAIR, checkpoint_name, shipped_checkpoints
from pgf_jax.guidance.predictors.registry import PredictorSpec, predictor_spec
from pgf_jax.guidance.predictors.true_gain import TrueGain
from pgf_jax.jax_setup import has_options
from pgf_jax.physics.engine import ENGINES
from pgf_jax.physics.worlds.config import world_error_of
from pgf_jax.planning.config import PLANNER_REVISION
from pgf_jax.plugins.registry import Plugin, plugins_record
from pgf_jax.provenance import DECISIVE, device, origin, versions
from pgf_jax.scene import Scene, load_scenes
from pgf_jax.scene.file import read_scenes
from pgf_jax.settings import stored_settings
from pgf_jax.simulation.fleet_spec import FleetSpec, TaskScenes
from pgf_jax.simulation.planned_robots import AnyPredictor
from pgf_jax.simulation.recorded_operator import LIVE, REPLAY, Recording
from pgf_jax.simulation.task_worlds import WorldSpec
from pgf_jax.simulation.true_time import TrueTime
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.config import INPUTS, SweepConfig
from pgf_jax.tables.event_log import read_log

FORMAT = 3  # of the results folder

# Predictors that were loaded, and for each network: digest of its file, what it was trained on.
_Files = dict[str, dict[str, Any]]  # of networks by name
Loaded = dict[PredictorSpec, tuple[AnyPredictor, _Files]]

# Policies that need another predictor than that of gains, and its kind.
_OWN_PREDICTORS = {
    "classifier": "classifier",
    **dict.fromkeys(("time-saved", "gain-rate", "urgency"), "time"),
    **dict.fromkeys(("oracle-gain", "oracle-time"), "oracle"),
}
# Settings of fleets that came later, and their defaults: cells of those keep their identity.
_FIELDS = [(field.name, field.default) for field in dataclasses.fields(FleetConfig)]
_LATER = dict(_FIELDS[_FIELDS.index(("seed", 0)) + 1 :])


@dataclasses.dataclass(frozen=True, eq=False)
class CellSpec:
    """A cell of a sweep, and all that it is computed from; can be sent to another process.

    Attributes:
      sweep: number of its sweep among those that are run together.
      cell: policy, sizes and seed.
      name: of the cell: policy and size, and the seed where the sweep has several.
      key: of its file, the digest of `identity`.
      identity: everything that its results depend on, as JSON; neither workers nor other cells.
      fleet: what is simulated.
      settings: of the sweep that decide on it, as arguments of a sweep of it alone.
      inputs: where scenes, checkpoints and log are; their content decides, so it is in `identity`.
      out: folder of the results.
      plugins: what it uses of plugins, each with the digest of everything that it is made of.
    """

    sweep: int
    cell: Cell
    name: str
    key: str
    identity: Mapping[str, Any]
    fleet: FleetSpec
    settings: Mapping[str, Any]
    inputs: Mapping[str, str | None]
    out: Path
    plugins: tuple[tuple[Plugin, str], ...] = ()

    @property
    def tasks(self) -> int:
        """Number of tasks of all its robots."""
        return self.cell.robots * self.cell.tasks

    @property
    def path(self) -> Path:
        """The cell's file."""
        return cell_file.path(self.out, self.key)

    def about(self) -> dict[str, Any]:
        """Where the cell's results come from, for its file: so that it can be computed again."""
        return {
            "identity": self.identity,
            "config": json.loads(json.dumps(self.settings)),
            **({"plugins": plugins_record(self.plugins)} if self.plugins else {}),
            **json.loads(json.dumps(origin())),
        }


@dataclasses.dataclass(frozen=True, eq=False)
class ResolvedSweep:
    """A sweep whose inputs have been read.

    Attributes:
      config: its configuration.
      cells: in the order of the configuration.
      scenes: of its tasks, of the first seed.
      predictor_files: of each network: digest of its file, and what it was trained on.
    """

    config: SweepConfig
    cells: tuple[CellSpec, ...]
    scenes: TaskScenes
    predictor_files: Mapping[str, Mapping[str, Any]]


def resolve(config: SweepConfig, loaded: Loaded | None = None, *, number: int = 0) -> ResolvedSweep:
    """Read what a sweep is given, check it, and specify its cells.

    Args:
      config: the sweep's.
      loaded: predictors that other sweeps of the same run have loaded; added to.
      number: of the sweep among those that are run together.

    Raises:
      BadInput: one line that names the field or the file.
    """
    recording = _recording(config)
    scene_files = _scene_files(config)
    world = WorldSpec.of(config.world, scene_files)
    error = world_error_of(config.world_error, config.world)
    predictors, files = _predictors(config, {} if loaded is None else loaded)

    def spec(cell: Cell) -> CellSpec:
        kind = _OWN_PREDICTORS.get(cell.policy, "gain")
        fleet_config = config.fleet(cell)
        fleet = FleetSpec(
            config=fleet_config,
            engine=config.engine,
            physics=config.physics_values(),
            planner=config.planner(),
            lanes=config.engine_lanes(),
            scenes=task_scenes(config, scene_files, seed=cell.seed),
            operator=config.operator,
            # Robots' numbers are logged under every policy, whether it bids them or not.
            predictor=_oracle(fleet_config) or predictors.get(kind),
            recording=recording,
            world=world and dataclasses.replace(world, error=error, seed=cell.seed),
        )
        plugins = _plugins(fleet)
        used = {name: about["sha256"] for name, about in files.get(kind, {}).items()}
        identity = _identity(fleet, used, plugins)
        return CellSpec(
            sweep=number,
            cell=cell,
            name=f"{cell.name}_seed{cell.seed}" if config.seeds else cell.name,
            key=cell_file.key(identity),
            identity=identity,
            fleet=fleet,
            settings=config.of_cell(cell),
            inputs=config.inputs(),
            out=config.out,
            plugins=plugins,
        )

    cells = tuple(map(spec, config.cells()))
    every = {name: about for part in files.values() for name, about in part.items()}
    return ResolvedSweep(config, cells, cells[0].fleet.scenes, every)


def task_scenes(
    config: SweepConfig, files: tuple[Scene, ...] | None = None, *, seed: int | None = None
) -> TaskScenes:
    """The scenes of the tasks of a sweep's fleets.

    Args:
      config: the sweep's.
      files: the scenes of its folder; None: they are sampled.
      seed: of the fleets; None: that of the configuration.
    """
    scene_class = config.sampled_class() if files is None else None
    return TaskScenes(config.seed if seed is None else seed, scene_class, files)


def _recording(config: SweepConfig) -> Recording | None:
    if config.operator == REPLAY:
        assert config.log is not None
        return Recording.of(read_log(config.log))
    if config.operator != LIVE:
        check_operator(config.operator)
    return None


def _scene_files(config: SweepConfig) -> tuple[Scene, ...] | None:
    if config.scenes is None:
        return None
    if isinstance(config.scenes, tuple):
        files = config.scenes
        names = [scene.name for scene in files]
        for name in names:
            if names.count(name) > 1:
                raise BadInput(f"scenes: expected scenes of different names, got {name!r} twice")
    elif config.scenes.suffix == ".json":
        files = tuple(read_scenes(config.scenes))
    else:
        files = tuple(load_scenes(config.scenes))
    return files


def _oracle(config: FleetConfig) -> TrueGain | TrueTime | None:
    """What knows the future for the policies of oracles; None for the others."""
    if config.policy == "oracle-gain":
        return TrueGain()
    if config.policy == "oracle-time":
        keep = config.while_served != "wait"
        return TrueTime(config.task_limit_s / config.rollout_time_s, keep)
    return None


def _predictors(
    config: SweepConfig, loaded: Loaded
) -> tuple[dict[str, AnyPredictor], dict[str, _Files]]:
    """The predictors that policies need, and their files, by kind (`_OWN_PREDICTORS`, or gain)."""
    spec = predictor_spec(config.predictor)
    specs = {}
    # Gains are logged under all policies alike, where there are networks to predict them.
    if config.predictor != "paper" or config.needs_gains() or _shipped():
        specs["gain"] = spec
    for cell in config.cells():
        kind = _OWN_PREDICTORS.get(cell.policy)
        if kind == "classifier":
            specs[kind] = PredictorSpec(kind, spec.folder, spec.part)
        elif kind == "time":
            specs[kind] = PredictorSpec(kind, spec.folder)
    for kind, one in specs.items():
        if one in loaded:
            continue
        try:
            loaded[one] = _load(one)
        except BadInput as error:
            # The user may not have named the policy: it can be a default one.
            needs = [c.policy for c in config.cells() if _OWN_PREDICTORS.get(c.policy) == kind]
            why = f"; policy {needs[0]} needs it" if needs else ""
            raise BadInput(f"{error}{why}") from error
    predictors = {kind: loaded[one][0] for kind, one in specs.items()}
    return predictors, {kind: loaded[one][1] for kind, one in specs.items()}


def _load(spec: PredictorSpec) -> tuple[AnyPredictor, _Files]:
    predictor, checkpoints = spec.load()
    return predictor, {
        checkpoint.network: {
            "sha256": sha256((spec.files() / checkpoint_name(checkpoint.network)).read_bytes()),
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


def _plugins(fleet: FleetSpec) -> tuple[tuple[Plugin, str], ...]:
    """What a fleet uses of plugins, and the digest of what each is made of."""
    operator = None if fleet.operator in (REPLAY, LIVE) else fleet.operator
    used = (
        POLICIES.made_of(fleet.config.policy, fleet.config),
        *world_plugins(fleet.engine, operator),
    )
    return tuple(one for one in used if one is not None)


def _revisions(fleet: FleetSpec) -> dict[str, int]:
    """Revisions of the built-in parts of a fleet whose results have changed since the first one."""
    parts = ((POLICIES, fleet.config.policy), (ENGINES, fleet.engine))
    if fleet.operator not in (REPLAY, LIVE):
        parts = (*parts, (OPERATORS, fleet.operator))
    revisions = {registry.kind: registry.revision(name) for registry, name in parts}
    revisions["planner"] = PLANNER_REVISION
    # Without the options, `planar` rounds in other places.
    revisions["xla options"] = 2 if fleet.engine == "planar" and not has_options() else 1
    return {kind: revision for kind, revision in revisions.items() if revision > 1}


def _identity(
    fleet: FleetSpec, predictors: Mapping[str, str], plugins: Sequence[tuple[Plugin, str]]
) -> dict[str, Any]:
    """Everything that a cell's results depend on, as JSON; `predictors`: network -> digest."""
    revisions = _revisions(fleet)
    content = {
        "format": FORMAT,
        # A setting that came later is in the identity only where it is given.
        "fleet": {
            name: value
            for name, value in dataclasses.asdict(fleet.config).items()
            if name not in _LATER or value != _LATER[name]
        },
        "engine": fleet.engine,
        "lanes": fleet.lanes,
        "physics": dataclasses.asdict(fleet.physics),
        "planner": dataclasses.asdict(fleet.planner),
        "scene_class": fleet.scenes.scene_class,
        "scenes": fleet.scenes.digest,
        "operator": fleet.operator,
        **({} if fleet.recording is None else {"log": fleet.recording.sha256}),
        **({} if fleet.world is None else {"world": fleet.world.identity}),
        "predictors": predictors,
        "versions": {name: versions()[name] for name in DECISIVE},
        "device": device(),
        **({"plugins": {plugin.kind: made for plugin, made in plugins}} if plugins else {}),
        **({"revisions": revisions} if revisions else {}),
    }
    return json.loads(json.dumps(content))


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
            # In an identity simulated times end in _s; the settings have no unit in their names.
            words.append(f"{_short(key).removesuffix('_s')} {_short(a)}, now {_short(b)}")
    return "; ".join(dict.fromkeys(words))  # K is a setting of planner and fleet


def _short(value: object) -> str:
    text = value if isinstance(value, str) and value.isprintable() else short_repr(value, 40)
    return text if len(text) <= 40 else text[:37] + "..."


def config_of(about: Mapping[str, Any], inputs: Mapping[str, Any], out: Path) -> SweepConfig:
    """The configuration of a sweep of one stored cell alone.

    Args:
      about: of the cell, see `CellSpec.about`.
      inputs: where scenes, checkpoints and log are, see `INPUTS`.
      out: folder for the results.

    Raises:
      BadInput: what the cell says of its configuration cannot be one.
    """
    settings = about.get("config")
    if not isinstance(settings, dict):
        raise BadInput("it does not say what its configuration was")
    known = {field.name for field in dataclasses.fields(SweepConfig)}
    unknown = sorted(settings.keys() - known)
    if unknown:
        raise BadInput(f"its configuration has {unknown[0]}, which a sweep has not")
    there = {name: inputs[name] for name in INPUTS if inputs.get(name) is not None}
    # A predictor's name means what it did when the cell was computed, as the other settings do.
    given = stored_settings({"predictor": "paper", **settings, **there})
    paths = {name: Path(path) for name, path in there.items() if name != "predictor"}
    return SweepConfig(**{**given, **paths, "out": out})
