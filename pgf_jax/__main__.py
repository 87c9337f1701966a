"""`python -m pgf_jax` is `pgf-jax`."""

import sys

from pgf_jax.cli import main

if __name__ == "__main__":
    sys.exit(main())
