"""How much small fleets lose by ranking robots instead of solving for the best policy exactly.

    python experiments/index_optimality.py [--instances 200]

Every task is of a type k: alone it takes an exponential time of rate lambda_k, an operator's answer
solves it and takes an exponential time of rate mu_k. The types are seen, a service that has begun
is not broken off, the robot plans meanwhile, and where it is solved first the operator is free. In
a stream a robot that is solved begins a new task, of a type drawn at random: the value is tasks
solved per second, so by Little's law the mean time in the task. In a batch it is done: the cost is
the sum of all times in the task. Both are solved by dynamic programming.
"""

import dataclasses
import functools
import itertools

import numpy as np
import tyro

from pgf_jax.streams import stream
from pgf_jax.terminal import show_table

Counts = tuple[int, ...]  # robots of each type


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    instances: int = 200  # for each fleet size
    robots: tuple[int, ...] = (2, 3, 4, 5, 6)
    types: int = 3
    seed: int = 0


@dataclasses.dataclass(frozen=True, eq=False)
class Instance:
    """Types of tasks.

    Attributes:
      alone: [K] lambda, 1/s.
      service: [K] mu, 1/s.
      share: [K] probability of each type.
    """

    alone: np.ndarray
    service: np.ndarray
    share: np.ndarray

    def ranked(self, name: str) -> list[int]:
        """Types in the order in which a policy serves them, by its formula for such times."""
        rate, mu = self.alone, self.service
        value = {
            "time-saved": mu / (rate * (rate + mu)),  # P(T > S) E[T - S | T > S]
            "gain-rate": mu / rate,
            "urgency": mu - rate,
            "shortest service": mu,
        }[name]
        return np.argsort(-value, kind="stable").tolist()


POLICIES = ("time-saved", "gain-rate", "urgency", "shortest service")


def instance_of(types: int, seed: int, *key: int) -> Instance:
    """Draw one: mean times alone of 5 to 200 s, mean services of 3 to 30 s."""
    draw = stream(seed, "instance", *key)
    alone = 1 / np.exp(draw.uniform(np.log(5), np.log(200), types))
    service = 1 / np.exp(draw.uniform(np.log(3), np.log(30), types))
    share = draw.dirichlet(np.ones(types))
    return Instance(alone, service, share)


def _without(counts: Counts, k: int) -> Counts:
    return (*counts[:k], counts[k] - 1, *counts[k + 1 :])


def _with(counts: Counts, k: int) -> Counts:
    return (*counts[:k], counts[k] + 1, *counts[k + 1 :])


# --- a stream -----------------------------------------------------------------------------------


class Stream:
    """A fleet whose robots always have a task; a policy says whom a free operator serves.

    A policy is a mapping from the counts of robots to a type, or None to serve nobody.
    """

    def __init__(self, instance: Instance, robots: int) -> None:
        self.instance, self.types = instance, len(instance.alone)
        self.counts = [
            c for c in itertools.product(range(robots + 1), repeat=self.types) if sum(c) == robots
        ]
        served = [None, *range(self.types)]
        self.states = [(c, s) for c in self.counts for s in served if s is None or c[s] > 0]
        self.number = {state: i for i, state in enumerate(self.states)}

    def events(self, counts: Counts, served: int | None):
        """(rate, type that is solved, whether the operator is free then) of what may happen."""
        alone, service = self.instance.alone, self.instance.service
        for k, count in enumerate(counts):
            others = count - (k == served)
            if others:
                yield others * alone[k], k, served is None
        if served is not None:
            yield alone[served] + service[served], served, True

    def solve(self, policy) -> tuple[float, np.ndarray]:
        """Tasks solved per second, and the relative values of the states."""
        size = len(self.states)
        matrix, reward = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
        for i, (counts, served) in enumerate(self.states):
            for rate, k, free in self.events(counts, served):
                reward[i] += rate
                matrix[i, i] -= rate
                for j, share in enumerate(self.instance.share):
                    after = _with(_without(counts, k), j)
                    state = (after, policy[after] if free else served)
                    matrix[i, self.number[state]] += rate * share
            matrix[i, size] = -1.0  # the gain
        matrix[size, 0] = 1.0  # values are relative to the first state's
        solution = np.linalg.solve(matrix, -reward)
        return float(solution[size]), solution[:size]

    def by_order(self, order: list[int]) -> dict:
        """The policy that serves the first type in an order of which there is a robot."""
        return {c: next((k for k in order if c[k]), None) for c in self.counts}

    def best(self) -> float:
        """Tasks solved per second under the best policy, by policy iteration."""
        policy = self.by_order(list(range(self.types)))
        while True:
            gain, values = self.solve(policy)
            better = {}
            for c in self.counts:
                choices = [s for s in (None, *range(self.types)) if s is None or c[s] > 0]
                value = [values[self.number[c, s]] for s in choices]
                now = values[self.number[c, policy[c]]]
                top = int(np.argmax(value))
                better[c] = choices[top] if value[top] > now + 1e-9 else policy[c]
            if better == policy:
                return gain
            policy = better


# --- a batch ------------------------------------------------------------------------------------


def batch_cost(instance: Instance, start: Counts, order: list[int] | None) -> float:
    """Expected sum of all times in the task; `order`: of types, None: the best policy."""
    alone, service = instance.alone, instance.service

    @functools.cache
    def free(counts: Counts) -> float:
        """The cost to go when the operator is free."""
        if not sum(counts):
            return 0.0
        if order is not None:
            return serving(counts, next(k for k in order if counts[k]))
        # Serving nobody is never better here: an operator is free again no later than the robot.
        return min(serving(counts, k) for k, count in enumerate(counts) if count)

    @functools.cache
    def serving(counts: Counts, served: int) -> float:
        """The cost to go while a type is served."""
        total, cost = alone[served] + service[served], float(sum(counts))
        cost += (alone[served] + service[served]) * free(_without(counts, served))
        for k, count in enumerate(counts):
            others = count - (k == served)
            if others:
                total += others * alone[k]
                cost += others * alone[k] * serving(_without(counts, k), served)
        return cost / total

    return free(start)


def losses(instance: Instance, robots: int, start: Counts) -> dict[str, tuple[float, float]]:
    """Of each policy: loss against the best one in a stream and in a batch, as shares."""
    fleet = Stream(instance, robots)
    best = fleet.best(), batch_cost(instance, start, None)
    out = {}
    for name in POLICIES:
        order = instance.ranked(name)
        gain, _ = fleet.solve(fleet.by_order(order))
        out[name] = (1 - gain / best[0], batch_cost(instance, start, order) / best[1] - 1)
    return out


def main(config: Config) -> None:
    """Draw instances, solve them and print the losses."""
    rows = []
    for robots in config.robots:
        found = []
        for number in range(config.instances):
            instance = instance_of(config.types, config.seed, robots, number)
            draw = stream(config.seed, "start", robots, number)
            drawn = draw.multinomial(robots, instance.share)
            found.append(losses(instance, robots, tuple(int(n) for n in drawn)))
        for name in POLICIES:
            both = 100 * np.array([one[name] for one in found])
            rows.append(
                (
                    str(robots),
                    name,
                    *(f"{both[:, i].mean():.2f}, {both[:, i].max():.1f}" for i in (0, 1)),
                )
            )
    headings = ("robots", "policy", "stream: mean, most %", "batch: mean, most %")
    show_table(headings, rows)


if __name__ == "__main__":
    main(tyro.cli(Config))
