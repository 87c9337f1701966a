"""Settings of `pgf-jax console`; no JAX here, the command line builds on it."""

import dataclasses
import ipaddress
from pathlib import Path
from typing import Any, Literal

from pgf_jax.errors import BadInput
from pgf_jax.guidance.operators.registry import operator_names
from pgf_jax.settings import check_choice, check_fields, check_int, check_seconds
from pgf_jax.sweeping.config import SweepConfig

LOOPBACK = "127.0.0.1"
# Of a session itself; all else is what a sweep calls by the same name.
_OWN = ("robots", "policy", "speed", "patience", "host", "port")


@dataclasses.dataclass(frozen=True)
class ConsoleConfig:
    """Guide a fleet from a browser: it runs in real time, and asks the person at the desk.

    The clock starts when an operator has come. Everything is recorded as it happens: the log
    replays bit for bit (`sweep --operator replay --log OUT`), and a server that was killed goes on
    from it with --resume.

    Attributes:
      robots: fleet size.
      policy: when robots ask, and who is served: see `sweep`.
      tasks: of each robot.
      speed: simulated seconds a second.
      patience: simulated time after which a robot that gets no answer goes on alone, s.
      host: address to listen on; another than 127.0.0.1 needs the token that is printed.
      port: to listen on; 0: any free one.
      seed: of scenes, planning noise, service times and ties.
      operator: live: who sits at the page; or a simulated one, or replay, to watch.
      log: of replay: the session's folder, or its event log.
      service_mean: of simulated operators: mean of the log-normal service time, s.
      service_sd: of simulated operators: its standard deviation, s.
      window: T_window of Alg. 2, s.
      rollout_time: simulated time of one rollout, s; an iteration takes two.
      compute: dedicated (every robot has a computer), or shared:C (all share one of C cores).
      horizon: simulated time at which the session ends, s; None: when its tasks are done.
      predictor: what pgf bids by: paper or best, as shipped; or a folder of checkpoints, or
        best:FOLDER.
      scene_class: of the sampled scenes; all: the three in turn; None: tight.
      scenes: folder of scene files (*.xml) to draw the tasks from instead.
      engine: physics engine: planar, mjx, native, or a registered one.
      physics: default, or the paper's substep and the authors' softness.
      cost: cost variant: the authors' source, or the paper's text.
      update: greedy or stomp.
      random_winner: as in `sweep`.
      lanes: L, robots computed in one call; None: a constant of the engine.
      out: folder of the session: events.jsonl as it goes, tables at its end.
      resume: go on with the session in the folder.
    """

    robots: int = 6
    policy: str = "pgf"
    tasks: int = 10
    speed: float = 1.0
    patience: float = 60.0
    host: str = LOOPBACK
    port: int = 8080
    seed: int = 0
    operator: str = "live"
    log: Path | None = None
    service_mean: float = 8.0
    service_sd: float = 4.0
    window: float = 2.0
    rollout_time: float = 1.5
    compute: str = "dedicated"
    horizon: float | None = None
    predictor: str = "paper"
    scene_class: Literal["tight", "medium", "wide", "all"] | None = None
    scenes: Path | None = None
    engine: str = "planar"
    physics: Literal["default", "paper"] = "default"
    cost: Literal["source", "paper"] = "source"
    update: Literal["greedy", "stomp"] = "greedy"
    random_winner: float = 0.0
    lanes: int | None = None
    out: Path = Path("results/session")
    resume: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        check_int("robots", self.robots, 1, 100)
        for name, least in (("speed", 1e-3), ("patience", 1e-3)):
            check_seconds(name, getattr(self, name), least)
        check_int("port", self.port, 0, 65535)
        try:
            ipaddress.ip_address(self.host)
        except ValueError:
            raise BadInput(
                f"host: expected an address such as {LOOPBACK} or 0.0.0.0, got {self.host!r}"
            ) from None
        check_choice("operator", self.operator, ["live", "replay", *operator_names()])
        if self.policy == "oracle-gain" and self.operator in ("live", "replay"):
            raise BadInput(
                "policy: oracle-gain asks the operator at every iteration what they would say; "
                f"expected another one with operator {self.operator}"
            )
        if self.resume and self.operator != "live":
            raise BadInput(f"resume: only live sessions are resumed, got {self.operator!r}")
        self.sweep()

    def sweep(self) -> SweepConfig:
        """The sweep of one cell that this is, but for its clock and its operator."""
        settings: dict[str, Any] = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in _OWN
        }
        return SweepConfig(robots=(self.robots,), policies=(self.policy,), **settings)

    @property
    def needs_token(self) -> bool:
        """Whether others than this computer can connect."""
        return not ipaddress.ip_address(self.host).is_loopback
