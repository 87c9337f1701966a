"""`pgf_jax.verify`: checks that results are as they were written, and computes some again."""

import dataclasses
import secrets
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from pgf_jax.errors import BadInput
from pgf_jax.inspection.config import VerifyConfig
from pgf_jax.inspection.folder_check import Checked, Finding, check_files
from pgf_jax.settings import check_type
from pgf_jax.streams import stream
from pgf_jax.sweeping import cell_file
from pgf_jax.sweeping.config import INPUTS
from pgf_jax.sweeping.resolve import Loaded, config_of, differences, resolve
from pgf_jax.sweeping.sweep import sweeps
from pgf_jax.tables import results
from pgf_jax.tables.event_log import first_difference


class Recomputed(NamedTuple):
    """A cell that was computed again.

    Attributes:
      path: its file.
      name: of the cell.
      same: whether it came out bit for bit.
      words: how far it is off, and what is not as it was; empty where it is the same.
      expected: whether it had to come out: versions, revisions and the type of processor are the
        same, or what it was computed from is not.
    """

    path: Path
    name: str
    same: bool
    words: str
    expected: bool


@dataclasses.dataclass(frozen=True)
class Verification:
    """The outcome of `verify`.

    Attributes:
      folder: of the results.
      complete: whether the sweep had been finished.
      cells: sound ones.
      findings: files that are not as they were written, or cells that did not come out again.
      recomputed: the cells that were computed again.
      seed: of the draw.
    """

    folder: Path
    complete: bool
    cells: int
    findings: tuple[Finding, ...]
    recomputed: tuple[Recomputed, ...]
    seed: int

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong; a cell may differ on another type of processor."""
        return not self.findings


def verify(config: VerifyConfig, *, quiet: bool = False) -> Verification:
    """Check a sweep's results.

    Args:
      config: what.
      quiet: no progress, no report.

    Raises:
      BadInput: the folder holds no results, or another sweep is at it.
    """
    hint = "VerifyConfig(folder) names it" if isinstance(config, str | Path) else ""
    check_type("config", config, VerifyConfig, hint=hint)
    seed = secrets.randbelow(1 << 31) if config.seed is None else config.seed
    checked = check_files(config.folder)
    drawn = _draw(checked, config.cells, seed)
    again, findings = _again(config, checked, drawn, quiet=quiet)
    findings += [
        Finding(cell.path, f"another one when computed again: {cell.words}")
        for cell in again
        if not cell.same and cell.expected
    ]
    outcome = Verification(
        config.folder,
        checked.complete,
        len(checked.sound),
        (*checked.findings, *findings),
        tuple(again),
        seed,
    )
    if not quiet:
        _show(outcome)
    return outcome


def _draw(checked: Checked, count: int, seed: int) -> list[Path]:
    files = sorted(checked.sound)
    if count >= len(files):
        return files
    order = np.argsort(stream(seed, "verify").random(len(files)), kind="stable")
    return sorted(files[i] for i in order[:count])


def _again(
    config: VerifyConfig, checked: Checked, drawn: Sequence[Path], *, quiet: bool
) -> tuple[list[Recomputed], list[Finding]]:
    """Compute cells again, all in one run."""
    findings: list[Finding] = []
    now = {name: getattr(config, name) for name in INPUTS}
    now = {name: value for name, value in now.items() if value is not None}
    loaded: Loaded = {}
    with tempfile.TemporaryDirectory() as name:
        configs, files = [], []
        for path in drawn:
            inputs = cell_file.inputs(path) | now
            try:
                again = config_of(checked.sound[path].about, inputs, Path(name) / path.stem)
                resolve(again, loaded)  # what it reads is there
            except (BadInput, TypeError) as error:
                findings.append(Finding(path, f"cannot be computed again: {error}"))
                continue
            configs.append(dataclasses.replace(again, workers=config.workers))
            files.append(path)
        outcomes = sweeps(configs, quiet=quiet, tables=False)
        recomputed = []
        for path, outcome in zip(files, outcomes, strict=True):
            ((cell, file),) = outcome.files.items()
            recomputed.append(_compared(path, cell.name, checked.sound[path], cell_file.read(file)))
    return recomputed, findings


def _compared(path: Path, name: str, old: cell_file.Content, new: cell_file.Content) -> Recomputed:
    # Written with the same words of their origin, they are the same bytes.
    if dataclasses.replace(new, about=old.about).data() == old.data():
        return Recomputed(path, name, True, "", True)
    about = old.about["identity"], new.about["identity"]
    inputs = differences(*({name: each.get(name) for name in _INPUTS} for each in about))
    kind = differences(*({name: each.about.get(name) for name in _KIND} for each in (old, new)))
    code = differences(*({"code": _code(each.about.get("code"))} for each in (old, new)))
    earlier = _revisions(*about)
    words = "; ".join(filter(None, [distance(old, new), inputs, earlier, kind, code]))
    return Recomputed(path, name, False, words, bool(inputs) or not (kind or earlier))


# What an identity says of files: with others it is another question.
_INPUTS = ("scenes", "predictors", "log", "plugins")
# What may change results without anybody's fault.
_KIND = ("processor", "device", "versions")


def _revisions(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """By which revisions of what is built in a cell was computed, where they are others now."""
    then, now = (each.get("revisions") or {} for each in (old, new))
    kinds = sorted(kind for kind in {*then, *now} if then.get(kind, 1) != now.get(kind, 1))
    names = {"engine": new.get("engine"), "operator": new.get("operator")}
    words = (f"{names.get(kind, kind)} {then.get(kind, 1)}" for kind in kinds)
    return f"computed by {', '.join(words)}" if kinds else ""


def _code(code: Any) -> str:
    """The code that computed a cell, in few words."""
    if not isinstance(code, dict):
        return "unknown"
    git, source = code.get("git"), str(code.get("source_sha256"))[:8]
    commit = f"commit {str(git.get('commit'))[:8]}, " if isinstance(git, dict) else ""
    return f"{commit}source {source}"


def distance(old: cell_file.Content, new: cell_file.Content) -> str:
    """The difference between two results of a cell, in words."""
    both = old.tasks.join(new.tasks, on=["robot", "task"], suffix="_new")
    alike = int((both["status"] == both["status_new"]).sum())
    late = (both["planning_time_s"] - both["planning_time_s_new"]).abs().max()
    cost = (both["cost"] - both["cost_new"]).abs().max()
    logs = [results.event_log(content.events) for content in (old, new)]
    first = first_difference(logs[1], logs[0])
    if first is None and len(logs[1]) > len(logs[0]):
        first = len(logs[0])
    total = len(old.tasks)
    words = [f"{alike} of {total} tasks end alike"]
    if late is not None:
        words.append(f"planning times differ by up to {late:g} s")
    if cost is not None:
        words.append(f"costs by up to {cost:.3g}")
    if first is not None:
        at = logs[0][min(first, len(logs[0]) - 1)].time_ns / 1e9 if logs[0] else 0.0
        words.append(f"the first {first} of {len(logs[0])} events agree (until {at:g} s)")
    return ", ".join(words)


def _show(outcome: Verification) -> None:
    console = Console()
    if outcome.recomputed:
        table = Table("cell", "computed again", "")
        for cell in outcome.recomputed:
            table.add_row(cell.name, "bit for bit the same" if cell.same else "differs", cell.words)
        console.print(table)
    for finding in outcome.findings:
        console.print(
            f"{finding.path}: {finding.what}", markup=False, highlight=False, soft_wrap=True
        )
    state = "finished" if outcome.complete else "not finished (--resume goes on)"
    console.print(
        f"{outcome.folder}: {state}; {outcome.cells} cells as they were written, "
        f"{len(outcome.recomputed)} computed again (--seed {outcome.seed}); "
        f"{len(outcome.findings)} problems",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )


def run(config: VerifyConfig) -> None:
    """Run the command: verify, and report.

    Raises:
      BadInput: something is wrong with the results.
    """
    outcome = verify(config)
    if not outcome.ok:
        first = outcome.findings[0]
        raise BadInput(
            f"{outcome.folder}: {len(outcome.findings)} problems, the first: {first.path}: "
            f"{first.what}"
        )
