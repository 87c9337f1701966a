"""What is fuzzed: the readers, files that each takes, and what may come of one that was changed.

`outcome` reads one changed file: "read", "refused" (by BadInput, in one line that names the file),
or else what went wrong. Everything about a case follows from its reader's name and its number.
"""

import contextlib
import dataclasses
import functools
import io
import json
import tempfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import fuzz_mutate as mutate
import numpy as np
import polars as pl
from write_log import write_log

from pgf_jax.collection import dataset
from pgf_jax.errors import BadInput
from pgf_jax.files import json_bytes, read_json, sha256
from pgf_jax.fleet import Event, EventKind
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.records import TaskRecord
from pgf_jax.guidance.predictors import checkpoint
from pgf_jax.guidance.predictors.features import STATE
from pgf_jax.guidance.predictors.registry import PredictorSpec, predictor_spec
from pgf_jax.inspection.config import VerifyConfig
from pgf_jax.inspection.verify import verify
from pgf_jax.operator_fit import lognormal
from pgf_jax.operator_fit.command import fit_operator
from pgf_jax.operator_fit.config import FitOperatorConfig
from pgf_jax.planning.types import Status
from pgf_jax.plans.file import Plan, load_plan, save_plan
from pgf_jax.scene import Scene, load_scene, load_scenes, sample_scene, save_scene
from pgf_jax.simulation.recorded_operator import Recording
from pgf_jax.simulation.robot import Segment
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.cell_store import MANIFEST, CellStore
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.sweeping.replay import replay_config, settings_of
from pgf_jax.sweeping.resolve import ResolvedSweep, resolve
from pgf_jax.sweeping.sweep import _write_results
from pgf_jax.tables import event_log, results
from pgf_jax.tables.forks import FORK_SCHEMA, read_forks, write_forks
from pgf_jax.tables.parquet import encode_table
from pgf_jax.tables.run_log import RunLog
from pgf_jax.tables.runs import Mode, read_runs, write_runs
from pgf_jax.training.rows import autonomous_rows, gain_rows, human_rows

LONGEST = 500  # characters of a message
CORPUS = Path(__file__).parent / "corpus"


@dataclasses.dataclass(frozen=True)
class Reader:
    """Something that reads a file of the user's.

    Attributes:
      name: of the file that is changed, below the case's folder; KEY in it is that of a cell.
      read: reads it, given the case's folder.
      seeds: makes good files of it.
      mutators: one is drawn for a case, and in every fourth case a second one of bytes.
      around: makes the other files of the folder.
      sign: whether others say the changed file's digest, so that what is behind it is reached.
      sealed: whether they say the good file's, so that no change may pass.
      expected: a refusal that says so counts as read.
    """

    name: str
    read: Callable[[Path], object]
    seeds: Callable[[], Sequence[bytes]]
    mutators: Sequence[mutate.Mutator]
    around: Callable[[], Mapping[str, bytes]] = dict
    sign: bool = False
    sealed: bool = False
    expected: str | None = None


# -- good files ------------------------------------------------------------------------------------


def _written(write: Callable[[Path], object], name: str = "x") -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return next(p for p in Path(folder).iterdir() if p.is_file()).read_bytes()


def mjcf(centres: Sequence[Sequence[float]], *, plain: bool = False) -> bytes:
    """A scene in the published files' form."""
    geom = '<geom friction="0.3 0.3 0.3" mass="1." size="0.03 0.05" type="cylinder"/>'
    joint = '<joint damping="0.5" stiffness="0.01" armature="0.1" type="free"/>'
    bodies = "".join(
        f'<body name="object_{i}" pos="{x!r} {y!r} 0.18" quat="0.6 0 0 0.8">\n{geom}{joint}</body>'
        for i, (x, y) in enumerate(centres, 1)
    )
    around = ("", "") if plain else ('<include file="a.xml"/>', '<include file="include/b.xml"/>')
    return (
        f'<?xml version="1.0"?>\n<mujoco model="m">{around[0]}<worldbody>{around[1]}{bodies}'
        "</worldbody></mujoco>"
    ).encode()


def scene_files() -> list[bytes]:
    sampled = [sample_scene(seed, preset).positions.tolist() for seed, preset in _SCENES]
    return [*map(mjcf, sampled), mjcf([(0.4, 0.2), (0.45, -0.2), (0.5, 0.1)], plain=True)]


def own_scenes() -> list[bytes]:
    """Scene files of this program."""
    scenes = [sample_scene(2, "mixed"), sample_scene(3, "tight")]
    return [_written(lambda path, s=scene: save_scene(path, s), "s.json") for scene in scenes]


_SCENES = ((1, "tight"), (2, "medium"), (3, "wide"))


def shipped(network: str) -> bytes:
    return (checkpoint.shipped_checkpoints() / checkpoint.checkpoint_name(network)).read_bytes()


def checkpoints() -> list[bytes]:
    return [shipped("phi_auto"), shipped("failure")]


def run_tables() -> list[bytes]:
    frames = []
    for seed in range(4):
        log = RunLog(scene=f"tight_{seed}", seed=seed, scene_class="tight", n_objects=20)
        log.begin_segment("reach")
        for i in range(4 + seed):
            log.add((400.0 - i, 2.0 * i, 450.0), feasible=seed == 3 and i == 6)
        frames.append(log)
    alone = [log.frame() for log in frames]
    for log in frames[:2]:
        log.input_given()
        log.begin_segment("push")
        log.add((3.0, 0.0, 0.0), feasible=True)
        log.begin_segment("reach")
        log.add((300.0, np.inf, np.nan), feasible=False)
    helped = [log.frame() for log in frames]
    about = {"settings": {"mode": "human"}, "indices": [0, 1, 2, 3], "scenes": 4}
    return [
        _written(lambda path: write_runs(path, alone, about)),
        _written(lambda path: write_runs(path, helped, about)),
    ]


def fork_tables() -> list[bytes]:
    rows = [
        {
            "scene": f"tight_{seed}",
            "seed": seed,
            "class": "tight",
            "iteration": 4,
            "input": ("push", "go_on")[seed % 2],
            "key": key,
            "alone": 400.0 + key,
            "helped": 100.0 * seed,
            "alone_solved": False,
            "helped_solved": seed == 0,
            "alone_iterations": 10,
            "helped_iterations": 12,
            "pushed": True,
            **{f"state:{name}": float(i) for i, name in enumerate(STATE)},
        }
        for seed in range(3)
        for key in range(2)
    ]
    frame = pl.DataFrame(rows, schema=FORK_SCHEMA)
    return [_written(lambda path: write_forks(path, [frame], {"indices": [0, 1, 2]}))]


def records(robots: int = 2) -> list[TaskRecord]:
    counts = {f.name: 3 for f in dataclasses.fields(TaskRecord) if f.type is int}
    times = {f.name: 1.5 for f in dataclasses.fields(TaskRecord) if f.type is float}
    return [
        TaskRecord(
            **(counts | times | {"robot": robot, "task": task, "cost": np.nan}),  # pyright: ignore[reportArgumentType]
            status=Status.SOLVED if task else Status.TIMED_OUT,
            first_bid=None,
            first_grant=2,
            grants_at=(2, 5),
            successful_grants_at=(),
            asked_cost=(450.0, np.nan),
            helped_cost=(np.nan, 1.0),
            non_finite_at=(0, 4, 7),
            terms=(1.0, 2.0, np.nan),
        )
        for robot in range(robots)
        for task in range(2)
    ]


S = 10**9
EVENTS = [
    Event(0, EventKind.TASK_START, 0, 0),
    Event(0, EventKind.TASK_START, 1, 0),
    Event(3 * S, EventKind.ITERATION, 0, 0, iteration=0, gain=np.nan, outcome="stuck"),
    Event(3 * S, EventKind.BID, 0, 0, 0, iteration=0, gain=np.inf),
    Event(3 * S, EventKind.GRANT, 0, 0, 0, 0),
    Event(11 * S, EventKind.SERVICE_END, 0, 0, 0, 0, object=5, x=0.25, y=-0.1, outcome="push"),
    Event(12 * S, EventKind.OPERATOR_AWAY, operator=0),
    Event(20 * S, EventKind.OPERATOR_BACK, operator=0),
    Event(20 * S, EventKind.GRANT, 1, 0, 0, 0),
    Event(24 * S, EventKind.SERVICE_END, 1, 0, 0, 0, outcome="go_on"),
    Event(30 * S, EventKind.GRANT, 0, 0, 1, 0),
    Event(90 * S, EventKind.SERVICE_END, 0, 0, 1, 0, outcome="unanswered"),
    Event(99 * S, EventKind.GRANT, 1, 0, 1, 0),
    Event(101 * S, EventKind.SERVICE_END, 1, 0, 1, 0, outcome="push", object=1, x=0.3, y=0.0),
    Event(120 * S, EventKind.TASK_END, 1, 0, outcome="timed_out"),
]


def about() -> dict[str, Any]:
    settings = settings_of(SweepConfig(robots=(2,), policies=("pgf",), tasks=1))
    versions = {"pgf_jax": "0", "jax": "0"}
    return {
        "settings": settings | {"speed": 1.0, "patience": 60.0},
        "identity": {"versions": versions, "operator": "live"},
    }


def journals() -> list[bytes]:
    def write(path: Path, events: Sequence[Event]) -> None:
        journal = event_log.Journal(path, about())
        journal.append(events)
        journal.close()

    return [_written(lambda path, n=n: write(path, EVENTS[:n])) for n in (15, 8, 0)]


def event_tables() -> list[bytes]:
    merged = results.merge(
        [(Cell(policy, 2, 1), results.events_frame(EVENTS)) for policy in ("pgf", "or-hitl")]
    )
    return [
        _written(lambda path: write_log(path, EVENTS, about())),
        encode_table(results.events_frame(EVENTS)),
        encode_table(merged),
    ]


def task_tables() -> list[bytes]:
    counts = {"checks": 4, "check_misses": 1, "attempts": 2}
    counted = [dataclasses.replace(record, **counts) for record in records()]
    tables = (records(2), records(5), counted)
    return [encode_table(results.tasks_frame(of_one, lambda r, t: "x")) for of_one in tables]


def plans() -> list[bytes]:
    push = Segment("push", 3.0, np.full((2, 3), 0.1), np.full(2, 255.0))
    reach = Segment("reach", 3.0, np.zeros((2, 3)), np.zeros(2))
    terms = ("c_d", "c_f", "c_b", "c_e", "c_s", "total")
    plan = Plan(
        scene=Scene("two", np.array([[0.4, 0.1, 0.03], [0.5, 0.0, 0.03]]), 1),
        status=Status.NON_FINITE,
        seed=3,
        engine="native",
        lanes=1,
        physics="default",
        cost_variant="source",
        update="greedy",
        operator="heuristic",
        ask="after:3",
        segments=(push, reach),
        cost=dict.fromkeys(terms, 1.0) | {"c_f": np.inf},
        history=np.array([[1.0, np.inf, 0.0], [2.0, 3.0, 4.0]]),
        history_starts=(0,),
        iterations=5,
        reach_iterations=4,
        planning_time_s=16.5,
        waiting_s=0.0,
        interaction_s=8.0,
        execution_s=4.0,
        pushes=1,
        requests=1,
        grants=1,
        non_finite=2,
    )
    whole = _written(lambda path: save_plan(path.parent, plan))
    alone = dataclasses.replace(plan, segments=(reach,), pushes=0, status=Status.SOLVED)
    return [whole, _written(lambda path: save_plan(path.parent, alone))]


SWEEP = SweepConfig(
    robots=(2,), policies=("or-hitl", "autonomous"), tasks=2, operator="none", resume=True
)


def resolved(out: Path, **changes) -> ResolvedSweep:
    """The sweep, without the networks that ship: nobody bids, and they take long to load."""
    config = dataclasses.replace(SWEEP, out=out, **changes)
    nobody: Any = None
    return resolve(config, {predictor_spec(config.predictor): (nobody, {})})


@functools.cache
def key() -> str:
    """Of the first cell."""
    return resolved(Path("x")).cells[0].key


@functools.cache
def finished() -> dict[str, bytes]:
    """The files of a finished sweep, by their paths in its folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ours = resolved(folder)
        for cell in ours.cells:
            tasks = results.tasks_frame(records(), lambda robot, task: "x")
            content = cell_file.Content(tasks, results.events_frame(EVENTS), cell.about())
            account = {"session": "0123", "host": {"name": "here", "pid": 7}, "attempt": 1}
            account |= {"wall_s": 1.5, "inputs": ours.config.inputs()}
            cell_file.write(cell_file.path(folder, cell.key), content.data(), account)
        _write_results(CellStore(ours))
        return {
            str(path.relative_to(folder)): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file()
        }


def cell_files() -> dict[str, bytes]:
    """The cells alone, with what stands beside them."""
    return {name: data for name, data in finished().items() if name.startswith("cells/")}


def foreign_cell() -> list[bytes]:
    """A cell of another seed."""
    (other, _) = resolved(Path("x"), seed=1).cells
    (ours, _) = finished_cells()
    return [dataclasses.replace(ours, about=other.about()).data()]


def finished_cells() -> list[cell_file.Content]:
    files = {name: data for name, data in cell_files().items() if name.endswith(".parquet")}
    first = f"cells/{key()}.parquet"
    names = sorted(files, key=lambda name: name != first)
    return [cell_file.decode(files[name], Path(name)) for name in names]


def collect_settings() -> list[bytes]:
    kept = {"mode": "human", "classes": ["tight"], "seed": 0, "task_limit": 120.0, "scenes": 4}
    return [json_bytes(kept)]


# -- readers ---------------------------------------------------------------------------------------


def _scenes(folder: Path) -> None:
    load_scenes(folder)


def _checkpoint(folder: Path) -> None:
    path = folder / "phi_auto.msgpack"
    loaded = checkpoint.load(path)
    checkpoint.save(folder / "again", loaded)  # what was read can be written
    (folder / "again").unlink()
    PredictorSpec("paper", folder).load()


def _runs(folder: Path) -> None:
    frame = read_runs(folder / "runs.parquet")
    human_rows(frame)
    autonomous_rows(read_runs(folder / "runs.parquet", mode=Mode.AUTONOMOUS))


def _part(folder: Path) -> None:
    dataset._scenes_in(folder / "part_0.parquet")


def _forks(folder: Path) -> None:
    frame = read_forks(folder / "forks.parquet")
    try:
        gain_rows(frame)
    except BadInput as error:  # of a table, which it does not know the file of
        raise BadInput(f"{folder}: {error}") from None


def _tasks(folder: Path) -> None:
    results.task_records(results.read_results(folder / "tasks.parquet", results.TASK_SCHEMA))


def _cell(folder: Path) -> None:
    content = cell_file.read(cell_file.path(folder, key()))
    results.task_records(content.tasks)
    results.event_log(content.events)
    assert cell_file.decode(content.data(), folder).data() == content.data()


def _check_folder(folder: Path) -> None:
    CellStore(resolved(folder))


def _verify(folder: Path) -> None:
    """What is found is as good as a refusal, so long as it is one line that names a file of it."""
    outcome = verify(VerifyConfig(folder, cells=0), quiet=True)
    for finding in outcome.findings:
        assert finding.what.isprintable() and finding.what, f"not one line: {finding.what!r}"
        assert finding.path.is_relative_to(folder) and finding.path != folder
    if not outcome.ok:
        raise BadInput(f"{outcome.findings[0].path}: {outcome.findings[0].what}")


def _plan(folder: Path) -> None:
    plan = load_plan(folder / "two.plan.json")
    json.dumps(plan.to_json(), allow_nan=False)  # what was read can be written


def _log(path: Path) -> None:
    log = event_log.read_log(path)
    for events in log.fleets:
        event_log.digest(events)
    Recording.of(log)
    replay_config(SweepConfig(operator="replay", log=path), log)


def _fit(path: Path) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        fit_operator(FitOperatorConfig((path,), json=True))


def _finished(name: str) -> Callable[[], list[bytes]]:
    """The good file of that name."""
    return lambda: [finished()[name.replace("KEY", key())]]


def _verified(name: str, mutators: Sequence[mutate.Mutator], *, sign: bool = False) -> Reader:
    sealed = name.endswith(".csv") or (not sign and not name.endswith(".json"))
    return Reader(name, _verify, _finished(name), mutators, finished, sign, sealed)


def _cells() -> list[bytes]:
    return [content.data() for content in finished_cells()]


_CELL, _ACCOUNT = "cells/KEY.parquet", "cells/KEY.json"


READERS: dict[str, Reader] = {
    "scene": Reader("s.xml", lambda f: load_scene(f / "s.xml"), scene_files, mutate.XML),
    "scene_file": Reader("s.json", lambda f: load_scene(f / "s.json"), own_scenes, mutate.JSON),
    "scenes": Reader(
        "s_2.xml",
        _scenes,
        scene_files,
        mutate.XML,
        lambda: {"s_1.xml": scene_files()[-1], "1²3.xml": scene_files()[-1]},
    ),
    "checkpoint": Reader(
        "phi_auto.msgpack",
        _checkpoint,
        checkpoints,
        mutate.MSGPACK,
        lambda: {"phi_human.msgpack": shipped("phi_human")},
    ),
    "runs": Reader("runs.parquet", _runs, run_tables, mutate.PARQUET),
    "forks": Reader("forks.parquet", _forks, fork_tables, mutate.PARQUET),
    "part": Reader("part_0.parquet", _part, run_tables, mutate.PARQUET),
    "settings": Reader(
        "collect.json",
        lambda f: dataset._read_settings(f / "collect.json"),
        collect_settings,
        mutate.JSON,
    ),
    "tasks": Reader("tasks.parquet", _tasks, task_tables, mutate.PARQUET),
    "cell": Reader(_CELL, _cell, _cells, mutate.NESTED, cell_files, sealed=True),
    "cell_signed": Reader(_CELL, _cell, _cells, mutate.NESTED, cell_files, sign=True),
    "cell_account": Reader(_ACCOUNT, _cell, _finished(_ACCOUNT), mutate.JSON, cell_files),
    "folder": Reader(_ACCOUNT, _check_folder, _finished(_ACCOUNT), mutate.JSON, cell_files),
    "folder_foreign": Reader(
        f"cells/{'0' * 64}.parquet",
        _check_folder,
        foreign_cell,
        mutate.NESTED,
        cell_files,
        sign=True,
        expected="choose another folder with --out",
    ),
    "verify_manifest": _verified(MANIFEST, mutate.JSON),
    "verify_account": _verified(_ACCOUNT, mutate.JSON),
    "verify_cell": _verified(_CELL, mutate.NESTED),
    "verify_cell_signed": _verified(_CELL, mutate.NESTED, sign=True),
    "verify_unfinished": Reader(
        _CELL, _verify, _finished(_CELL), mutate.NESTED, cell_files, sign=True
    ),
    "verify_tasks": _verified("tasks.parquet", mutate.PARQUET),
    "verify_tasks_signed": _verified("tasks.parquet", mutate.PARQUET, sign=True),
    "verify_events": _verified("events.parquet", mutate.PARQUET),
    "verify_events_signed": _verified("events.parquet", mutate.PARQUET, sign=True),
    "verify_summary": _verified("summary.csv", mutate.TEXT),
    "verify_summary_signed": _verified("summary.csv", mutate.TEXT, sign=True),
    "json": Reader(
        "x.json",
        lambda f: read_json(f / "x.json"),
        lambda: [*_finished(MANIFEST)(), b'{"a": [1, 2.5, null, "b"]}'],
        mutate.JSON,
    ),
    "journal": Reader(
        "events.jsonl", lambda f: _log(f / "events.jsonl"), journals, mutate.JSON_LINES
    ),
    "log_table": Reader("events.parquet", _log, event_tables, mutate.PARQUET),
    "fit": Reader("events.jsonl", _fit, journals, mutate.JSON_LINES),
    "fit_table": Reader(
        "events.parquet", lambda f: _fit(f / "events.parquet"), event_tables, mutate.PARQUET
    ),
    "plan": Reader("two.plan.json", _plan, plans, mutate.JSON),
}


@functools.cache
def _seeds(name: str) -> Sequence[bytes]:
    return READERS[name].seeds()


@functools.cache
def _around(name: str) -> Mapping[str, bytes]:
    return READERS[name].around()


# -- cases -----------------------------------------------------------------------------------------


def case(name: str, number: int) -> bytes:
    """The changed file of a reader's case; number -1: a good one."""
    seeds = _seeds(name)
    if number < 0:
        return seeds[0]
    rng = np.random.default_rng([zlib.crc32(name.encode()), number])
    data = mutate.pick(rng, READERS[name].mutators)(mutate.pick(rng, seeds), seeds, rng)
    if rng.random() < 0.25:
        data = mutate.pick(rng, mutate.BYTES)(data, seeds, rng)
    return data


def corpus(name: str) -> list[Path]:
    """Files that once broke this reader, or are nasty by design."""
    return sorted((CORPUS / name).glob("*"))


def outcome(name: str, data: bytes, folder: Path) -> str:
    """What comes of reading these bytes in an empty folder."""
    reader = READERS[name]
    changed = reader.name.replace("KEY", key()) if "KEY" in reader.name else reader.name
    files = {**_around(name), changed: data}
    if reader.sign:
        files |= _signatures(changed, files)
    for file, content in files.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    try:
        reader.read(folder)
        passes = reader.sealed and data != _seeds(name)[0]
        said = "a changed file passes" if passes else "read"
    except BadInput as error:
        message = str(error)
        said = "refused"
        if not message.isprintable() or len(message) > LONGEST or not message:
            said = f"not one line: {message!r}"
        elif str(folder) not in message:
            said = f"does not name the file: {message}"
        elif reader.expected is not None and reader.expected in message:
            said = "read"
    except BaseException as error:
        said = f"{type(error).__name__}: {str(error)[:300]}"
    left = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()}
    if set(left) != set(files) or any(left[f].read_bytes() != files[f] for f in files):
        said = f"files changed: {sorted(left)}"
    return said


def _signatures(changed: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """What says the changed file's digest: what stands beside a cell, and a manifest."""
    digest, signed = sha256(files[changed]), {}
    if changed.startswith("cells/"):
        beside = changed.replace(".parquet", ".json")
        account = json.loads(cell_files()[f"cells/{key()}.json"])
        account |= {"sha256": digest, "bytes": len(files[changed])}
        signed[beside] = json_bytes(account)
    if MANIFEST in files:
        manifest = json.loads(files[MANIFEST])
        for cell in manifest["cells"]:
            if cell["file"] == changed:
                cell["sha256"] = digest
        if changed in manifest["files"]:
            manifest["files"][changed] = digest
        signed[MANIFEST] = json_bytes(manifest)
    return signed


def fewer_resamples() -> None:
    """A bootstrap of few samples: what is read does not depend on it."""
    lognormal.BOOTSTRAP = 20


def once_for_good_files() -> None:
    """Cells as they were written, which lie about what is changed, are decoded once each."""
    good = {data for name, data in cell_files().items() if name.endswith(".parquet")}
    decode = cell_file.decode
    of_good = functools.cache(lambda data: decode(data, Path("good.parquet")))

    def decode_unless_known(data: bytes, file: Path) -> cell_file.Content:
        return of_good(data) if data in good else decode(data, file)

    cell_file.decode = decode_unless_known
