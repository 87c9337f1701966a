import os

import pytest


@pytest.fixture(autouse=True)
def own_environment(monkeypatch, tmp_path):
    """Undo after each test what `main` sets in the environment of its process."""
    for name in (
        "NPROC",
        "JAX_COMPILATION_CACHE_DIR",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS",
    ):
        monkeypatch.setenv(name, os.environ.get(name, "1"))
