"""Random numbers outside of JAX: a stream of its own for every purpose and key."""

import numpy as np


def stream(seed: int, purpose: str, *key: int) -> np.random.Generator:
    """A generator of its own for (seed, purpose, key), independent of every other one."""
    # SeedSequence pads a short key with zeros, so the purpose, fixed in length, goes first.
    words = np.frombuffer(purpose.encode().ljust(8, b"\0")[:8], dtype="<u4")
    entropy = [*(int(word) for word in words), len(key), seed, *key]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(entropy)))
