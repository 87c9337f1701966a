"""The cost curve of a robot's task."""

import math
from collections.abc import Sequence

from pgf_jax.planning.config import Cost
from pgf_jax.render.paint import MUTED, RULE, Box, Canvas, text_width

CURVE, INPUT, FEASIBLE = "#2f66b0", "#d1442f", "#2e9e4f"
BID, GRANT = "#b97a00", "#7a55b5"
BID_SIGN, GRANT_SIGN, INPUT_SIGN = "▲", "◆", "|"
_LEAST_TOP = 1000.0  # cost at the upper edge, unless the curve is higher
_LEAST_ITERATIONS = 10


def draw_costs(
    canvas: Canvas,
    box: Box,
    costs: Sequence[float],
    inputs_at: Sequence[int],
    *,
    bids_at: Sequence[int] = (),
    grants_at: Sequence[int] = (),
    size: float = 0.0,
) -> None:
    """Draw the cost of the best trajectory after each reach iteration, scaled as log(1 + cost).

    Args:
      canvas: to draw on.
      box: place on the canvas, pixels.
      costs: after each iteration; costs that are not finite lie at the upper edge.
      inputs_at: for each input, how many costs there were when it came; a vertical line is drawn
        between the costs before and after it.
      bids_at, grants_at: for each bid and each grant, likewise; a sign is drawn at the lower edge,
        if there are numbers at the axes.
      size: of the numbers at the axes, pixels; 0: no numbers.
    """
    left, top, right, bottom = box
    if size:
        left += text_width("1000", size) + 0.6 * size
        bottom -= 1.9 * size
    finite = [cost for cost in costs if math.isfinite(cost)]
    highest = math.log1p(max(_LEAST_TOP, *finite, 0.0)) * 1.03
    last = max(len(costs) - 1, _LEAST_ITERATIONS)

    def x(iteration: float) -> float:
        return left + (right - left) * iteration / last

    def y(cost: float) -> float:
        share = math.log1p(max(cost, 0.0)) / highest if math.isfinite(cost) else 1.0
        return bottom - (bottom - top) * share

    canvas.rectangle((left, top, right, bottom), "#f3f5f8")
    if size:
        for power in range(5):
            if math.log1p(10**power) > highest:
                break
            level = y(10.0**power)
            canvas.line([(left, level), (right, level)], RULE, 0.8)
            canvas.text((left - 0.5 * size, level), f"{10**power}", size, MUTED, anchor="rm")
        step = 5 if last <= 30 else 20 if last <= 120 else 100
        for iteration in range(0, last + 1, step):
            at = (x(iteration), bottom + 0.35 * size)
            canvas.text(at, str(iteration), size, MUTED, anchor="ma")
    threshold = y(Cost().feasible_cost)
    dash = (right - left) / 41
    for i in range(0, 41, 2):
        canvas.line(
            [(left + i * dash, threshold), (left + (i + 1) * dash, threshold)], FEASIBLE, 1.1
        )
    if size:
        canvas.text(
            (right - 0.4 * size, threshold + 0.3 * size),
            f"feasible below {Cost().feasible_cost:g}",
            0.9 * size,
            FEASIBLE,
            anchor="ra",
        )
    for count in inputs_at:
        # An input may come before the first rollout, when there is no curve yet.
        at = x(max(count - 0.5, 0.0))
        canvas.line([(at, top), (at, bottom)], INPUT + "b0", 1.4)
    if size:
        for counts, sign, color, row in (
            (bids_at, BID_SIGN, BID, 0.6),
            (grants_at, GRANT_SIGN, GRANT, 1.7),
        ):
            for count in dict.fromkeys(counts):
                at = (x(max(count - 0.5, 0.0)), bottom - row * size)
                canvas.text(at, sign, 1.1 * size, color, anchor="mm")
    points = [(x(i), y(cost)) for i, cost in enumerate(costs)]
    if len(points) > 1:
        canvas.polygon([(points[0][0], bottom), *points, (points[-1][0], bottom)], CURVE + "30")
        canvas.line(points, CURVE, 1.8 if size else 1.5)
    if points:
        canvas.disc(points[-1], 3.2 if size else 2.4, CURVE)
