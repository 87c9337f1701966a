"""Settings of `collect`; no JAX here, the command line builds on it."""

import dataclasses
from pathlib import Path
from typing import Literal

import tyro

from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators.registry import check_operator
from pgf_jax.planning.config import check_planning
from pgf_jax.settings import MAX_SEED, check_fields, check_int, check_seconds
from pgf_jax.sweeping.config import LANES, OTHER_LANES

CLASSES = ("tight", "medium", "wide")
_BESIDE_LOG = ("mode", "out", "log", "resume")


@dataclasses.dataclass(frozen=True)
class CollectConfig:
    """Plan sampled scenes and keep every iteration, for `train`; or take recorded sessions.

    Attributes:
      mode: autonomous: nobody helps; human: input is given once in each run that lasts so long;
        forks: one state of each such run is carried on with input and without, for the true gain.
      out: folder of the data; gets autonomous/runs.parquet, human/runs.parquet or
        forks/forks.parquet.
      scenes: how many; scene i has seed + i for its own seed (of layout and noise).
      log: human: sessions of the console to take the runs from, instead of planning scenes: their
        folders, or event logs. Each fixes its own settings, so that no others are given.
      classes: scene classes, taken in turn: the mix is even.
      seed: of the first scene.
      engine: physics engine: planar, mjx, native, or a registered one.
      physics: default, or the paper's substep and the authors' softness.
      cost: cost variant: the authors' source, or the paper's text.
      update: greedy or stomp.
      operator: who gives the input of human runs and forks.
      lanes: L, scenes computed in one call; None: a constant of the engine, as in a sweep.
      task_limit: simulated time of a run, s. The default ends an unsolved run after reach iteration
        39, or in human runs at least 10 reach iterations (the predictors' look-ahead) after the
        input, however long its push took to plan.
      ask_from: human: input comes after a reach iteration drawn evenly from ask_from..ask_to; the
        third is the first with a full history. forks: of the unsolved ones among these.
      ask_to: see ask_from.
      keys: forks: futures of a state under other noise, each with input and without.
      workers: processes that share the scenes, each on cores of its own; None: one a core for
        planar, else 1. What is collected does not depend on them.
      chunk: finished runs are written this many at a time: what an interruption can lose.
      resume: continue what was interrupted, or add scenes to what is there; nothing is added to
        the runs of sessions.
    """

    mode: tyro.conf.Positional[Literal["autonomous", "human", "forks"]]
    out: Path
    scenes: int | None = None
    log: tuple[Path, ...] = ()
    classes: tuple[Literal["tight", "medium", "wide"], ...] = CLASSES
    seed: int = 0
    engine: str = "planar"
    physics: Literal["default", "paper"] = "default"
    cost: Literal["source", "paper"] = "source"
    update: Literal["greedy", "stomp"] = "greedy"
    operator: str = "heuristic"
    lanes: int | None = None
    task_limit: float = 120.0
    ask_from: int = 3
    ask_to: int = 12
    keys: int = 8
    workers: int | None = None
    chunk: int = 20
    resume: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if self.log:
            self._check_log()
            return
        if self.scenes is None:
            raise BadInput("scenes: expected how many (or log, with recorded sessions), got none")
        check_int("scenes", self.scenes, 1)
        check_int("seed", self.seed, 0, MAX_SEED - self.scenes + 1)
        for name in ("chunk", "keys", "workers"):
            if name != "workers" or self.workers is not None:
                check_int(name, getattr(self, name), 1)
        if self.lanes is None:
            object.__setattr__(self, "lanes", LANES.get(self.engine, OTHER_LANES))
        check_planning(self)
        if self.mode != "autonomous":
            check_operator(self.operator)
            if self.operator == "none":
                raise BadInput(f"operator: {self.mode} runs need one that gives input, got 'none'")
        if not self.classes:
            raise BadInput(f"classes: expected one or more of {', '.join(CLASSES)}, got none")
        if len(set(self.classes)) != len(self.classes):
            raise BadInput(f"classes: expected each at most once, got {' '.join(self.classes)}")
        check_seconds("task_limit", self.task_limit, 1.5)  # the nominal's own rollout
        # Forks are described by a full history.
        check_int("ask_from", self.ask_from, 3 if self.mode == "forks" else 0)
        check_int("ask_to", self.ask_to, self.ask_from)

    def _check_log(self) -> None:
        if self.mode != "human":
            raise BadInput(f"log: expected with mode human only, got {self.mode}")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name not in _BESIDE_LOG and value != field.default:
                raise BadInput(
                    f"{field.name}: expected none beside log (sessions have their own settings), "
                    f"got {value!r}"
                )
