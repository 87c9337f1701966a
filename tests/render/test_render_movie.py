"""The files of pictures and films."""

import sys

import numpy as np
import pytest
from PIL import Image

from pgf_jax.errors import BadInput
from pgf_jax.render import movie


def frames(count: int, size=(64, 48)):
    """Frames that get brighter."""
    for i in range(count):
        yield np.full((size[1], size[0], 3), 10 * i, np.uint8)


@pytest.fixture
def ffmpeg():
    return pytest.importorskip("imageio_ffmpeg", reason="films need the extra `render`")


def test_a_picture_comes_back_as_it_was(tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (30, 40, 3)).astype(np.uint8)
    path = movie.write_picture(tmp_path / "new" / "a.png", picture)
    np.testing.assert_array_equal(np.array(Image.open(path)), picture)
    assert [p.name for p in path.parent.iterdir()] == ["a.png"]


def test_a_film_holds_its_frames(tmp_path, ffmpeg):
    path = tmp_path / "new" / "a.mp4"
    assert movie.write_film(path, frames(9), 12, total=9) == 9
    reader = ffmpeg.read_frames(str(path))
    about = next(reader)
    assert about["size"] == (64, 48) and about["fps"] == 12
    assert about["codec"] == "h264" and about["pix_fmt"].startswith("yuv420p")
    means = [np.frombuffer(frame, np.uint8).mean() for frame in reader]
    np.testing.assert_allclose(means, 10.0 * np.arange(9), atol=3)
    assert [p.name for p in path.parent.iterdir()] == ["a.mp4"]


def test_odd_sizes_lose_a_pixel():
    assert movie.even((641, 480)) == (640, 480) and movie.even((300, 201)) == (300, 200)


@pytest.mark.parametrize("total", [None, 20])
@pytest.mark.parametrize("error", [KeyboardInterrupt, BadInput("no more"), RuntimeError])
def test_an_interrupted_film_leaves_what_was_there(tmp_path, ffmpeg, error, total):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"an older film")

    def interrupted():
        yield from frames(3)
        raise error

    with pytest.raises(error if isinstance(error, type) else BadInput):
        movie.write_film(path, interrupted(), 10, total=total)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]
    assert path.read_bytes() == b"an older film"


@pytest.mark.parametrize(("count", "code"), [(0, 1), (2, 1), (30, 1), (30, 0)])
def test_an_encoder_that_fails_is_one_line(tmp_path, monkeypatch, count, code):
    program = tmp_path / "encoder"
    program.write_text(f"#!/bin/sh\necho no such codec >&2\nexit {code}\n")
    program.chmod(0o755)
    monkeypatch.setattr(movie, "_ffmpeg", lambda: str(program))
    expected = "no such codec" if count else "nothing to film"
    with pytest.raises(BadInput, match=expected) as caught:
        movie.write_film(tmp_path / "a.mp4", frames(count, (640, 480)), 10)
    assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["encoder"]


def test_a_place_that_cannot_be_written_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(movie, "_ffmpeg", lambda: "/bin/true")
    (tmp_path / "file").write_text("")
    for write in (
        lambda path: movie.write_film(path.with_suffix(".mp4"), frames(2), 10),
        lambda path: movie.write_picture(path.with_suffix(".png"), next(frames(1))),
    ):
        with pytest.raises(BadInput, match="cannot be written"):
            write(tmp_path / "file" / "a")


def test_without_the_package_films_say_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(BadInput, match=r"pip install 'pgf_jax\[render\]'"):
        movie.check_films()
