import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def published_models() -> Path:
    """The folder of the published scenes: data to test on, not part of the project."""
    authors = os.environ.get("PGF_AUTHORS", REPOSITORY.parent / "shared" / "pgf_authors")
    models = Path(authors) / "models"
    if not models.is_dir():
        pytest.skip(f"no published scenes at {models} (PGF_AUTHORS names their folder)")
    return models
