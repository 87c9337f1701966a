"""Runs the command line: `python -m pgf_jax` does what `pgf-jax` does."""

import sys

from pgf_jax.cli import main

if __name__ == "__main__":
    sys.exit(main())
