"""The input panel: which client operates, and the push picked so far: object, place, confirmation.

The panel knows nothing of pages or threads. It is told what a client did, and returns the feedback
for that client. An action that is refused changes nothing.
"""

import dataclasses

import numpy as np

from pgf_jax.console.live_operator import InputRequest
from pgf_jax.guidance.view import View
from pgf_jax.planning.types import NoInput, Push
from pgf_jax.scene.shelf import FRONT_X

REACH = 1.25  # radii around an object's centre within which a click picks it
CLEARANCE = 1e-3  # m, by which a target may overlap a neighbour: nobody clicks more precisely
STEP = 0.01  # m, by which a key moves the target


@dataclasses.dataclass(frozen=True)
class Feedback:
    """The reply to a client's action.

    Attributes:
      text: one line for the client.
      ok: False: the action was refused.
      answered: the action gave the input of the service.
    """

    text: str
    ok: bool = True
    answered: bool = False


@dataclasses.dataclass(frozen=True)
class Allowed:
    """The actions of a client that would not be refused now: see the methods of `InputPanel`."""

    take: bool = False
    confirm: bool = False
    go_on: bool = False
    undo: bool = False


class InputPanel:
    """The one client that operates, and the push that it has picked for the robot being served.

    Attributes:
      operator: client that operates, None: nobody.
      pending: the request that waits for its input, None: no robot is being served.
      object: picked object, or None.
      target: [2] picked place, m, or None.
      problem: why the target is not allowed, or "".
    """

    def __init__(self) -> None:
        self.operator: int | None = None
        self.pending: InputRequest | None = None
        self.object: int | None = None
        self.target: tuple[float, float] | None = None
        self.problem = ""

    # -- who operates ---------------------------------------------------------------------------

    def take(self, client: int) -> Feedback:
        """Make a client the operator, unless another client operates."""
        if self.operator == client:
            return Feedback("You operate already.")
        if self.operator is not None:
            return Feedback("Somebody else operates; you can watch.", ok=False)
        self.operator = client
        return Feedback("You operate.")

    def leave(self, client: int) -> bool:
        """Remove a client; returns whether it operated. What it had picked is kept."""
        if self.operator != client:
            return False
        self.operator = None
        return True

    def allowed(self, client: int, *, attended: bool = True) -> Allowed:
        """What a client could do now.

        The operator need not `take` again, unless robots take it to be away: `attended` is False.
        """
        if self._refusal(client) is not None:
            away = self.operator == client and not attended
            return Allowed(take=self.operator is None or away)
        return Allowed(
            confirm=self.target is not None and not self.problem,
            go_on=True,
            undo=self.object is not None,
        )

    # -- services -------------------------------------------------------------------------------

    def open(self, request: InputRequest) -> None:
        """Begin the service of a request; nothing is picked yet."""
        self.pending = request
        self._clear()

    def close(self) -> None:
        """End the service without an input."""
        self.pending = None
        self._clear()

    def answer(self, given: Push | NoInput | None) -> None:
        """End the service with an input: a push, None (go on reaching) or UNANSWERED."""
        assert self.pending is not None
        request = self.pending
        self.close()
        request.answer(given)

    # -- what the operator does -----------------------------------------------------------------

    def click(self, client: int, robot: int | None, x: float, y: float) -> Feedback:
        """Handle a click at (x, y), m, on a robot's shelf; `robot` None: beside all shelves.

        The first click picks an object, the next one its target, and each further one another
        target.
        """
        refusal = self._refusal(client)
        if refusal is not None:
            return refusal
        assert self.pending is not None
        if robot is None:
            return Feedback("That is no shelf.", ok=False)
        if robot != self.pending.robot:
            return Feedback(f"Robot {self.pending.robot} asks, not robot {robot}.", ok=False)
        if not (np.isfinite(x) and np.isfinite(y)):
            return Feedback("That is no place.", ok=False)
        if self.object is None:
            return self._pick(_object_at(self.pending.view, x, y))
        problem = target_problem(self.pending.view, self.object, x, y)
        if problem:
            return Feedback(problem, ok=False)
        self.target, self.problem = (float(x), float(y)), ""
        return Feedback(f"Object {self.object + 1} to here? Push (Enter), or click another place.")

    def next_object(self, client: int) -> Feedback:
        """Pick the next object by keyboard, in the order of distance from the hand."""
        refusal = self._refusal(client)
        if refusal is not None:
            return refusal
        assert self.pending is not None
        order = _from_the_hand(self.pending.view)
        place = -1 if self.object is None else order.index(self.object)
        return self._pick(order[(place + 1) % len(order)])

    def nudge(self, client: int, deeper: int, left: int) -> Feedback:
        """Move the target by keyboard, in steps of `STEP`; it starts at the object."""
        refusal = self._refusal(client)
        if refusal is not None:
            return refusal
        assert self.pending is not None
        if self.object is None:
            return Feedback("Pick an object first (Tab, or click it).", ok=False)
        x, y = self.target or self.pending.view.objects[self.object]
        x, y = float(x) + STEP * deeper, float(y) + STEP * left
        outside = _outside(self.pending.view, self.object, x, y)
        if outside:
            return Feedback(outside, ok=False)
        # On its way the target may cross places that are not allowed at the end.
        self.target, self.problem = (x, y), target_problem(self.pending.view, self.object, x, y)
        words = self.problem or "To there? Push (Enter), or move it on."
        return Feedback(words, ok=not self.problem)

    def undo(self, client: int) -> Feedback:
        """Take back the target, or else the object."""
        refusal = self._refusal(client)
        if refusal is not None:
            return refusal
        if self.target is not None:
            self.target, self.problem = None, ""
            return Feedback("Place taken back: click where the object should come to.")
        if self.object is not None:
            self._clear()
            return Feedback("Object taken back: click an object.")
        return Feedback("There is nothing to undo.", ok=False)

    def confirm(self, client: int) -> Feedback:
        """Give the picked push as the input."""
        refusal = self._refusal(client)
        if refusal is not None:
            return refusal
        if self.object is None or self.target is None:
            missing = "an object" if self.object is None else "a place for the object"
            return Feedback(f"Pick {missing} first.", ok=False)
        if self.problem:
            return Feedback(self.problem, ok=False)
        push = Push(self.object, *self.target)
        self.answer(push)
        return Feedback(f"Object {push.object + 1} to {_place(push.x, push.y)}.", answered=True)

    def go_on(self, client: int) -> Feedback:
        """Give "go on reaching" as the input."""
        refusal = self._refusal(client)
        if refusal is not None:
            return refusal
        self.answer(None)
        return Feedback("Go on reaching.", answered=True)

    # -- helpers --------------------------------------------------------------------------------

    def _refusal(self, client: int) -> Feedback | None:
        if client != self.operator:
            other = "Somebody else operates" if self.operator is not None else "Nobody operates"
            return Feedback(f"{other}; you watch.", ok=False)
        if self.pending is None:
            return Feedback("No robot is being served.", ok=False)
        return None

    def _pick(self, found: int | None) -> Feedback:
        if found is None:
            return Feedback("There is no object there: click an object first.", ok=False)
        self.object, self.target, self.problem = found, None, ""
        return Feedback(f"Object {found + 1}: now click where it should come to.")

    def _clear(self) -> None:
        self.object, self.target, self.problem = None, None, ""


def target_problem(view: View, pushed: int, x: float, y: float) -> str:
    """Why an object must not be pushed to (x, y), m; empty if it may."""
    outside = _outside(view, pushed, x, y)
    if outside:
        return outside
    distance = np.hypot(view.objects[:, 0] - x, view.objects[:, 1] - y)  # [N]
    distance[pushed] = np.inf
    nearest = int(np.argmin(distance))
    if distance[nearest] < view.radii[pushed] + view.radii[nearest] - CLEARANCE:
        return f"Object {nearest + 1} stands there."
    return ""


def _outside(view: View, pushed: int, x: float, y: float) -> str:
    back, side, radius = view.back_x, view.side_y, view.radii[pushed]
    if x < FRONT_X or x > back or abs(y) > side:
        return "That is outside the shelf."
    if x > back - radius + CLEARANCE or abs(y) > side - radius + CLEARANCE:
        return "The object would stand in the wall there."
    return ""


def _place(x: float, y: float) -> str:
    """A place on the shelf in words, as the robot sees it."""
    side = "left" if y >= 0 else "right"
    return f"{x - FRONT_X:.2f} m deep on the shelf, {abs(y):.2f} m {side} of the middle"


def _object_at(view: View, x: float, y: float) -> int | None:
    distance = np.hypot(view.objects[:, 0] - x, view.objects[:, 1] - y)  # [N]
    nearest = int(np.argmin(distance))
    return nearest if distance[nearest] <= REACH * view.radii[nearest] else None


def _from_the_hand(view: View) -> list[int]:
    """Objects in the order of distance from the hand; the goal last, as it is seldom in the way."""
    distance = np.hypot(*(view.objects - view.hand[:2]).T)
    distance[view.goal] = np.inf
    return [int(i) for i in np.argsort(distance, kind="stable")]
