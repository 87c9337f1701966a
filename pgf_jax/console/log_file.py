"""The log of a server: what clients do, and what was refused."""

import logging
from pathlib import Path

from rich.console import Console
from rich.logging import RichHandler


def log_to(path: Path, name: str, *, terminal: bool = False) -> None:
    """Log to a file.

    Args:
      path: of the file.
      name: of the logger, such as `pgf_jax.console`.
      terminal: whether warnings go to the terminal too.
    """
    logger = logging.getLogger(name)
    logger.setLevel(logging.INFO)
    file = logging.FileHandler(path)
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    logger.addHandler(file)
    if terminal:
        console = Console(stderr=True)
        logger.addHandler(RichHandler(level=logging.WARNING, console=console, show_path=False))
    # A malformed message ends a task of the server, which logs it; a line in the file is enough.
    for server in ("asyncio", "websockets.server"):
        other = logging.getLogger(server)
        other.addHandler(file)
        other.propagate = False
