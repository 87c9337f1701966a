"""Where a participant is in a study: the steps, and the journal from which they are resumed.

A participant has a folder. `participant.json` says who has which blocks; `progress.jsonl` has a
line for each thing that happened, which is on the disk before the participant goes on. Neither
holds a name, an address or what browser was used.
"""

import dataclasses
import hashlib
import hmac
import json
import os
import secrets
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from pgf_jax.errors import BadInput
from pgf_jax.files import MIB, json_bytes, parse_json, read_file, read_json, write_atomically
from pgf_jax.study.design import Design
from pgf_jax.study.orders import Block

PARTICIPANTS = "participants"
ABOUT, JOURNAL = "participant.json", "progress.jsonl"
_LARGEST = 64 * MIB
Kind = Literal["text", "practice", "block", "questions", "break", "closing"]


@dataclasses.dataclass(frozen=True)
class Step:
    """One page of a participant.

    Attributes:
      kind: of the page.
      name: of its text or questionnaire; of a block its condition; else that of its kind.
      block: number of the block, from 0, that it is or follows; None: it is of no block.
    """

    kind: Kind
    name: str
    block: int | None = None


def steps_of(design: Design, blocks: tuple[Block, ...]) -> tuple[Step, ...]:
    """All steps of a participant, in order."""
    conditions = list(design.conditions)
    steps = [Step("text", "consent"), Step("text", "instructions"), Step("practice", "practice")]
    for number, block in enumerate(blocks):
        steps.append(Step("block", conditions[block.condition], number))
        steps += [Step("questions", name, number) for name in design.questions.after_block]
        if number + 1 < len(blocks):
            steps.append(Step("break", "break", number))
    steps += [Step("questions", name) for name in design.questions.at_end]
    return (*steps, Step("closing", "closing"))


class Progress:
    """How far a participant has come: the blocks, the steps, and what has happened.

    Attributes:
      folder: of what is recorded.
      number: from 0, in the order in which participants were added.
      blocks, steps: in order.
      code: shown at the end, to be paid by.
      done: how many steps are done.
      events: of the journal, in order.
      size: of the journal that could be read, bytes: its last line may be cut off.
    """

    def __init__(self, design: Design, folder: Path) -> None:
        """Read the participant's folder.

        Raises:
          BadInput: a file in it is not what it should be, or of another design.
        """
        about = read_json(folder / ABOUT, "a participant")
        for name, kind in (("number", int), ("code", str), ("token_sha256", str)):
            if not isinstance(about.get(name), kind):
                raise BadInput(f"{folder / ABOUT}: {name}: expected {kind.__name__}")
        self.folder, self.number, self.code = folder, about["number"], about["code"]
        self._token = about["token_sha256"]
        self.blocks = design.blocks_of(self.number)
        if about.get("blocks") != [dataclasses.asdict(block) for block in self.blocks]:
            raise BadInput(
                f"{folder / ABOUT}: the participant has other blocks than the study gives now; "
                "conditions cannot be changed once there are participants"
            )
        self.steps = steps_of(design, self.blocks)
        self.events, self.size = _read(folder / JOURNAL)
        self.done = sum(event["kind"] == "done" for event in self.events)

    @property
    def step(self) -> Step | None:
        """The step to be done; None: all are."""
        return self.steps[self.done] if self.done < len(self.steps) else None

    @property
    def finished(self) -> bool:
        """Whether the participant has come to the code."""
        return self.step is None or self.step.kind == "closing"

    def session(self, step: Step) -> Path:
        """The folder of a session: of a block, or of the practice."""
        return self.folder / ("practice" if step.block is None else f"block{step.block + 1}")


class Participant(Progress):
    """One participant who takes part: what happens is recorded."""

    def __init__(self, design: Design, folder: Path) -> None:
        """Read the participant's folder, and open its journal; see `Progress`."""
        super().__init__(design, folder)
        self._file = os.open(
            folder / JOURNAL, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600
        )
        os.ftruncate(self._file, self.size)  # without a line that was cut off

    def is_token(self, given: str) -> bool:
        """Whether a token is this participant's."""
        return hmac.compare_digest(_digest(given), self._token)

    def note(self, kind: str, details: Mapping[str, Any] | None = None) -> None:
        """Record something that has happened; it is on the disk when this returns."""
        step = self.step
        event = {"kind": kind, "at_ms": round(time.time() * 1000), "step": self.done}
        event |= {"name": step.name if step else ""} | dict(details or {})
        os.write(self._file, json.dumps(event, allow_nan=False).encode() + b"\n")
        os.fsync(self._file)
        self.events.append(event)

    def finish(self, step: int, details: Mapping[str, Any] | None = None) -> bool:
        """Record that a step is done; False: it is not the one to be done, and nothing changes.

        A page that is sent twice, or is no longer the present one, so does nothing.
        """
        if step != self.done or self.step is None:
            return False
        self.note("done", details)
        self.done += 1
        return True

    def close(self) -> None:
        """Close the journal."""
        os.close(self._file)


def add_participant(
    design: Design, *, secret: Callable[[], str] = lambda: secrets.token_urlsafe(18)
) -> tuple[Path, str]:
    """Add a participant; returns the folder, and the token of the link, which is kept nowhere."""
    number = len(participants(design.folder))
    token, code = secret(), secret()[:8]
    about = {
        "number": number,
        "token_sha256": _digest(token),
        "code": code,
        "blocks": [dataclasses.asdict(block) for block in design.blocks_of(number)],
    }
    folder = design.folder / PARTICIPANTS / f"{number:03d}"
    folder.mkdir(parents=True)
    write_atomically(folder / ABOUT, json_bytes(about))
    return folder, token


def participants(folder: Path) -> list[Path]:
    """The folders of a study's participants, in order."""
    return sorted(path.parent for path in (folder / PARTICIPANTS).glob(f"*/{ABOUT}"))


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def _read(path: Path) -> tuple[list[dict[str, Any]], int]:
    """The events of a journal, and the bytes that they take; the last line may be cut off."""
    if not path.exists():
        return [], 0
    whole, _, _ = read_file(path, "a participant's journal", _LARGEST).rpartition(b"\n")
    events: list[dict[str, Any]] = []
    done = 0
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            event = parse_json(line)
        except ValueError:
            event = None
        if not isinstance(event, dict) or not isinstance(event.get("kind"), str):
            raise BadInput(f"{path}: line {number}: expected an event of a participant")
        if event["kind"] == "done":
            if event.get("step") != done:
                raise BadInput(f"{path}: line {number}: expected steps that are done in order")
            done += 1
        events.append(event)
    return events, len(whole) + bool(whole)
