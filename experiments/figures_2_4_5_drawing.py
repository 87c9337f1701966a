"""Draws figures 2, 4 and 5 from their data files, and stores scenes in such files.

Part of `figures_2_4_5.py`. The outline of the hand is that of `pgf_jax.physics.hand` at the stored
poses.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.transforms import Bbox

from pgf_jax.physics.hand import RADII, capsule_segments
from pgf_jax.scene import BACK_WALL_X, RADIUS, Scene, draw_scene
from pgf_jax.scene.draw import ROBOT_COLOR

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Data = Mapping[str, Any]  # content of a data file, or a part of it
PUSH_COLOR = "#b3261e"
GRID_M = 0.0015  # m, step of the grid for the outline of the hand


# -- stored scenes -------------------------------------------------------------------------------


def rounded(values: Any, digits: int = 5) -> Any:
    """Round numbers for a data file; + 0.0 turns -0.0 into 0.0."""
    return (np.round(np.asarray(values, np.float64), digits) + 0.0).tolist()


def scene_content(scene: Scene) -> dict[str, Any]:
    """A scene as JSON: x, y of the objects in metres, rounded to 10 um."""
    return {"name": scene.name, "goal": scene.goal, "objects": rounded(scene.positions)}


def scene_of(content: Data) -> Scene:
    """The scene that `scene_content` stored."""
    objects = [(x, y, RADIUS) for x, y in content["objects"]]
    return Scene(content["name"], np.array(objects), content["goal"])


# -- parts ---------------------------------------------------------------------------------------


def draw_hand(ax: "Axes", pose: Any, gripper: float, *, strength: float, fill: bool) -> None:
    """Draw the outline of the hand from above.

    Args:
      ax: of `draw_scene`: horizontal is y, vertical is x.
      pose: [3] x, y (m), yaw (rad).
      gripper: 0 open .. 255 closed.
      strength: opacity of the line, 0..1.
      fill: whether to shade the inside.
    """
    x, y, yaw = pose
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    ends = capsule_segments(gripper) @ turn.T + np.array([x, y])  # [C, 2, 2]
    low, high = ends.min((0, 1)) - 0.06, ends.max((0, 1)) + 0.06
    grid_x, grid_y = (np.arange(low[i], high[i], GRID_M) for i in (0, 1))
    points = np.stack(np.meshgrid(grid_x, grid_y, indexing="ij"), axis=-1)  # [X, Y, 2]
    outside = np.full(points.shape[:2], np.inf)  # m to the nearest capsule, negative inside
    for (a, b), radius in zip(ends, RADII, strict=True):
        along = (points - a) @ (b - a) / max((b - a) @ (b - a), 1e-12)
        nearest = a + np.clip(along, 0, 1)[..., None] * (b - a)
        distance = np.linalg.norm(points - nearest, axis=-1) - radius
        outside = np.minimum(outside, distance)
    if fill:
        # Under the objects, so that the shade does not change their colours.
        ax.contourf(
            grid_y, grid_x, outside, levels=[-1, 0], colors=[ROBOT_COLOR], alpha=0.18, zorder=1.5
        )
    ax.contour(
        grid_y,
        grid_x,
        outside,
        levels=[0],
        colors=[ROBOT_COLOR],
        linewidths=1.0,
        alpha=strength,
        zorder=3,
    )


def draw_nominal(ax: "Axes", scene: Scene, content: Data, title: str) -> None:
    """Draw a scene with a nominal: path of `ee`, hand at ends and half-way, final positions."""
    path = np.array(content["ee"])
    draw_scene(
        scene,
        ax,
        ee_paths=path,
        end_positions=np.array(content["ends"]),
        corridor="behind" not in content,  # the corridor leads to the goal, so not for a push
        title=title,
    )
    ax.plot(path[1:, 1], path[1:, 0], ".", color=ROBOT_COLOR, markersize=6, zorder=6)
    last = len(path) - 1
    for k, strength in ((0, 0.35), (last // 2, 0.6), (last, 1.0)):
        pose, gripper = content["hand"][k], content["gripper"][k]
        draw_hand(ax, pose, gripper, strength=strength, fill=k == last)


def draw_target(ax: "Axes", target: Any) -> None:
    """Draw the target of a pushed object: a cross, and the outline of the object."""
    x, y = target
    ax.add_patch(Circle((y, x), RADIUS, fill=False, color=PUSH_COLOR, linewidth=1.2, zorder=5))
    ax.plot(y, x, "x", color=PUSH_COLOR, markersize=8, markeredgewidth=2, zorder=6)


def costs(content: Data) -> str:
    """The cost of a nominal, term by term; c_e and c_s, not in the paper, only if not zero."""
    cost = {name: value for name, value in content["cost"].items() if name != "total"}
    shown = [
        f"${name[0]}_{name[2:]}$ {value:,.2f}"
        for name, value in cost.items()
        if value or name not in ("c_e", "c_s")
    ]
    verdict = "feasible" if content["feasible"] else "not feasible"
    return f"{' + '.join(shown)} = {content['cost']['total']:,.2f}, {verdict}"


def pair(lines: int) -> tuple[Figure, "list[Axes]", "list[Axes]"]:
    """Make a figure of two panels with axes for text below: figure, panels, axes for text."""
    room = 0.24 * lines  # inches
    figure = Figure(figsize=(13, 6.1 + room), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(5.4, room))
    panels = [figure.add_subplot(grid[0, i]) for i in (0, 1)]
    return figure, panels, [figure.add_subplot(grid[1, i]) for i in (0, 1)]


def write(ax: "Axes", text: str) -> None:
    """Write text into empty axes."""
    ax.axis("off")
    ax.text(0.5, 0.5, text, ha="center", va="center", fontsize="large", linespacing=1.4)


def counted(number: int, noun: str) -> str:
    """A number and a noun: `1 iteration`, `2 iterations`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


# -- figures -------------------------------------------------------------------------------------


def figure2(data: Data) -> Figure:
    """Draw the two initial trajectories on one scene: the nominal of a reach and of a push."""
    figure, (reaching, pushing), below = pair(lines=1)
    scene, push = scene_of(data["scene"]), data["push"]
    draw_nominal(reaching, scene, data["reach"], f"reach: straight to object {scene.goal + 1}")
    title = f"push: to behind object {push['object'] + 1}, then towards its target"
    draw_nominal(pushing, scene, push, title)
    draw_target(pushing, push["target"])
    x, y = push["behind"]
    pushing.plot(y, x, "o", color="white", markeredgecolor=PUSH_COLOR, markersize=8, zorder=7)
    pushing.set_ylabel("")
    for ax, content in zip(below, (data["reach"], push), strict=True):
        write(ax, costs(content))
    figure.suptitle(
        f"The two initial trajectories, on scene {data['scene']['name']}\n"
        "blue: the end effector, a dot at the end of each knot, and the hand at the start, half-way"
        " and at the end; green: the goal;\n"
        "dashed: where objects end in the rollout; white dot: behind the object; red: its target",
        fontsize="medium",
    )
    return figure


def figure4(data: Data) -> Figure:
    """Draw an easy scene and a hard one, with their initial costs."""
    figure, panels, below = pair(lines=2)
    for ax, room, name in zip(panels, below, ("easy", "hard"), strict=True):
        one = data[name]
        reach, alone = one["reach"], one["alone"]
        title = f"{name}: initial cost {reach['three_terms']:,.2f} (paper: {data['paper'][name]:g})"
        draw_nominal(ax, scene_of(one["scene"]), reach, title)
        ended = alone["status"].replace("_", " ")
        write(
            room,
            f"{one['scene']['name']}: {costs(reach)}\n"
            f"planned alone: {ended} after {counted(alone['iterations'], 'iteration')}, "
            f"planning time {alone['planning_time_s']:g} s",
        )
        ax.set_ylabel(ax.get_ylabel() if name == "easy" else "")
    of = data["initial_costs"]
    figure.suptitle(
        f"The nominal alone solves {of['feasible']} of the {len(of['costs'])} scenes chosen from; "
        f"the initial costs' quartiles are "
        f"{', '.join(f'{q:,.0f}' for q in np.percentile(of['costs'], (25, 50, 75)))}\n"
        "blue: the nominal, with the hand at its start, half-way and at its end; green: the goal; "
        "orange: in the straight way to it; dashed: where objects end",
        fontsize="medium",
    )
    return figure


def figure5(data: Data) -> Figure:
    """Draw the bidders of a window: their bids, and the outcomes of their tasks by policy."""
    bidders, sweep, counts = data["bidders"], data["sweep"], data["windows"]
    targets = [b["first_push"]["target"] for b in bidders if b["first_push"]]
    aside = max(abs(y) for b in bidders for _, y in [*b["scene"]["objects"], *targets])
    aside += RADIUS + 0.02
    low, high = 0.14, BACK_WALL_X + 0.015  # m, of x
    width = 3.5  # inches, of a panel
    height = width * (high - low) / (2 * aside)
    figure = Figure(figsize=(width * len(bidders) + 0.4, height + 3.3), layout="constrained")
    grid = figure.add_gridspec(3, len(bidders), height_ratios=(height + 0.6, 1.6, 0.3))
    for i, one in enumerate(bidders):
        ax = figure.add_subplot(grid[0, i])
        scene, push = scene_of(one["scene"]), one["first_push"]
        wins = one["won"]
        draw_scene(
            scene,
            ax,
            title=f"robot {one['robot']}, task {one['task']}, iteration {one['iteration']}:\n"
            f"bids {one['gain']:.1f}, {'wins' if wins else 'loses'}",
        )
        ax.title.set_fontweight("bold" if wins else "normal")
        if push is not None:
            x, y = scene.positions[push["object"]]
            arrow: dict[str, Any] = {"arrowstyle": "-|>", "color": PUSH_COLOR, "linewidth": 2.2}
            arrow |= {"linestyle": "-" if wins else ":", "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", push["target"][::-1], (y, x), arrowprops=arrow, zorder=4.5)
            draw_target(ax, push["target"])
        ax.set_xlim(aside, -aside)
        ax.set_ylim(low, high)
        ax.set_ylabel("x (m), into the shelf" if i == 0 else "")
        _draw_outcomes(figure.add_subplot(grid[1, i]), one["outcomes"])
    later = "; dotted: one given to a loser later" if len(targets) > 1 else ""
    figure.suptitle(
        f"A window in which {len(bidders)} of {sweep['robots']} robots bid "
        f"(predictor: {sweep['predictor']}); {counts['of_several_bids']} of {counts['all']} windows"
        " had several bids\n"
        f"arrow: the push that the winner is given{later}",
        fontsize="large",
    )
    paper = data["paper"]
    *first, last = map(str, paper["solved_alone_after"])
    write(
        figure.add_subplot(grid[2, :]),
        f"The paper's figure 5, under OR-HITL: scenes solved alone after {', '.join(first)} and "
        f"{last} iterations, asks at iterations {' and '.join(map(str, paper['asks_at']))}, "
        f"{counted(paper['failures'], 'failure')}",
    )
    return figure


FIGURES: Mapping[int, Callable[[Data], Figure]] = {2: figure2, 4: figure4, 5: figure5}


def _draw_outcomes(ax: "Axes", outcomes: Mapping[str, Data]) -> None:
    """Draw a table of a task's outcome under each policy; iterations are of reaching."""
    rows: dict[str, Callable[[Data], str]] = {
        "ended": lambda o: o["status"].replace("_", " "),
        "reach iterations": lambda o: str(o["reach_iterations"]),
        "first ask at": lambda o: "never" if o["first_bid"] is None else str(o["first_bid"]),
        "first help at": lambda o: "never" if o["first_grant"] is None else str(o["first_grant"]),
        "inputs": lambda o: str(o["grants"]),
    }
    ax.axis("off")
    table = ax.table(
        [[name, *(row(outcome) for outcome in outcomes.values())] for name, row in rows.items()],
        colLabels=["", *(policy.upper() for policy in outcomes)],
        colWidths=[0.44, 0.28, 0.28],
        cellLoc="center",
        edges="horizontal",
        bbox=Bbox.unit(),
    )
    table.auto_set_font_size(False)
    table.set_fontsize(11)
    for cell in table.get_celld().values():
        cell.set_edgecolor("#bbbbbb")
