"""The operator `live`: passes the requests of robots on to a person at the console."""

import dataclasses
from collections.abc import Callable

from pgf_jax.batching.requests import Coroutine, External
from pgf_jax.guidance.view import DecisionKey, View
from pgf_jax.planning.planner import BatchPlanner
from pgf_jax.planning.search import Search
from pgf_jax.planning.types import NoInput, Push
from pgf_jax.simulation.recorded_operator import LIVE, Recording


@dataclasses.dataclass(frozen=True, eq=False)
class InputRequest:
    """The request of a robot that is being served and waits for its input.

    Attributes:
      robot, task, request: identify the service.
      view: of the robot.
      answer: gives the input: a push, None (go on reaching) or UNANSWERED; must be called once.
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
    """Passes requests on to a person; satisfies `ServiceTimes` and `RolloutOperator`.

    Args:
      on_request: called with each request when its service begins.
      recording: inputs of a resumed session, which are given first; None: a new session.
    """

    name = LIVE
    checked = True  # by the input panel

    def __init__(
        self, on_request: Callable[[InputRequest], None], recording: Recording | None
    ) -> None:
        self._on_request, self._recording = on_request, recording

    def seconds(self, robot: int, task: int, request: int) -> float | None:
        """See `ServiceTimes.seconds`: None, except in a recording."""
        return self._recording and self._recording.seconds(robot, task, request)

    def deliberate(
        self, view: View, search: Search, planner: BatchPlanner, decision_key: DecisionKey
    ) -> Coroutine:
        """See `RolloutOperator.deliberate`: wait for the person's input."""
        _, robot, task, _ = decision_key
        if self.seconds(robot, task, view.request) is not None:
            assert self._recording is not None
            return (yield from self._recording.deliberate(view, search, planner, decision_key))

        def ask(answer: Callable[[Push | NoInput | None], None]) -> None:
            self._on_request(InputRequest(robot, task, view.request, view, answer))

        (given,) = yield [External(ask)]
        return given
