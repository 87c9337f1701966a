"""Random numbers outside of JAX: an independent stream for each purpose and key."""

import numpy as np


def stream(seed: int, purpose: str, *key: int) -> np.random.Generator:
    """The random generator of (seed, purpose, key), independent of all others.

    Args:
      seed: not negative.
      purpose: what the numbers are for; its first 8 bytes count.
      *key: further numbers that name the stream, such as a robot and a task.
    """
    # SeedSequence pads with zeros, so the purpose, of fixed length, and the key's length go first.
    words = np.frombuffer(purpose.encode().ljust(8, b"\0")[:8], dtype="<u4")
    entropy = [*(int(word) for word in words), len(key), seed, *key]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(entropy)))
