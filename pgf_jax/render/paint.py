"""Antialiased drawing with Pillow: shapes are drawn larger and reduced, then text is written."""

import functools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

INK, MUTED, RULE = "#1d2733", "#687482", "#d3d9e1"
BACKGROUND, CARD = "#e6e9ee", "#ffffff"
SHELF_ASPECT = 1.2  # width over height at which a picture of a shelf has the least empty border
_FINER = 3  # pixels of the drawing per pixel of the finished picture, each way

Point = tuple[float, float]
Box = tuple[float, float, float, float]  # left, top, right, bottom


@functools.cache
def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font DejaVu Sans, which matplotlib contains; `size` in pixels."""
    import matplotlib

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, size)


def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width of a line of text, pixels."""
    return font(max(round(size), 1), bold).getlength(text)


class Canvas:
    """A picture to draw on; coordinates and widths are pixels of the finished picture, as floats.

    Colours may have alpha (`#rrggbbaa`). Pasted pictures lie above all shapes, and text above both.
    """

    def __init__(self, width: int, height: int, background: "str | Canvas" = CARD) -> None:
        """Create a canvas.

        Args:
          width, height: of the finished picture, pixels.
          background: a colour, or a canvas of this size, whose shapes and text are copied.
        """
        self.width, self.height = width, height
        self._texts: list[tuple] = []
        self._pastes: list[tuple[int, int, np.ndarray]] = []
        if isinstance(background, Canvas):
            self._image = background._image.copy()
            self._texts += background._texts
        else:
            self._image = Image.new("RGB", (width * _FINER, height * _FINER), background)
        self._draw = ImageDraw.Draw(self._image, "RGBA")

    def polygon(self, points: Sequence[Point], fill: str) -> None:
        """Fill a polygon."""
        self._draw.polygon([(x * _FINER, y * _FINER) for x, y in points], fill)

    def rectangle(
        self,
        box: Box,
        fill: str | None = None,
        *,
        radius: float = 0.0,
        outline: str | None = None,
        width: float = 1.0,
    ) -> None:
        """Draw a rectangle with corners rounded by `radius`; the outline lies inside."""
        left, top, right, bottom = (round(v * _FINER) for v in box)
        self._draw.rounded_rectangle(
            (left, top, max(right - 1, left), max(bottom - 1, top)),
            radius * _FINER,
            fill,
            outline,
            max(round(width * _FINER), 1) if outline else 0,
        )

    def disc(
        self,
        centre: Point,
        radius: float,
        fill: str | None,
        *,
        outline: str | None = None,
        width: float = 1.0,
    ) -> None:
        """Draw a disc; the outline lies inside."""
        self._draw.ellipse(
            _around(centre, radius),
            fill,
            outline,
            max(round(width * _FINER), 1) if outline else 0,
        )

    def dashed_circle(self, centre: Point, radius: float, color: str, width: float) -> None:
        """Draw a circle of 12 dashes."""
        box = _around(centre, radius)
        for start in range(0, 360, 30):
            self._draw.arc(box, start, start + 18, color, max(round(width * _FINER), 1))

    def line(self, points: Sequence[Point], color: str, width: float) -> None:
        """Draw a line through points; its joints are round, its ends square."""
        scaled = [(x * _FINER, y * _FINER) for x, y in points]
        self._draw.line(scaled, color, max(round(width * _FINER), 1), joint="curve")

    def capsule(self, a: Point, b: Point, radius: float, color: str) -> None:
        """Fill all points within `radius` of the line from `a` to `b`."""
        length = math.hypot(b[0] - a[0], b[1] - a[1])
        if length:
            dx, dy = (b[0] - a[0]) / length * radius, (b[1] - a[1]) / length * radius
            self.polygon(
                [
                    (a[0] - dy, a[1] + dx),
                    (b[0] - dy, b[1] + dx),
                    (b[0] + dy, b[1] - dx),
                    (a[0] + dy, a[1] - dx),
                ],
                color,
            )
        self.disc(a, radius, color)
        self.disc(b, radius, color)

    def arrow(self, a: Point, b: Point, color: str, width: float) -> None:
        """Draw an arrow from `a` to its tip `b`; nothing if they are the same point."""
        length = math.hypot(b[0] - a[0], b[1] - a[1])
        if length < 1e-9:
            return
        ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
        head = min(4.5 * width, length)
        neck = (b[0] - ux * head, b[1] - uy * head)
        self.line([a, neck], color, width)
        half = head * 0.45
        corners = [(neck[0] - uy * half, neck[1] + ux * half)]
        corners += [(neck[0] + uy * half, neck[1] - ux * half), b]
        self.polygon(corners, color)

    def text(
        self,
        at: Point,
        text: str,
        size: float,
        color: str = INK,
        *,
        anchor: str = "lm",
        bold: bool = False,
        room: float | None = None,
    ) -> None:
        """Write a line of text.

        Args:
          at: position of the anchor, pixels.
          text: to write.
          size: of the font, pixels.
          color: of the text.
          anchor: Pillow's: l, m or r; then a (top), m (middle), s (baseline) or d (descender).
          bold: use the bold font.
          room: width in pixels that the text may take; text that is too wide is written smaller,
            down to 0.7 of `size`, and then cut off.
        """
        least, size = round(0.7 * size), max(round(size), 1)
        if room is not None:
            while size > least and text_width(text, size, bold) > room:
                size -= 1
        if room is not None and text_width(text, size, bold) > room:
            while text and text_width(text + "…", size, bold) > room:
                text = text[:-1]
            text = text.rstrip() + "…" if text else ""
        self._texts.append((at, text, size, color, anchor, bold))

    def paste(self, left: int, top: int, picture: np.ndarray) -> None:
        """Put a finished picture ([h, w, 3] uint8) over the shapes."""
        self._pastes.append((left, top, picture))

    def finish(self) -> np.ndarray:
        """The finished picture, [height, width, 3] uint8."""
        image = self._image.reduce(_FINER)
        for left, top, picture in self._pastes:
            image.paste(Image.fromarray(picture), (left, top))
        draw = ImageDraw.Draw(image)
        for at, text, size, color, anchor, bold in self._texts:
            draw.text(at, text, color, font(size, bold), anchor)
        return np.array(image)


def _around(centre: Point, radius: float) -> Box:
    x, y = centre
    x, y, radius = x * _FINER, y * _FINER, radius * _FINER
    return x - radius, y - radius, x + radius, y + radius
