"""Plans and their files, `DIR/NAME.plan.json`: what a robot executes, and how it was planned.

Numbers that are not finite (the cost of a rollout that diverged) are null in a file.
"""

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import MIB, parse_json, read_file, write_atomically
from pgf_jax.guidance.operators.registry import world_plugins
from pgf_jax.planning.types import Status
from pgf_jax.plans.config import PlanConfig
from pgf_jax.plugins.registry import plugins_record
from pgf_jax.provenance import environment
from pgf_jax.scene.draw import draw_scene
from pgf_jax.scene.file import scene_from_json, scene_to_json
from pgf_jax.scene.scene import Scene
from pgf_jax.settings import check_path, check_type, stored_settings
from pgf_jax.simulation.loop import PlannedFleet
from pgf_jax.simulation.robot import Segment

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pgf_jax.plans.config import ExecuteConfig
    from pgf_jax.plans.motion import Motion

TERMS = ("c_d", "c_f", "c_b", "c_e", "c_s")
SUFFIX = ".plan.json"
_LARGEST = 16 * MIB  # of a file; a plan takes some 100 kB
_SCENE = "scene_file"  # where objects or shelf are not standard: the scene as its own file has it


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """The plan of a scene, solved or not. Times are simulated, in s.

    Attributes:
      scene: the scene.
      status: how the task ended.
      seed: of the noise and of service times.
      engine, lanes, physics, cost_variant, update, operator, ask: settings, as in `PlanConfig`.
      segments: the pushes executed (each is followed by the retreat, which every executor knows),
        then the best reach from the state they leave, feasible or not.
      cost: c_d, c_f, c_b, c_e, c_s and total of that reach.
      history: (c_d, c_f, c_b) of the best trajectory after every reach iteration of the task,
        iteration 0 of each segment included.
      history_starts: rows of `history` that are such an iteration 0.
      iterations: of reaching and pushing, iteration 0s not counted.
      reach_iterations: those of reaching.
      planning_time_s: iterations, first rollouts, the final check and window waits.
      waiting_s: in windows and in line.
      interaction_s: being served.
      execution_s: executing pushes, retreats and the reach.
      pushes: executed.
      requests, grants: asks made, and services begun.
      non_finite: iterations in which some rollout's cost was not finite.
      settings: `world`, and other fields of `PlanConfig` that were not at their defaults, by name;
        and `plugins`, where engine or operator are of one.
    """

    scene: Scene
    status: Status
    seed: int
    engine: str
    lanes: int
    physics: str
    cost_variant: str
    update: str
    operator: str
    ask: str
    segments: tuple[Segment, ...]
    cost: Mapping[str, float]
    history: np.ndarray  # [I, 3]
    history_starts: tuple[int, ...]
    iterations: int
    reach_iterations: int
    planning_time_s: float
    waiting_s: float
    interaction_s: float
    execution_s: float
    pushes: int
    requests: int
    grants: int
    non_finite: int
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @classmethod
    def from_task(cls, config: PlanConfig, seed: int, planned: PlannedFleet) -> "Plan":
        """The plan of a fleet of one robot whose one task has ended."""
        (record,), robot = planned.fleet.records, planned.robots.robots[0]
        terms = [float(term) for term in robot.reach.value.terms]
        log = robot.log.frame()
        reach = log.filter(log["kind"] == "reach")
        segments = reach["segment"].to_numpy()
        return cls(
            scene=robot.scene,
            status=record.status,
            seed=seed,
            engine=config.engine,
            lanes=config.lanes,
            physics=config.physics,
            cost_variant=config.cost,
            update=config.update,
            operator=config.operator,
            ask=config.ask,
            segments=(*robot.executed, planned.robots.segment(robot.reach)),
            cost=dict(zip(TERMS, terms, strict=True)) | {"total": float(robot.reach.value.total)},
            history=reach.select("c_d", "c_f", "c_b").to_numpy().reshape(-1, 3),
            history_starts=tuple(int(i) for i in np.flatnonzero(np.diff(segments, prepend=-1))),
            iterations=record.iterations,
            reach_iterations=record.reach_iterations,
            planning_time_s=record.planning_time_s,
            waiting_s=record.waiting_s,
            interaction_s=record.interaction_s,
            execution_s=record.execution_s,
            pushes=record.pushes_succeeded,
            requests=record.requests,
            grants=record.grants,
            non_finite=record.non_finite,
            settings=_other_settings(config),
        )

    @property
    def solved(self) -> bool:
        """Whether the reach is feasible."""
        return self.status == Status.SOLVED

    def motion(self, config: "ExecuteConfig | None" = None, repeat: int = 0) -> "Motion":
        """The execution of the plan, simulated once more: poses of hand and objects over time.

        Args:
          config: in which world, see `pgf_jax.execute`; None: in the solid world if the plan was
            checked there, else by the plan's engine.
          repeat: number of the execution, 0-based: of the draw of the world's error.

        Raises:
          BadInput: the plan's engine, physics or world is unknown here, or it does not stay finite.
        """
        from pgf_jax.plans.motion import Motion

        return Motion(self, config, repeat)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the plan: the shelf at first, the hand's paths, and where objects end.

        Args:
          ax: matplotlib axes to draw into; None: those of a new figure (`ax.figure`).

        Raises:
          BadInput: see `motion`.
        """
        motion = self.motion()
        status = str(self.status).replace("_", " ")
        return draw_scene(
            self.scene,
            ax,
            ee_paths=motion.end_effector_paths(),
            end_positions=motion.objects[-1],
            title=f"{self.scene.name}: {status}, {self.pushes} pushes",
            legend=True,
        )

    def to_json(self) -> dict[str, Any]:
        """The content of the plan's file."""
        plain = {field: getattr(self, field) for field in _PLAIN}
        own = {} if self.scene.shelf is None else {_SCENE: scene_to_json(self.scene)}
        return {
            "scene": self.scene.name,
            "status": str(self.status),
            **plain,
            "objects": self.scene.objects.tolist(),
            "goal": self.scene.goal,
            **own,
            "segments": [
                {
                    "kind": segment.kind,
                    "duration_s": float(segment.duration_s),
                    "controls": np.asarray(segment.controls, np.float64).tolist(),
                    "gripper": np.asarray(segment.gripper, np.float64).tolist(),
                }
                for segment in self.segments
            ],
            "cost": {name: _or_null(value) for name, value in self.cost.items()},
            "history": [[_or_null(term) for term in row] for row in self.history.tolist()],
            "history_starts": list(self.history_starts),
            "settings": dict(self.settings),
        }


def _other_settings(config: PlanConfig) -> dict[str, Any]:
    """The settings that a plan has no field for and that are not at their defaults, as JSON.

    And what engine and operator are made of, where they are of plugins.
    """
    own = {*_TEXTS, "cost", "lanes"}
    values = {
        field.name: getattr(config, field.name)
        for field in dataclasses.fields(PlanConfig)
        if field.name not in own and getattr(config, field.name) != field.default
    }
    plugins = plugins_record(world_plugins(config.engine, config.operator))
    values |= {"plugins": plugins} if plugins else {}
    # Always there: plans of before there were worlds have none.
    values["world"] = config.world
    return {name: list(v) if isinstance(v, tuple) else v for name, v in values.items()}


_TEXTS = ("engine", "physics", "cost_variant", "update", "operator", "ask")
_COUNTS = (
    *("seed", "lanes", "iterations", "reach_iterations"),
    *("pushes", "requests", "grants", "non_finite"),
)
_TIMES = ("planning_time_s", "waiting_s", "interaction_s", "execution_s")
_PLAIN = (*_TEXTS, *_COUNTS, *_TIMES)


def plan_path(folder: Path | str, scene: str) -> Path:
    """Where the plan of a scene lies in a folder.

    Raises:
      BadInput: the scene's name would lead elsewhere.
    """
    if scene in ("", ".", "..") or "/" in scene or "\0" in scene:
        raise BadInput(f"scene: expected a name that a file can have, got {short_repr(scene)}")
    return Path(folder) / f"{scene}{SUFFIX}"


def save_plan(folder: Path | str, plan: Plan) -> Path:
    """Write `folder/NAME.plan.json`, whole or not at all; returns its path.

    Beside the plan it says what made it: versions, commit, processor.

    Raises:
      BadInput: it cannot be written there, or an argument is something else.
    """
    if isinstance(folder, Plan):
        raise BadInput("save_plan(folder, plan): the arguments are swapped, got a Plan first")
    check_type("plan", plan, Plan)
    if check_path("folder", folder).name.endswith(SUFFIX):
        raise BadInput(
            f"folder: expected a folder, got {short_repr(str(folder))}; "
            f"the file in it is called {plan.scene.name}{SUFFIX}"
        )
    path = plan_path(folder, plan.scene.name)
    content = plan.to_json() | {"made_by": environment()}
    write_atomically(path, (json.dumps(content, allow_nan=False) + "\n").encode())
    return path


def load_plan(path: Path | str) -> Plan:
    """Read a plan's file and check all of it; null numbers come back as inf.

    Raises:
      BadInput: one line that names the file: missing, truncated, or with a field that is missing or
        wrong; or it is no path.
    """
    path = check_path("path", path)
    data = read_file(path, f"a plan ({SUFFIX})", _LARGEST)
    try:
        content = parse_json(data)
    except ValueError as error:
        raise BadInput(f"{path}: truncated or malformed, not a plan ({SUFFIX})") from error
    try:
        return _from_json(content)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def _from_json(content: Any) -> Plan:
    if not isinstance(content, dict):
        raise BadInput(f"expected a mapping of a plan's fields, got {short_repr(content)}")
    plan_path("", _get(content, "scene", str))  # it names the file that this is written to again
    status = _get(content, "status", str)
    if status not in list(Status):
        raise BadInput(f"status: expected one of {', '.join(Status)}, got {status!r}")
    plain: dict[str, Any] = {field: _get(content, field, str) for field in _TEXTS}
    for field in _COUNTS:
        plain[field] = _get(content, field, int)
        if plain[field] < 0:
            raise BadInput(f"{field}: expected 0 or more, got {plain[field]}")
    for field in _TIMES:
        plain[field] = _seconds(content, field)
        if not 0.0 <= plain[field] < math.inf:
            raise BadInput(f"{field}: expected seconds, 0 or more, got {plain[field]}")
    name, objects = _get(content, "scene", str), _get(content, "objects", list)
    goal = _get(content, "goal", int)
    if _SCENE in content:
        try:
            scene = scene_from_json(content[_SCENE])
        except BadInput as error:
            raise BadInput(f"{_SCENE}: {error}") from None
        if (scene.name, scene.goal, scene.objects.tolist()) != (name, goal, objects):
            raise BadInput(f"{_SCENE}: expected the plan's scene, objects and goal, got others")
    else:
        scene = Scene(name, objects, goal)
    segments = tuple(
        _segment(segment, f"segments[{i}]")
        for i, segment in enumerate(_get(content, "segments", list))
    )
    kinds = [segment.kind for segment in segments]
    pushes = plain["pushes"]  # any number: nothing may be made as long as it says
    if len(kinds) != pushes + 1 or kinds[-1] != "reach" or "reach" in kinds[:-1]:
        raise BadInput(f"segments: expected {pushes} pushes and a reach, got {short_repr(kinds)}")
    cost = _get(content, "cost", dict)
    if set(cost) != {*TERMS, "total"}:
        raise BadInput(f"cost: expected {', '.join(TERMS)} and total, got {short_repr(list(cost))}")
    values = _numbers(list(cost.values()), (len(cost),), "cost", null=True)
    history = _get(content, "history", list)
    starts = _get(content, "history_starts", list)
    if not all(type(start) is int and 0 <= start < len(history) for start in starts):
        raise BadInput(f"history_starts: expected rows of history, got {short_repr(starts)}")
    settings = _get({"settings": {}, **content}, "settings", dict)  # earlier plans have none
    settings = stored_settings({**settings, "physics": plain["physics"]})
    return Plan(
        scene=scene,
        status=Status(status),
        segments=segments,
        cost=dict(zip(cost, values.tolist(), strict=True)),
        history=_numbers(history, (len(history), 3), "history", null=True),
        history_starts=tuple(starts),
        settings={name: value for name, value in settings.items() if name != "physics"},
        **{**plain, "physics": settings["physics"]},
    )


def _segment(segment: Any, name: str) -> Segment:
    if not isinstance(segment, dict):
        raise BadInput(f"{name}: expected a mapping, got {short_repr(segment)}")
    kind = _get(segment, "kind", str, name)
    if kind not in ("push", "reach"):
        raise BadInput(f"{name} kind: expected push or reach, got {kind!r}")
    duration = _seconds(segment, "duration_s", name)
    if not 0.0 < duration < math.inf:
        raise BadInput(f"{name} duration_s: expected a positive number, got {duration}")
    controls = _get(segment, "controls", list, name)
    if not controls:
        raise BadInput(f"{name} controls: expected [T, 3] with one knot or more, got none")
    gripper = _numbers(
        _get(segment, "gripper", list, name), (len(controls),), f"{name} gripper", null=False
    )
    if not ((gripper >= 0) & (gripper <= 255)).all():
        raise BadInput(f"{name} gripper: expected 0 (open) .. 255 (closed), got {gripper.tolist()}")
    return Segment(
        kind,
        duration,
        _numbers(controls, (len(controls), 3), f"{name} controls", null=False),
        gripper,
    )


def _get(content: dict[str, Any], field: str, kind: Any, within: str = "") -> Any:
    name = f"{within} {field}".strip()
    if field not in content:
        raise BadInput(f"{name}: missing")
    value = content[field]
    if not isinstance(value, kind) or isinstance(value, bool):
        expected = getattr(kind, "__name__", str(kind))
        raise BadInput(f"{name}: expected {expected}, got {short_repr(value)}")
    return value


def _seconds(content: dict[str, Any], field: str, within: str = "") -> float:
    value = _get(content, field, int | float, within)
    try:
        return float(value)
    except OverflowError:  # a whole number of hundreds of digits
        return math.inf


def _numbers(values: list, shape: tuple[int, ...], name: str, *, null: bool) -> np.ndarray:
    """Check numbers: a float64 array of `shape`; nulls, where allowed, become inf."""
    try:
        # numpy reads a null as nan; an empty list has lost the axes after its first.
        array = np.array(values, dtype=np.float64) if values else np.empty(shape)
    except (TypeError, ValueError, OverflowError):  # a whole number may be too large for a float
        raise BadInput(
            f"{name}: expected numbers {list(shape)}, got {short_repr(values)}"
        ) from None
    if array.shape != shape:
        raise BadInput(f"{name}: expected shape {list(shape)}, got {list(array.shape)}")
    if not null and not np.isfinite(array).all():
        raise BadInput(f"{name}: expected finite numbers")
    return np.where(np.isnan(array), np.inf, array) if null else array


def _or_null(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
