"""The pool of operators: who is present, and which robot each of them serves."""


class OperatorPool:
    """Who is there, and busy with which robot."""

    def __init__(self, count: int) -> None:
        self._serving: list[int | None] = [None] * count  # [operators] robot, or None: nobody
        self._last: list[int | None] = [None] * count  # [operators] robot served before
        self._away = [False] * count

    @property
    def free(self) -> int:
        """How many operators are there and serve nobody."""
        return len(self._idle())

    def serving(self, operator: int) -> int | None:
        """The robot that an operator serves, or None."""
        return self._serving[operator]

    def is_there(self, operator: int) -> bool:
        """Whether an operator takes robots on."""
        return not self._away[operator]

    def attend(self, operator: int, present: bool) -> None:
        """An operator comes or leaves; a service under way goes on all the same."""
        self._away[operator] = not present

    def _idle(self) -> list[int]:
        pairs = enumerate(zip(self._serving, self._away, strict=True))
        return [i for i, (robot, away) in pairs if robot is None and not away]

    def acquire(self, robot: int) -> tuple[int, bool]:
        """The free operator of lowest index turns to `robot`: (operator, switched).

        A switch is a turn to another robot than the one served before; an operator's first service
        is none, because there is nothing to turn away from.
        """
        operator = self._idle()[0]
        switched = self._last[operator] not in (None, robot)
        self._serving[operator] = self._last[operator] = robot
        return operator, switched

    def release(self, robot: int) -> int:
        """The operator who served `robot` is free again; returns which one."""
        operator = self._serving.index(robot)
        self._serving[operator] = None
        return operator
