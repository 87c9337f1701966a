"""The order of conditions and scenes of each participant: a balanced Latin square.

In the orders of a square each condition comes as often first, second, ... as every other one, and
each follows each other one as often (Williams 1949). An odd number of conditions takes twice as
many orders.
"""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Block:
    """A block of a participant.

    Attributes:
      condition: its number, from 0.
      scenes: number of its set of scenes, from 0.
    """

    condition: int
    scenes: int


def balanced_orders(conditions: int) -> list[tuple[int, ...]]:
    """The orders of a balanced Latin square; as many as conditions, or twice as many if odd."""
    # 0, 1, n - 1, 2, n - 2, ...: the steps between neighbours are all different.
    first = [0]
    for step in range(1, conditions):
        first.append((step + 1) // 2 if step % 2 else conditions - step // 2)
    orders = [tuple((c + row) % conditions for c in first) for row in range(conditions)]
    if conditions % 2 and conditions > 1:
        orders += [order[::-1] for order in orders]
    return orders


def blocks_of(participant: int, conditions: int) -> tuple[Block, ...]:
    """The blocks of a participant.

    There are as many sets of scenes as conditions. The participants of a round have each order
    once, and from one round to the next each condition moves on to the next set. So every round
    is balanced over orders, and as many rounds as conditions are balanced over scenes too.

    Args:
      participant: number, from 0, in the order of arrival.
      conditions: how many.
    """
    orders = balanced_orders(conditions)
    turn, place = divmod(participant, len(orders))
    return tuple(Block(condition, (condition + turn) % conditions) for condition in orders[place])
