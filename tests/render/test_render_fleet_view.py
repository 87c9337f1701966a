"""Pictures of a fleet, and of single robots."""

import math
from typing import Any

import numpy as np
import pytest
from render_cases import count, fleet, rgb, robot

from pgf_jax.fleet.records import State
from pgf_jax.planning.types import Push, Status
from pgf_jax.render import fleet_view
from pgf_jax.render.chart import CURVE, draw_costs
from pgf_jax.render.paint import Canvas
from pgf_jax.render.robot_view import state_text
from pgf_jax.render.top import TopView

COLORS = [f"#{40 + 3 * i:02x}10{250 - 3 * i:02x}" for i in range(60)]  # of each robot's shelf


class Flat:
    """A view that draws each shelf as one colour."""

    def __init__(self) -> None:
        self.drawn: list[tuple[int, int, int]] = []

    def shelf(self, robot, width, height) -> np.ndarray:
        self.drawn.append((robot.robot, width, height))
        return np.broadcast_to(rgb(COLORS[robot.robot]), (height, width, 3)).copy()

    def close(self) -> None:
        pass


@pytest.mark.parametrize("robots", [1, 2, 6, 20, 60])
@pytest.mark.parametrize("served", [True, False])
def test_every_robot_has_its_shelf_and_the_served_one_a_large_one(robots, served):
    view, serving = Flat(), robots - 1 if served else None
    picture = fleet_view.draw(fleet(robots, serving), (1400, 900), view)
    assert picture.shape == (900, 1400, 3) and picture.dtype == np.uint8
    areas: dict[int, list[int]] = {i: [] for i in range(robots)}
    for index, width, height in view.drawn:
        areas[index].append(width * height)
    large = served and robots > 1
    for index, sizes in areas.items():
        assert len(sizes) == (2 if large and index == serving else 1)
        seen = count(picture, COLORS[index])
        assert 0.97 * sum(sizes) <= seen <= sum(sizes)  # the tasks' signs lie on it
    if large:
        assert max(areas[robots - 1]) > 1.2 * min(areas[robots - 1])


def test_cells_keep_their_places_while_the_operator_comes_and_goes():
    places = []
    for serving in (0, 3, None):
        picture = fleet_view.draw(fleet(6, serving), (1400, 900), Flat())
        found = [np.argwhere((picture == rgb(COLORS[i])).all(-1)) for i in (1, 2, 4, 5)]
        places.append([(*at.min(0), *at.max(0)) for at in found])
    assert places[0] == places[1] == places[2]


@pytest.mark.parametrize("robots", range(1, 61))
def test_cells_lie_side_by_side_within_their_box(robots):
    box = (6.0, 55.0, 830.0, 894.0)
    cells = np.array(fleet_view.layout(robots, box))
    assert len(cells) == robots
    assert (cells[:, :2] >= np.array(box[:2]) - 1e-9).all()
    assert (cells[:, 2:] <= np.array(box[2:]) + 1e-9).all()
    for i, (left, top, right, bottom) in enumerate(cells):
        others = np.delete(cells, i, axis=0)
        apart = (others[:, 0] >= right) | (others[:, 2] <= left)
        assert (apart | (others[:, 1] >= bottom) | (others[:, 3] <= top)).all()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "planning"),
        ({"push": Push(0, 0.4, 0.1)}, "planning push"),
        ({"state": State.EXECUTING, "push": Push(0, 0.4, 0.1)}, "pushing"),
        ({"state": State.EXECUTING}, "executing"),
        ({"state": State.IN_WINDOW, "bid": 23.4}, "bids G 23"),
        ({"state": State.IN_WINDOW, "bid": 2.34}, "bids G 2.3"),
        ({"state": State.IN_WINDOW, "bid": math.inf}, "bids, stuck"),
        ({"state": State.IN_LINE, "bid": 23.4}, "waiting G 23"),
        ({"state": State.IN_LINE, "bid": None}, "waiting"),
        ({"state": State.SERVED, "bid": 23.4}, "served"),
        ({"state": State.IDLE, "done": (Status.SOLVED,)}, "done"),
    ],
)
def test_a_state_as_text(changes: dict[str, Any], text):
    assert state_text(robot(**changes)) == text


def curve(costs, inputs_at=()) -> np.ndarray:
    canvas = Canvas(220, 100)
    draw_costs(canvas, (0, 0, 220, 100), costs, inputs_at)
    return canvas.finish()


def test_a_lower_cost_is_a_lower_curve():
    def height(costs) -> float:
        return np.argwhere((curve(costs) == rgb(CURVE)).all(-1))[:, 0].mean()

    assert height([math.inf] * 5) < height([800.0] * 5) < height([100.0] * 5) < height([5.0] * 5)


def test_inputs_stand_between_the_costs_before_and_after_them():
    plain, marked = curve([300.0] * 11), curve([300.0] * 11, (4,))
    columns = np.nonzero((plain != marked).any((0, 2)))[0]
    assert 3 * 22 < columns.min() <= columns.max() < 4 * 22
    assert (curve([], (0,)) != curve([])).any()  # asked before anything was rolled out


def test_one_robot_alone_fills_a_picture():
    for size in [(1280, 800), (480, 720), (240, 240)]:
        picture = fleet_view.draw_one(robot(push=Push(0, 0.5, 0.3)), size, TopView(), tasks=20)
        assert picture.shape == (size[1], size[0], 3)


def test_the_same_snapshot_is_the_same_picture():
    view = TopView()
    once, again = (fleet_view.draw(fleet(8, 3), (700, 450), view) for _ in range(2))
    np.testing.assert_array_equal(once, again)
