"""The design of a study: reads and checks its folder.

`study.toml` says what is compared, on which scenes and for how long, and what is asked. Beside it
stand texts (Markdown) and questionnaires (TOML), so that a study is changed without programming.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pgf_jax.console.config import ConsoleConfig
from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import MIB, read_file
from pgf_jax.settings import Bounds, Count, Index, Seconds, Seed, check_fields
from pgf_jax.study.orders import Block, blocks_of
from pgf_jax.study.questionnaires import Questionnaire, read_questionnaire, read_toml

DESIGN = "study.toml"
FORMAT = 1
TEXTS = ("consent", "instructions", "break", "closing")
# Settings of a fleet that the study itself decides.
_OURS = ("seed", "out", "resume", "host", "port", "operator", "log", "horizon", "tasks", "speed")
_ENOUGH = 1000  # tasks of each robot: a block ends by its time

Minutes = Annotated[float, Bounds(above=0.0, most=240.0, unit="minutes")]


@dataclasses.dataclass(frozen=True)
class Blocks:
    """The blocks, one for each condition.

    Attributes:
      scene_seeds: a set of scenes for each block; the sets are counterbalanced over conditions.
      minutes: how long a block lasts.
      break_s: how long the break after a block lasts at least, s.
    """

    scene_seeds: tuple[Seed, ...]
    minutes: Minutes = 5.0
    break_s: Seconds = 30.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclasses.dataclass(frozen=True)
class Practice:
    """Practice, with other scenes and another policy, until enough pushes were executed.

    Attributes:
      robots: of its fleet.
      scene_class: of its scenes.
      seed: of its scenes.
      pushes: that must have been executed.
      minutes: after which it ends anyway.
      policy: of its fleet; one that asks often.
    """

    robots: Count = 2
    scene_class: str = "tight"
    seed: Seed = 0
    pushes: Index = 3
    minutes: Minutes = 10.0
    policy: str = "random"

    def __post_init__(self) -> None:
        check_fields(self)


@dataclasses.dataclass(frozen=True)
class Questions:
    """Which questionnaires are asked when, by the names of their files.

    Attributes:
      after_block: after each block.
      at_end: after the last block.
    """

    after_block: tuple[str, ...] = ()
    at_end: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)


@dataclasses.dataclass(frozen=True)
class Shown:
    """What the page shows of the robots, the same in all conditions.

    Attributes:
      sure: a bar for each robot: how likely it finds its way by itself within 30 s.
      cost_curve: of the robot that asks: the cost of its best trajectory so far.
      shelf_3d: the shelf of the robot that asks in perspective, too.
    """

    sure: bool = True
    cost_curve: bool = False
    shelf_3d: bool = False

    def __post_init__(self) -> None:
        check_fields(self)


@dataclasses.dataclass(frozen=True)
class Dataset:
    """What an exported data set says of itself.

    Attributes:
      description: what was studied, in a sentence or more.
      authors: their names.
      license: of the data, as a name or an address.
    """

    description: str = "A study of one person who helps a fleet of robots that plan reaches."
    authors: tuple[str, ...] = ()
    license: str = ""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """A study as its folder describes it.

    Attributes:
      folder: of the study.
      title: shown to participants.
      fleet: settings of `pgf-jax console` that all conditions share.
      conditions: name -> the settings that are its own.
      blocks, practice, questions, shown, dataset: see there.
      texts: name -> Markdown; see `TEXTS`.
      questionnaires: name -> questionnaire, of all that are asked.
    """

    folder: Path
    title: str
    fleet: Mapping[str, Any]
    conditions: Mapping[str, Mapping[str, Any]]
    blocks: Blocks
    practice: Practice
    questions: Questions
    shown: Shown
    dataset: Dataset
    texts: Mapping[str, str]
    questionnaires: Mapping[str, Questionnaire]

    def blocks_of(self, participant: int) -> tuple[Block, ...]:
        """The blocks of a participant (from 0); see `orders.blocks_of`."""
        return blocks_of(participant, len(self.conditions))

    def policy(self, condition: str) -> str:
        """The policy of a condition."""
        return self._settings(condition).get("policy", ConsoleConfig().policy)

    def _settings(self, condition: str) -> dict[str, Any]:
        return dict(self.fleet) | dict(self.conditions[condition])

    def session(self, block: Block, out: Path) -> ConsoleConfig:
        """The settings of the session of a block."""
        name = list(self.conditions)[block.condition]
        return _session(
            self._settings(name),
            seed=self.blocks.scene_seeds[block.scenes],
            horizon=60 * self.blocks.minutes,
            out=out,
        )

    def practice_session(self, out: Path) -> ConsoleConfig:
        """The settings of the session of the practice."""
        practice = self.practice
        own = {"robots": practice.robots, "scene_class": practice.scene_class}
        own |= {"policy": practice.policy}
        shared = {name: value for name, value in self.fleet.items() if name != "scenes"}
        return _session(shared | own, seed=practice.seed, horizon=60 * practice.minutes, out=out)


def _session(settings: dict[str, Any], **ours: Any) -> ConsoleConfig:
    listed = {name: tuple(v) if isinstance(v, list) else v for name, v in settings.items()}
    return ConsoleConfig(**listed, tasks=_ENOUGH, operator="live", **ours)


def load_design(folder: Path) -> Design:
    """Read the folder of a study, and check that each of its sessions could begin.

    Raises:
      BadInput: one line that names the file and the entry.
    """
    path = folder / DESIGN
    content = read_toml(path, "a study")
    parts_of = {
        "blocks": Blocks,
        "practice": Practice,
        "questions": Questions,
        "shown": Shown,
        "dataset": Dataset,
    }
    known = ("version", "title", "fleet", "conditions", *parts_of)
    for name in content:
        if name not in known:
            raise BadInput(f"{path}: {name}: no such entry, expected one of {', '.join(known)}")
    if content.get("version") != FORMAT:
        raise BadInput(f"{path}: version: expected {FORMAT}, got {content.get('version')!r}")
    title = content.get("title")
    if not isinstance(title, str) or not title.strip():
        raise BadInput(f"{path}: title: expected text, got {short_repr(title)}")
    fleet = _table(path, "fleet", content.get("fleet", {}))
    conditions = _table(path, "conditions", content.get("conditions"))
    for name in conditions:
        _table(path, f"conditions.{name}", conditions[name])
    if not conditions:
        raise BadInput(f"{path}: conditions: expected one or more, as [conditions.NAME]")
    parts: dict[str, Any] = {}
    for name, kind in parts_of.items():
        table = _table(path, name, content.get(name, {}))
        try:
            parts[name] = kind(**table)
        except (BadInput, TypeError) as error:
            raise BadInput(f"{path}: {name}: {_plain(error)}") from None
    design = Design(
        folder,
        title,
        fleet,
        conditions,
        **parts,
        texts={name: _text(folder / f"{name}.md") for name in TEXTS},
        questionnaires=_questionnaires(folder, parts["questions"]),
    )
    _check(design, path)
    return design


def _check(design: Design, path: Path) -> None:
    """Whether each session could begin, and the sets of scenes are as many as the conditions."""
    sets, conditions = len(design.blocks.scene_seeds), len(design.conditions)
    if sets != conditions or len(set(design.blocks.scene_seeds)) != sets:
        raise BadInput(
            f"{path}: blocks: scene_seeds: expected {conditions} different ones, as many as "
            f"conditions, got {list(design.blocks.scene_seeds)}"
        )
    tables = [("fleet", design.fleet)]
    tables += [(f"conditions.{name}", own) for name, own in design.conditions.items()]
    for name, table in tables:
        for ours in _OURS:
            if ours in table:
                raise BadInput(f"{path}: {name}: {ours}: the study decides that itself")
    for number, name in enumerate(design.conditions):
        try:
            design.session(Block(number, 0), path.parent)
        except (BadInput, TypeError) as error:
            raise BadInput(f"{path}: conditions.{name}: {_plain(error)}") from None
    try:
        design.practice_session(path.parent)
    except (BadInput, TypeError) as error:
        raise BadInput(f"{path}: practice: {_plain(error)}") from None


def _plain(error: Exception) -> str:
    """An error in a line: of a field that does not exist, or is missing, its name."""
    words = str(error)
    return words.partition("__init__() ")[2] or words


def _table(path: Path, name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise BadInput(f"{path}: {name}: expected a table, got {short_repr(value)}")
    return value


def _text(path: Path) -> str:
    try:
        return read_file(path, "a text in Markdown", MIB).decode()
    except UnicodeDecodeError:
        raise BadInput(f"{path}: expected a text in UTF-8") from None


def _questionnaires(folder: Path, questions: Questions) -> dict[str, Questionnaire]:
    names = dict.fromkeys((*questions.after_block, *questions.at_end))
    for name in names:
        if not name.isidentifier():
            raise BadInput(f"{folder / DESIGN}: questions: no name of a questionnaire: {name!r}")
    return {name: read_questionnaire(folder / "questionnaires" / f"{name}.toml") for name in names}
