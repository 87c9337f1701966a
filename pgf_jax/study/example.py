"""Writes the example of a study: a folder that runs as it is, with comments on every entry."""

import shutil
from pathlib import Path

from pgf_jax.errors import BadInput
from pgf_jax.study.questionnaires import BUILT_IN

EXAMPLE = Path(__file__).parent / "template"


def write_example(folder: Path) -> None:
    """Write the example into a folder that does not exist yet, or is empty.

    Raises:
      BadInput: the folder holds something, or cannot be written.
    """
    try:
        if folder.exists() and any(folder.iterdir()):
            raise BadInput(f"{folder}: is not empty; expected a new folder")
        shutil.copytree(EXAMPLE, folder, dirs_exist_ok=True)
        shutil.copytree(BUILT_IN, folder / "questionnaires", dirs_exist_ok=True)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written: {error.strerror or error}") from None
