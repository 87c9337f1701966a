"""The page in the browser: shows the fleet and the input panel, and handles what clients do.

Only this module and `drawing.py` use viser.
"""

import contextlib
import dataclasses
import enum
import io
import logging
import math
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from pgf_jax.console import layout, legend
from pgf_jax.console.access_control import AccessControl, Bucket
from pgf_jax.console.drawing import Drawing
from pgf_jax.console.input_panel import Allowed, Feedback, InputPanel
from pgf_jax.console.layout import Layout
from pgf_jax.console.session import Frame, Session
from pgf_jax.errors import BadInput
from pgf_jax.terminal import clock

log = logging.getLogger(__name__)

MARGIN = 1.02  # size of the visible plane over that of the drawing
FOV = 0.35  # rad; narrow, so that the drawing has little perspective
LABEL = "Robots on shelves"  # title of the page; no name of the program, which tells a policy
ACTIONS_PER_S, ACTIONS_AT_ONCE = 10.0, 20.0  # of a client; no person is so fast
HELP = """\
**Mouse**: click an object, then the place it should come to, then *Push*.

**Keyboard**: Tab next object, I J K L move its place, Enter push, Escape undo, G go on reaching,
O operate, V view from the front.
"""


# Buttons with a key: label, colour, key, field of `Allowed`, action.
_ACTS: tuple[tuple[str, Any, Any, str, Callable[[InputPanel, int], Feedback]], ...] = (
    ("Push", "green", "enter", "confirm", InputPanel.confirm),
    ("Go on reaching", "blue", "G", "go_on", InputPanel.go_on),
    ("Undo", "gray", "escape", "undo", InputPanel.undo),
)


class Order(enum.IntEnum):
    """Order of the parts of the side panel, from the top."""

    STATUS = 1
    ROLE = 2
    FEEDBACK = 3
    BUTTONS = 4
    LEGEND = 5
    HELP = 6


@dataclasses.dataclass(frozen=True, eq=False)
class _Controls:
    """What a client has for itself in the side panel.

    Attributes:
      role: says whether the client operates.
      feedback: to its last action, while it operates.
      buttons: by the field of `Allowed` that enables them.
    """

    role: viser.GuiMarkdownHandle
    feedback: viser.GuiMarkdownHandle
    buttons: dict[str, viser.GuiButtonHandle]

    def show(self, role: str, allowed: Allowed) -> None:
        """Show the role, and enable the buttons that can act."""
        _assign(self.role, "content", role)
        for name, button in self.buttons.items():
            _assign(button, "disabled", not getattr(allowed, name))


class Page:
    """The page of a session: a server for browsers.

    It never tells the policy's name: an operator who knew it might act by it.

    Args:
      host, port: to listen on.
      access: decides which clients may connect.
      robots, n_objects: R and N.
      live: whether a person gives the inputs.

    Raises:
      BadInput: the port is not free.
    """

    def __init__(
        self,
        host: str,
        port: int,
        access: AccessControl,
        *,
        robots: int,
        n_objects: int,
        live: bool,
    ) -> None:
        with access.guard(), _quiet():
            self.server = viser.ViserServer(host=host, port=port, label=LABEL, verbose=False)
        if port not in (0, self.server.get_port()):
            self.server.stop()
            raise BadInput(f"port: {port} is taken; expected a free one, or 0 for any")
        self._robots, self._live = robots, live
        self._session: Session | None = None
        self._layout = Layout.of(robots, None)
        self._controls: dict[int, _Controls] = {}  # of each client
        self._buckets: dict[int, Bucket] = {}
        self._flooding: set[int] = set()
        self._lock = threading.Lock()
        server = self.server
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        self._drawing = Drawing(server.scene, robots, n_objects)
        for name, value in (
            ("position", _eye(1.2)),
            ("look_at", (layout.WIDTH / 2, layout.HEIGHT / 2, 0.0)),
            ("up", (0.0, 1.0, 0.0)),
            ("fov", FOV),
        ):
            setattr(server.initial_camera, name, value)
        self._status = server.gui.add_markdown("Starting ...", order=Order.STATUS)
        server.gui.add_html(legend.html(live=live), order=Order.LEGEND)
        server.gui.add_markdown(HELP if live else "V: view from the front.", order=Order.HELP)
        self._add_commands()
        # viser takes coroutines here too, but its types do not say so.
        server.scene.on_click()(self._on_click)  # pyright: ignore[reportArgumentType]
        server.on_client_connect(self._on_connect)
        server.on_client_disconnect(self._on_disconnect)

    @property
    def url(self) -> str:
        """Address of the page, without the token."""
        host = self.server.get_host()
        shown = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, host)
        return f"http://{shown}:{self.server.get_port()}/"

    def open(self, session: Session) -> None:
        """Connect the page to a session, and offer each client to operate."""
        self._session = session
        for client in self.server.get_clients():
            self._take(client)

    def close(self) -> None:
        """Stop the server."""
        with _quiet():
            self.server.stop()

    # -- showing --------------------------------------------------------------------------------

    def show(self, frame: Frame) -> None:
        """Show a frame to all clients."""
        served = frame.fleet.serving if frame.picked is None else frame.picked.robot
        layout_now = Layout.of(self._robots, served)
        with self.server.atomic():
            self._drawing.show(frame, layout_now)
            _assign(self._status, "content", self._status_of(frame))
            self._show_controls(over=frame.over, attended=frame.fleet.attended)
        self._layout = layout_now
        self.server.flush()

    def _show_controls(self, *, over: bool, attended: bool) -> None:
        session = self._session
        if session is None or not self._live:
            return
        operator = session.panel.operator
        for client, controls in list(self._controls.items()):
            if client == operator:
                role = "You operate."
            elif operator is None:
                role = "You watch, and nobody operates: *Operate* to do so."
            else:
                role = "You watch, somebody else operates."
            allowed = session.panel.allowed(client, attended=attended)
            controls.show(role, Allowed() if over else allowed)

    def _status_of(self, frame: Frame) -> str:
        fleet = frame.fleet
        waiting = ""
        if frame.over:
            head = "The session is over. Thank you."
        elif frame.picked is not None:
            head = f"Robot {frame.picked.robot} asks"
            waiting = f"waiting {int(fleet.robots[frame.picked.robot].waited_s)} s · "
        elif fleet.serving is not None:
            head = f"Robot {fleet.serving} is being helped"
        elif self._live and not frame.running:
            head = "Waiting for an operator"
        elif self._live and not fleet.attended:
            head = "The operator is away"
        else:
            head = "Robots ask: one is chosen" if fleet.window_open else "No robot asks"
        behind = f" ({frame.behind_s:.0f} s behind)" if frame.behind_s >= 1 else ""
        time = clock(fleet.time_ns // 1_000_000_000)
        return f"### {head}\n{waiting}time {time}{behind} · {fleet.progress}"

    # -- what clients do ------------------------------------------------------------------------

    def _add_commands(self) -> None:
        """Add the commands of the keyboard: what is not allowed is refused with a word."""
        gui = self.server.gui
        if self._live:
            for label, _, key, _, do in _ACTS:
                gui.add_command(label, hotkey=key).on_trigger(self._handler(do))
            moves: tuple[tuple[Any, str, int, int], ...] = (
                # The arrows, and W A S D Q E, move viser's camera.
                ("I", "Place deeper", 1, 0),
                ("K", "Place nearer", -1, 0),
                ("J", "Place to the left", 0, 1),
                ("L", "Place to the right", 0, -1),
            )
            for key, label, deeper, left in moves:
                gui.add_command(label, hotkey=key).on_trigger(
                    self._handler(lambda panel, c, d=deeper, s=left: panel.nudge(c, d, s))
                )
            gui.add_command("Next object", hotkey="tab").on_trigger(
                self._handler(lambda panel, client: panel.next_object(client))
            )
            gui.add_command("Operate", hotkey="O").on_trigger(self._on_take)
        gui.add_command("View from the front", hotkey="V").on_trigger(self._on_view)

    def _new_controls(self, client: viser.ClientHandle) -> "_Controls":
        """Add the controls of a client; the buttons are disabled until a frame is shown."""
        role = client.gui.add_markdown("", order=Order.ROLE)
        feedback = client.gui.add_markdown("", order=Order.FEEDBACK)
        buttons = {}
        for label, color, _, name, do in _ACTS:
            buttons[name] = client.gui.add_button(
                label, color=color, disabled=True, order=Order.BUTTONS
            )
            buttons[name].on_click(self._handler(do))
        buttons["take"] = client.gui.add_button(
            "Operate", color="gray", disabled=True, order=Order.BUTTONS
        )
        buttons["take"].on_click(self._on_take)
        return _Controls(role, feedback, buttons)

    def _handler(self, do: Callable[[InputPanel, int], Feedback]) -> Callable[[Any], Any]:
        async def handle(event: Any) -> None:
            self._act(event.client_id, lambda panel: do(panel, event.client_id))

        return handle

    async def _on_click(self, event: viser.SceneClickEvent) -> None:
        if not self._live:
            return
        place = _on_drawing(event.ray_origin, event.ray_direction)
        client = event.client_id
        robot, x, y = (None, 0.0, 0.0) if place is None else self._layout.find(*place)
        self._act(client, lambda panel: panel.click(client, robot, x, y))

    def _act(self, client: int | None, do: Callable[[InputPanel], Feedback]) -> None:
        session = self._session
        if client is None or session is None or not self._may(client):
            return
        session.act(client, do, lambda feedback: self._tell(client, feedback))

    async def _on_take(self, event: Any) -> None:
        if event.client_id is not None and self._may(event.client_id):
            self._take(event.client_id)

    def _take(self, client: int) -> None:
        """Make a client the operator, if nobody operates; its role says so."""
        if self._live and self._session is not None:
            self._session.take(
                client, lambda feedback: None if feedback.ok else self._tell(client, feedback)
            )

    async def _on_view(self, event: Any) -> None:
        client = self.server.get_clients().get(event.client_id)
        if client is not None:
            _look(client)

    def _may(self, client: int) -> bool:
        """Count an action of a client; False if the client acts faster than a person can."""
        with self._lock:
            bucket = self._buckets.setdefault(client, Bucket(ACTIONS_PER_S, ACTIONS_AT_ONCE))
            allowed = bucket.allows()
            if not allowed and client not in self._flooding:
                self._flooding.add(client)
                log.warning("client %d acts too fast: refused", client)
            elif allowed:
                self._flooding.discard(client)
            return allowed

    def _tell(self, client: int, feedback: Feedback) -> None:
        """Show a client the feedback to its action; called in the session's thread."""
        session = self._session
        operates = session is not None and session.panel.operator == client
        if not feedback.ok:
            log.info("client %d refused: %s", client, feedback.text)
        handle, controls = self.server.get_clients().get(client), self._controls.get(client)
        if handle is None or controls is None:
            return
        text = feedback.text
        if operates:
            text = f"**{text}**" if feedback.ok else f"**Refused.** {text}"
            _assign(controls.feedback, "content", text)
        else:
            handle.add_notification("", text, auto_close_seconds=4.0)
        handle.flush()

    # -- clients that come and go ---------------------------------------------------------------

    async def _on_connect(self, client: viser.ClientHandle) -> None:
        log.info("client %d connected", client.client_id)
        _look(client)
        if self._live:
            self._controls[client.client_id] = self._new_controls(client)
        self._take(client.client_id)

    async def _on_disconnect(self, client: viser.ClientHandle) -> None:
        log.info("client %d left", client.client_id)
        with self._lock:
            self._controls.pop(client.client_id, None)
            self._buckets.pop(client.client_id, None)
            self._flooding.discard(client.client_id)
        if self._session is not None:
            self._session.leave(client.client_id)


def _assign(handle: Any, attribute: str, value: Any) -> None:
    """Set an attribute of a handle, which sends it, if it differs."""
    if getattr(handle, attribute) != value:
        setattr(handle, attribute, value)


def _quiet() -> contextlib.AbstractContextManager:
    """Suppress the address that viser prints, which lacks the token."""
    return contextlib.redirect_stdout(io.StringIO())


def _look(client: viser.ClientHandle) -> None:
    """Move the camera of a client so that the whole drawing is visible."""
    client.camera.position = _eye(client.camera.aspect)
    client.camera.look_at = (layout.WIDTH / 2, layout.HEIGHT / 2, 0.0)


def _eye(aspect: float) -> tuple[float, float, float]:
    """Position of the camera from which the drawing fills a canvas; `aspect`: width over height."""
    high = max(layout.HEIGHT, layout.WIDTH / max(aspect, 0.1)) * MARGIN
    return layout.WIDTH / 2, layout.HEIGHT / 2, high / 2 / math.tan(FOV / 2)


def _on_drawing(origin: Any, direction: Any) -> tuple[float, float] | None:
    """Place where a ray meets the plane of the drawing, units; None: nowhere."""
    origin, direction = np.asarray(origin, float), np.asarray(direction, float)
    if not (np.isfinite(origin).all() and np.isfinite(direction).all()) or direction[2] == 0:
        return None
    along = -origin[2] / direction[2]
    if along <= 0:
        return None
    x, y = (origin + along * direction)[:2]
    return float(x), float(y)
