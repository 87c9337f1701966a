"""The input panel: who operates, and how a push is picked; refused actions change nothing."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pgf_jax.console.input_panel import (
    CLEARANCE,
    REACH,
    STEP,
    Allowed,
    Feedback,
    InputPanel,
    target_problem,
)
from pgf_jax.console.live_operator import InputRequest
from pgf_jax.guidance.view import View
from pgf_jax.planning.types import UNANSWERED, Push
from pgf_jax.scene.shelf import BACK_WALL_X, FRONT_X, RADIUS, SIDE_WALL_Y

OBJECTS = ((0.40, 0.00), (0.45, 0.10), (0.30, -0.20), (0.50, 0.25), (0.25, 0.05))
GOAL = 4  # nearest to the hand, but seldom in the way
FROM_THE_HAND = [2, 0, 1, 3, 4]
ROBOT, ME, OTHER = 3, 1, 2


def view(objects=OBJECTS, goal=GOAL) -> View:
    n, knots = len(objects), 2
    places = np.array(objects, np.float64)
    return View(
        objects=places,
        goal=goal,
        hand=np.array([0.10, 0.0, 0.0]),
        gripper=0.0,
        path=np.repeat(places[None], knots, 0),
        hands=np.zeros((knots, 3)),
        force=np.zeros((knots, n)),
        bodies=np.zeros((knots, n, 2), np.int32),
        terms=np.zeros(5),
        request=0,
        dropped=0,
    )


class Service:
    """A request of a robot that is being served, and the inputs it was given."""

    def __init__(self, robot: int = ROBOT, request: int = 0, **changes) -> None:
        self.given: list = []
        self.request = InputRequest(robot, 0, request, view(**changes), self.given.append)


def operated_panel(service: Service | None = None) -> InputPanel:
    panel = InputPanel()
    assert panel.take(ME).ok
    if service is not None:
        panel.open(service.request)
    return panel


def state(panel: InputPanel) -> tuple:
    return panel.operator, panel.pending, panel.object, panel.target, panel.problem


def refused(panel: InputPanel, do, text: str) -> None:
    """Check that an action is refused with a message, and changes nothing."""
    before = state(panel)
    feedback = do()
    assert feedback == Feedback(text, ok=False)
    assert state(panel) == before


def acts(panel: InputPanel, client: int) -> dict:
    return {
        "click": lambda: panel.click(client, ROBOT, *OBJECTS[0]),
        "next": lambda: panel.next_object(client),
        "nudge": lambda: panel.nudge(client, 1, 0),
        "undo": lambda: panel.undo(client),
        "confirm": lambda: panel.confirm(client),
        "go on": lambda: panel.go_on(client),
    }


# -- who operates --------------------------------------------------------------------------------


def test_one_operates_and_others_watch():
    panel = InputPanel()
    assert panel.take(ME).text == "You operate."
    assert panel.take(ME).ok  # already
    refused(panel, lambda: panel.take(OTHER), "Somebody else operates; you can watch.")
    assert panel.operator == ME
    assert not panel.leave(OTHER)
    assert panel.operator == ME
    assert panel.leave(ME)
    assert panel.operator is None
    assert not panel.leave(ME)
    assert panel.take(OTHER).ok
    refused(panel, lambda: panel.take(ME), "Somebody else operates; you can watch.")


def test_a_client_of_number_0_is_somebody():
    panel = InputPanel()
    assert panel.take(0).ok
    refused(panel, lambda: panel.take(ME), "Somebody else operates; you can watch.")
    assert panel.leave(0)


@pytest.mark.parametrize("act", acts(InputPanel(), 0))
def test_actions_of_clients_that_do_not_operate(act):
    service = Service()
    panel = InputPanel()
    refused(panel, acts(panel, ME)[act], "Nobody operates; you watch.")
    panel.open(service.request)
    refused(panel, acts(panel, ME)[act], "Nobody operates; you watch.")
    panel.take(ME)
    panel.click(ME, ROBOT, *OBJECTS[1])
    panel.click(ME, ROBOT, 0.35, 0.2)
    refused(panel, acts(panel, OTHER)[act], "Somebody else operates; you watch.")
    panel.close()
    assert state(panel) == (ME, None, None, None, "")
    refused(panel, acts(panel, ME)[act], "No robot is being served.")
    assert service.given == []


def test_what_was_picked_is_kept_for_the_next_operator():
    service = Service()
    panel = operated_panel(service)
    panel.click(ME, ROBOT, *OBJECTS[0])
    panel.click(ME, ROBOT, 0.3, 0.2)
    panel.leave(ME)
    assert (panel.object, panel.target) == (0, (0.3, 0.2))
    panel.take(OTHER)
    assert panel.confirm(OTHER).answered
    assert service.given == [Push(0, 0.3, 0.2)]


def test_what_clients_could_do():
    panel = InputPanel()
    assert panel.allowed(ME) == Allowed(take=True)
    panel.take(ME)
    assert panel.allowed(ME) == panel.allowed(OTHER) == Allowed()
    # Whoever did not answer is taken to be away, and comes back by the same button.
    assert panel.allowed(ME, attended=False) == Allowed(take=True)
    assert panel.allowed(OTHER, attended=False) == Allowed()
    panel.open(Service().request)
    assert panel.allowed(ME) == Allowed(go_on=True)
    panel.click(ME, ROBOT, *OBJECTS[0])
    assert panel.allowed(ME) == Allowed(go_on=True, undo=True)
    panel.click(ME, ROBOT, 0.3, 0.2)
    assert panel.allowed(ME) == Allowed(confirm=True, go_on=True, undo=True)
    panel.click(ME, ROBOT, *OBJECTS[0])
    panel.nudge(ME, 5, 10)  # where another object stands
    assert panel.problem and panel.allowed(ME) == Allowed(go_on=True, undo=True)
    assert panel.allowed(OTHER) == Allowed()


# -- object, point, confirmation -------------------------------------------------------------------


def test_a_push_is_picked_by_two_clicks_and_confirmed():
    service = Service()
    panel = operated_panel(service)
    feedback = panel.click(ME, ROBOT, 0.41, 0.01)
    assert feedback == Feedback("Object 1: now click where it should come to.")
    assert (panel.object, panel.target) == (0, None)
    feedback = panel.click(ME, ROBOT, 0.35, 0.2)
    assert feedback.text == "Object 1 to here? Push (Enter), or click another place."
    assert panel.target == (0.35, 0.2)
    assert panel.click(ME, ROBOT, 0.3, 0.15).ok  # another place
    assert service.given == []
    feedback = panel.confirm(ME)
    assert feedback == Feedback(
        "Object 1 to 0.10 m deep on the shelf, 0.15 m left of the middle.", answered=True
    )
    assert service.given == [Push(0, 0.3, 0.15)]
    assert all(type(value) is float for value in (service.given[0].x, service.given[0].y))
    assert state(panel) == (ME, None, None, None, "")
    refused(panel, lambda: panel.confirm(ME), "No robot is being served.")
    assert len(service.given) == 1


def test_going_on_is_said_at_any_time():
    for clicks in ([], [OBJECTS[0]], [OBJECTS[0], (0.3, 0.2)]):
        service = Service()
        panel = operated_panel(service)
        for place in clicks:
            assert panel.click(ME, ROBOT, *place).ok
        feedback = panel.go_on(ME)
        assert feedback == Feedback("Go on reaching.", answered=True)
        assert service.given == [None]
        assert state(panel) == (ME, None, None, None, "")


def test_nothing_is_confirmed_too_early():
    panel = operated_panel(Service())
    refused(panel, lambda: panel.confirm(ME), "Pick an object first.")
    panel.click(ME, ROBOT, *OBJECTS[0])
    refused(panel, lambda: panel.confirm(ME), "Pick a place for the object first.")


def test_clicks_that_mean_nothing():
    panel = operated_panel(Service())
    beside = "There is no object there: click an object first."
    refused(panel, lambda: panel.click(ME, ROBOT, 0.35, 0.3), beside)
    refused(panel, lambda: panel.click(ME, ROBOT, -7.0, 0.0), beside)
    for place in ((math.nan, 0.0), (0.4, math.inf), (-math.inf, math.nan)):
        refused(panel, lambda place=place: panel.click(ME, ROBOT, *place), "That is no place.")
    for _ in range(2):  # before an object is picked, and after
        refused(panel, lambda: panel.click(ME, None, *OBJECTS[0]), "That is no shelf.")
        refused(
            panel, lambda: panel.click(ME, 0, *OBJECTS[0]), "Robot 3 asks, not robot 0."
        )  # fmt: skip
        panel.click(ME, ROBOT, *OBJECTS[0])
    refused(panel, lambda: panel.click(ME, ROBOT, math.nan, 0.0), "That is no place.")


def test_a_click_means_the_nearest_object_a_little_beside_it_too():
    near = REACH * RADIUS
    panel = operated_panel(Service())
    assert panel.click(ME, ROBOT, OBJECTS[2][0] - 0.999 * near, OBJECTS[2][1]).ok
    assert panel.object == 2
    panel.undo(ME)
    beside = "There is no object there: click an object first."
    refused(panel, lambda: panel.click(ME, ROBOT, OBJECTS[2][0] - 1.001 * near, -0.2), beside)
    # Two objects that touch: between them it is the nearer one.
    panel = operated_panel(Service(objects=((0.4, 0.0), (0.4, 0.06), (0.2, 0.0)), goal=2))
    panel.click(ME, ROBOT, 0.4, 0.0299)
    assert panel.object == 0
    panel.undo(ME)
    panel.click(ME, ROBOT, 0.4, 0.0301)
    assert panel.object == 1


WALL = "The object would stand in the wall there."
OUTSIDE = "That is outside the shelf."


@pytest.mark.parametrize(
    ("x", "y", "text"),
    [
        (FRONT_X - 1e-6, 0.0, OUTSIDE),
        (BACK_WALL_X + 1e-6, 0.0, OUTSIDE),
        (0.4, SIDE_WALL_Y + 1e-6, OUTSIDE),
        (0.4, -SIDE_WALL_Y - 1e-6, OUTSIDE),
        (1e300, 0.0, OUTSIDE),
        (BACK_WALL_X - RADIUS + 1.01 * CLEARANCE, 0.0, WALL),
        (BACK_WALL_X, 0.0, WALL),
        (0.4, SIDE_WALL_Y - RADIUS + 1.01 * CLEARANCE, WALL),
        (0.4, -SIDE_WALL_Y + RADIUS - 1.01 * CLEARANCE, WALL),
        (*OBJECTS[1], "Object 2 stands there."),
        (OBJECTS[1][0] - 2 * RADIUS + 1.01 * CLEARANCE, OBJECTS[1][1], "Object 2 stands there."),
        (*OBJECTS[GOAL], "Object 5 stands there."),
        # All other places are allowed.
        (FRONT_X, 0.0, ""),
        (BACK_WALL_X - RADIUS + 0.99 * CLEARANCE, 0.0, ""),
        (0.45, -SIDE_WALL_Y + RADIUS - 0.99 * CLEARANCE, ""),
        (OBJECTS[1][0] - 2 * RADIUS + 0.99 * CLEARANCE, OBJECTS[1][1], ""),
        (*OBJECTS[0], ""),  # where it stands
        (OBJECTS[0][0] + 0.01, OBJECTS[0][1], ""),  # an object does not block itself
    ],
)
def test_targets_that_are_allowed_and_others(x, y, text):
    panel = operated_panel(Service())
    panel.click(ME, ROBOT, *OBJECTS[0])
    assert target_problem(view(), 0, x, y) == text
    if text:
        refused(panel, lambda: panel.click(ME, ROBOT, x, y), text)
        panel.click(ME, ROBOT, 0.3, 0.2)
        refused(panel, lambda: panel.click(ME, ROBOT, x, y), text)  # the earlier place stays
        assert panel.target == (0.3, 0.2)
    else:
        assert panel.click(ME, ROBOT, x, y).ok
        assert panel.target == (x, y)
        assert panel.confirm(ME).answered


def test_a_shelf_of_one_object():
    service = Service(objects=((0.4, 0.0),), goal=0)
    panel = operated_panel(service)
    panel.next_object(ME)
    assert panel.click(ME, ROBOT, 0.4, 0.0).ok
    panel.next_object(ME)
    assert panel.object == 0 and panel.target is None
    panel.nudge(ME, 0, 1)
    assert panel.confirm(ME).answered
    assert service.given == [Push(0, 0.4, STEP)]


def test_undo_takes_back_the_place_then_the_object():
    panel = operated_panel(Service())
    refused(panel, lambda: panel.undo(ME), "There is nothing to undo.")
    panel.click(ME, ROBOT, *OBJECTS[0])
    panel.click(ME, ROBOT, 0.3, 0.2)
    panel.click(ME, ROBOT, 0.3, 0.25)
    assert panel.undo(ME).text == "Place taken back: click where the object should come to."
    assert (panel.object, panel.target) == (0, None)
    assert panel.undo(ME).text == "Object taken back: click an object."
    assert (panel.object, panel.target) == (None, None)
    refused(panel, lambda: panel.undo(ME), "There is nothing to undo.")
    assert panel.click(ME, ROBOT, *OBJECTS[1]).text.startswith("Object 2")
    # A place with a problem is taken back with it.
    assert not panel.nudge(ME, 5, 15).ok
    assert panel.target is not None and panel.problem == "Object 4 stands there."
    panel.undo(ME)
    assert (panel.object, panel.target, panel.problem) == (1, None, "")


# -- by keyboard -----------------------------------------------------------------------------------


def test_objects_come_by_their_distance_from_the_hand_the_goal_last():
    panel = operated_panel(Service())
    seen = []
    for _ in range(2 * len(OBJECTS)):
        feedback = panel.next_object(ME)
        assert feedback.ok and feedback.text.startswith(f"Object {panel.object + 1}:")  # pyright: ignore[reportOptionalOperand]
        seen.append(panel.object)
    distances = [math.dist(OBJECTS[i], (0.10, 0.0)) for i in FROM_THE_HAND[:-1]]
    assert distances == sorted(distances)
    assert seen == 2 * FROM_THE_HAND
    # It goes on from an object that was clicked, and a place that was picked is forgotten.
    panel.undo(ME)
    panel.click(ME, ROBOT, *OBJECTS[1])
    panel.click(ME, ROBOT, 0.3, 0.2)
    panel.next_object(ME)
    assert (panel.object, panel.target) == (FROM_THE_HAND[FROM_THE_HAND.index(1) + 1], None)


def test_a_place_is_reached_by_steps():
    service = Service()
    panel = operated_panel(service)
    refused(panel, lambda: panel.nudge(ME, 1, 0), "Pick an object first (Tab, or click it).")
    panel.click(ME, ROBOT, *OBJECTS[0])
    assert panel.nudge(ME, -1, 0).text == "To there? Push (Enter), or move it on."
    assert panel.target == pytest.approx((0.39, 0.0))
    panel.nudge(ME, 0, -3)
    assert panel.target == pytest.approx((0.39, -0.03))
    panel.click(ME, ROBOT, 0.3, 0.2)
    panel.nudge(ME, 1, 1)  # on from a place that was clicked
    assert panel.target == pytest.approx((0.31, 0.21))
    assert panel.confirm(ME).answered
    (push,) = service.given
    assert (push.object, push.x, push.y) == (0, pytest.approx(0.31), pytest.approx(0.21))


def test_steps_may_cross_targets_that_are_not_allowed():
    panel = operated_panel(Service())
    panel.click(ME, ROBOT, *OBJECTS[0])
    panel.nudge(ME, 5, 0)
    problems = []
    for _ in range(20):
        feedback = panel.nudge(ME, 0, 1)
        problems.append(panel.problem)
        assert feedback.ok == (not panel.problem) and feedback.text == (
            panel.problem or "To there? Push (Enter), or move it on."
        )
        if panel.problem:
            refused(panel, lambda: panel.confirm(ME), panel.problem)
    assert problems[9] == "Object 2 stands there."
    assert problems[0] == problems[-1] == ""
    assert panel.target == pytest.approx((0.45, 0.20))
    # Beyond the walls it does not go at all.
    for _ in range(40):
        panel.nudge(ME, 0, 1)
    assert panel.target == pytest.approx((0.45, 0.37))
    refused(panel, lambda: panel.nudge(ME, 0, 1), WALL)
    refused(panel, lambda: panel.nudge(ME, 0, 9), OUTSIDE)
    refused(panel, lambda: panel.nudge(ME, -1000, 0), OUTSIDE)
    assert panel.confirm(ME).answered


# -- services --------------------------------------------------------------------------------------


def test_a_new_service_begins_with_nothing_picked():
    first, second = Service(), Service(robot=5, request=2)
    panel = operated_panel(first)
    panel.click(ME, ROBOT, *OBJECTS[0])
    panel.click(ME, ROBOT, 0.3, 0.2)
    panel.open(second.request)
    assert state(panel) == (ME, second.request, None, None, "")
    refused(panel, lambda: panel.click(ME, ROBOT, 0.3, 0.2), "Robot 5 asks, not robot 3.")
    panel.close()
    assert state(panel) == (ME, None, None, None, "")
    assert first.given == second.given == []


def test_no_answer_is_given_for_an_operator_who_gives_none():
    service = Service()
    panel = operated_panel(service)
    panel.click(ME, ROBOT, *OBJECTS[0])
    panel.answer(UNANSWERED)
    assert service.given == [UNANSWERED]
    assert state(panel) == (ME, None, None, None, "")


def test_the_panel_is_clear_when_an_answer_has_its_effect():
    """The fleet may continue at once, and serve the next robot from within the answer."""
    panel = operated_panel()
    second = Service(robot=0)

    def answer(given):
        assert panel.pending is None
        panel.open(second.request)

    panel.open(InputRequest(ROBOT, 0, 0, view(), answer))
    assert panel.go_on(ME).answered
    assert panel.pending is second.request


PLACE = st.one_of(
    st.tuples(st.floats(0.15, 0.65), st.floats(-0.45, 0.45)),
    st.sampled_from(OBJECTS),
    st.tuples(st.floats(), st.floats()),
)
CLIENT = st.sampled_from([ME, ME, ME, OTHER, 7])
ACT = st.one_of(
    st.tuples(st.just("take"), CLIENT),
    st.tuples(st.just("leave"), CLIENT),
    st.tuples(st.just("open"), st.just(None)),
    st.tuples(st.just("close"), st.just(None)),
    st.tuples(st.just("click"), CLIENT, st.sampled_from([ROBOT, ROBOT, ROBOT, 0, None]), PLACE),
    st.tuples(st.just("next"), CLIENT),
    st.tuples(st.just("nudge"), CLIENT, st.integers(-9, 9), st.integers(-9, 9)),
    st.tuples(st.just("undo"), CLIENT),
    st.tuples(st.just("confirm"), CLIENT),
    st.tuples(st.just("go on"), CLIENT),
)
# Actions that lead to a push: an object, then places.
USUAL = st.sampled_from(
    [
        *[("click", ME, ROBOT, place) for place in OBJECTS],
        ("click", ME, ROBOT, (0.35, 0.2)),
        ("next", ME),
        ("confirm", ME),
        ("open", None),
        ("take", ME),
    ]
)


def do(panel: InputPanel, services: list[Service], name: str, client: int, *more):
    match name:
        case "open":
            services.append(Service(request=len(services)))
            return panel.open(services[-1].request)
        case "close":
            return panel.close()
        case "take":
            return panel.take(client)
        case "leave":
            return panel.leave(client)
        case "click":
            robot, place = more
            return panel.click(client, robot, *place)
        case "nudge":
            return panel.nudge(client, *more)
        case "next":
            return panel.next_object(client)
        case "undo":
            return panel.undo(client)
        case "confirm":
            return panel.confirm(client)
        case _:
            return panel.go_on(client)


@settings(max_examples=300, deadline=None)
@given(todo=st.lists(st.one_of(ACT, USUAL), max_size=40))
@example(
    [("take", ME), ("open", None), ("next", ME), ("nudge", ME, 0, 5), ("confirm", ME), ("undo", ME)]
)
def test_whatever_clients_do(todo):
    panel, services = InputPanel(), []
    for name, client, *more in todo:
        before, operator = state(panel), panel.operator
        allowed = client and panel.allowed(client)
        counts = [len(service.given) for service in services]
        feedback = do(panel, services, name, client, *more)
        after = state(panel)
        intruder = client is not None and client != operator
        if intruder and (name != "take" or operator is not None):
            assert after == before
            assert [len(service.given) for service in services] == counts
        if isinstance(feedback, Feedback):
            assert feedback.text and "\n" not in feedback.text
            if name in ("confirm", "go on", "undo") or (name == "take" and client != operator):
                assert feedback.ok == getattr(allowed, name.replace(" ", "_"))
            if not feedback.ok:
                assert not feedback.answered
                # A place on its way through an object moves all the same.
                crossing = name == "nudge" and panel.problem == feedback.text
                assert after[:3] == before[:3] if crossing else after == before
            assert feedback.answered == (sum(len(s.given) for s in services) > sum(counts))
        # Each service is answered once at most, and then it is over.
        assert all(len(service.given) <= 1 for service in services)
        open_ = [service for service in services if service.request is panel.pending]
        assert len(open_) == (panel.pending is not None)
        assert all(not service.given for service in open_)
        if panel.pending is None:
            assert (panel.object, panel.target, panel.problem) == (None, None, "")
        if panel.target is not None:
            assert panel.object is not None
    for service in services:
        for push in service.given:
            if push is not None:
                assert FRONT_X <= push.x <= BACK_WALL_X - RADIUS + CLEARANCE
                assert abs(push.y) <= SIDE_WALL_Y - RADIUS + CLEARANCE
                others = [place for i, place in enumerate(OBJECTS) if i != push.object]
                gaps = [math.dist(place, (push.x, push.y)) for place in others]
                assert min(gaps) >= 2 * RADIUS - CLEARANCE - 1e-12
