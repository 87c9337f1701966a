"""Registers objects for the time of a test."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from pgf_jax.plugins.registry import Caller, Registry


@contextlib.contextmanager
def registered(registry: Registry[Any], **makes: Callable[..., Any]) -> Iterator[None]:
    """Names and what makes their objects; they are gone afterwards."""
    for name, make in makes.items():
        registry.register(name, make, caller=Caller(__name__, __file__), version="1", replace=True)
    try:
        yield
    finally:
        for name in makes:
            registry.unregister(name)
