"""The legend of the page: the task in a sentence, and what the colours mean, as HTML."""

from collections.abc import Iterable

from pgf_jax.console.fleet_view import CHOSEN, DRAG, GOAL, INPUT, OBJECT, PATH, PUSHED, STATES

TASK = (
    "Each robot must grasp its green object. When a robot asks, push one object out of its way, or "
    "let it go on reaching."
)
_DISK = "width:12px;height:12px;border-radius:50%;background:{};border:1px solid #444"
_RING = "width:13px;height:13px;border-radius:50%;border:2px solid {}"
_LINE = "width:16px;height:3px;background:{}"
_BORDER = "width:14px;height:12px;border-radius:2px;border:3px solid {}"
_PARTS = {
    "Objects": (
        (_DISK, GOAL, "object to grasp"),
        (_DISK, OBJECT, "other objects"),
        (_DISK, PUSHED, "object being pushed"),
        (_DISK, CHOSEN, "object you picked"),
    ),
    "Plan and cost": (
        (_LINE, PATH, "best trajectory of the robot so far"),
        (_RING, DRAG, "where it would take the objects"),
        (_LINE, INPUT, "in the cost curve: when it was helped"),
    ),
    # Some states share a colour and a name.
    "Border of a robot's cell": [(_BORDER, *state) for state in dict.fromkeys(STATES.values())],
}


def html(*, live: bool) -> str:
    """The legend; `live`: a person gives the inputs."""
    task = TASK if live else TASK.split(". ")[0] + "."
    parts = "".join(map(_part, _PARTS, _PARTS.values()))
    return f'<div style="padding:0 0.75em 0.75em;font-size:0.85em"><p>{task}</p>{parts}</div>'


def _part(name: str, entries: Iterable[tuple[str, tuple[int, int, int], str]]) -> str:
    """A heading, and swatches with their meanings: `entries` are style, colour and text."""
    rows = "".join(
        '<span style="display:inline-flex;align-items:center;gap:6px;margin-right:12px">'
        f'<span style="box-sizing:border-box;{style.format(f"rgb{color}")}"></span>{text}</span>'
        for style, color, text in entries
    )
    return f'<div style="margin-top:0.4em"><em>{name}</em><br>{rows}</div>'
