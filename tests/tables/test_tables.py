"""Files that are written whole or not at all."""

import os

import pytest

from pgf_jax.errors import BadInput
from pgf_jax.files import write_atomically


def test_a_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    path = tmp_path / "new" / "x"
    steps = []
    fsync, replace = os.fsync, os.replace

    def spy_fsync(descriptor):
        fsync(descriptor)
        target = os.readlink(f"/proc/self/fd/{descriptor}")
        steps.append(("folder", path.read_bytes()) if target == str(path.parent) else "content")

    def spy_replace(source, target):
        assert source.read_bytes() == b"abc" and source.name.startswith(".")
        steps.append("name")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", spy_fsync)
    monkeypatch.setattr(os, "replace", spy_replace)
    write_atomically(path, b"abc")
    assert steps == ["content", "name", ("folder", b"abc")]


@pytest.mark.parametrize("at", ["fsync", "replace"])
def test_what_was_there_stays_when_the_new_one_cannot_be_written(tmp_path, monkeypatch, at):
    path = tmp_path / "x"
    write_atomically(path, b"old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, at, full)
    with pytest.raises(BadInput, match=f"{path}: cannot be written .No space left on device."):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old" and [*tmp_path.iterdir()] == [path]
