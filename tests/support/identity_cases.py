"""Records that are changed a little, and the identities that then fail."""

import dataclasses

from pgf_jax.fleet.event_calendar import nanoseconds
from pgf_jax.metrics.identities import identity_sides


def failing(config, records, events) -> set[str]:
    sides = identity_sides(config, records, events)
    return {name for name, (left, right) in sides.items() if left != right}


def altered(record, field):
    """Change a count by 1, or a time by 1 ns."""
    value = getattr(record, field)
    value = (nanoseconds(value) + 1) / 1e9 if isinstance(value, float) else value + 1
    return dataclasses.replace(record, **{field: value})
