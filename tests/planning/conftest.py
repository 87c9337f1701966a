import jax
import pytest


@pytest.fixture(autouse=True)
def strict_arrays():
    """No silent promotion of dtypes or ranks in what planning traces (mjx does both)."""
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        yield
