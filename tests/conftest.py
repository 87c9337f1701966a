import os
from pathlib import Path

import pytest

# Before anything imports jax, and as environment, so that processes which tests start use it too.
_CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "pgf_jax" / "tests"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(_CACHE))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# Workers of pytest that share a machine; one alone has all of it.
SEVERAL = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")) > 1
if SEVERAL:
    os.environ.setdefault("NPROC", "1")  # XLA's threads, as `pgf-jax` sets it

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def authors() -> Path:
    """The authors' published data: to test on, not part of the project."""
    folder = Path(os.environ.get("PGF_AUTHORS", REPOSITORY.parent / "shared" / "pgf_authors"))
    if not folder.is_dir():
        pytest.skip(f"no published data at {folder} (PGF_AUTHORS names their folder)")
    return folder


@pytest.fixture(scope="session")
def mjx_engine():
    """The engine `mjx` for 2 lanes of 8 rollouts, one for all tests: it takes long to compile."""
    from pgf_jax.physics.engine import make_engine

    return make_engine("mjx", lanes=2)


@pytest.fixture(scope="session", autouse=True)
def one_thread_each():
    """Beside other workers of pytest, C MuJoCo has one thread: two would wait for each other."""
    if not SEVERAL:
        yield
        return
    from pgf_jax.physics import native

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "usable", lambda: [0])
        yield


@pytest.fixture(scope="module")
def remembered_rollouts():
    """In a module that uses it, each rollout of C MuJoCo is computed once: see `remembered.py`."""
    from remembered import remembered_rollouts

    with remembered_rollouts():
        yield


@pytest.fixture
def computed_rollouts():
    """In a test that uses it all the same, all are computed."""
    from remembered import computed_rollouts

    with computed_rollouts():
        yield
