"""`live`: the person at the desk, as an operator behind the interface of the simulated ones."""

import dataclasses
from collections.abc import Callable

from pgf_jax.batching.requests import Coroutine, External
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.planner import BatchPlanner, Search
from pgf_jax.planning.types import NoInput, Push
from pgf_jax.simulation.recorded_operator import LIVE, Recording


@dataclasses.dataclass(frozen=True, eq=False)
class InputRequest:
    """A robot that is being served, and waits for its input.

    Attributes:
      robot, task, request: which service.
      view: what there is to see.
      answer: gives the input: a push, None: go on, or UNANSWERED; to be called once.
    """

    robot: int
    task: int
    request: int
    view: View
    answer: Callable[[Push | NoInput | None], None]

    @property
    def service(self) -> tuple[int, int, int]:
        """Robot, task and request."""
        return self.robot, self.task, self.request


class LiveOperator:
    """Passes services on to a person; satisfies `ServiceTimes` and `Deliberate`.

    Args:
      on_asked: called with each service as it begins.
      recording: what was said before the server was killed; that comes first.
    """

    name = LIVE

    def __init__(
        self, on_asked: Callable[[InputRequest], None], recording: Recording | None
    ) -> None:
        self._on_asked, self._recording = on_asked, recording

    def seconds(self, robot: int, task: int, request: int) -> float | None:
        """See `ServiceTimes.seconds`: nobody knows."""
        return self._recording and self._recording.seconds(robot, task, request)

    def deliberate(
        self, view: View, search: Search, planner: BatchPlanner, at: DecisionKey
    ) -> Coroutine:
        """See `Deliberate.deliberate`: what the person says, whenever they say it."""
        _, robot, task, _ = at
        if self.seconds(robot, task, view.request) is not None:
            assert self._recording is not None
            return (yield from self._recording.deliberate(view, search, planner, at))

        def ask(answer: Callable[[Push | NoInput | None], None]) -> None:
            self._on_asked(InputRequest(robot, task, view.request, view, answer))

        (given,) = yield [External(ask)]
        return given
