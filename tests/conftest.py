import os
from pathlib import Path

import pytest

from pgf_jax import configure
from pgf_jax.jax_setup import VARIABLES

# Workers of pytest that share a machine; one alone has all of it.
SEVERAL = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")) > 1
configure("planar" if SEVERAL else None)  # also for the processes that tests start

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


@pytest.fixture(autouse=True)
def own_environment():
    """Undo after each test what a command sets in the environment of its process."""
    before = {name: os.environ.get(name) for name in VARIABLES}
    yield
    for name, value in before.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value


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
