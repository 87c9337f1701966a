"""The protocol of physics engines, and the registry that finds engines by name.

Axes: B rollouts, T knots, N objects, C contact slots.
"""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from pgf_jax import cores
from pgf_jax.errors import BadInput, short_repr
from pgf_jax.physics.config import Physics
from pgf_jax.plugins.registry import Registry, caller

Array = Any  # numpy or JAX array: engines take and return either


def contact_slots(n_objects: int) -> int:
    """C, contact slots of every engine's rollouts of N objects.

    No published scene, of 20 objects, had more than 20 simultaneous contacts. `mjx` drops the
    contacts beyond C. `native` and `planar` solve all of them, but report only C (`planar`: the
    strongest), so that the others do not count in the cost.
    """
    return 24 + 3 * max(0, n_objects - 20) // 2


class World(NamedTuple):
    """The physical state that a rollout starts from."""

    objects: Array  # [B, N, 2] centres, m
    velocities: Array  # [B, N, 2] m/s
    hand: Array  # [B, 3] base x, y (m) and yaw (rad)
    gripper: Array  # [B] 0 open .. 255 closed


class Rollout(NamedTuple):
    """Result of a rollout: states at knot ends, and the contacts of each knot's last substep.

    A contact's bodies are 0..N-1 an object, N the hand, N+1 a wall; empty slots have zero force.
    """

    objects: Array  # [B, T, N, 2] centres at knot ends, m
    hand: Array  # [B, T, 3] hand poses at knot ends
    velocities: Array  # [B, N, 2] object velocities at the end, m/s
    force: Array  # [B, T, C] magnitude of each contact's force (normal and friction), N
    bodies: Array  # [B, T, C, 2] int32, the two bodies of each contact


class Engine(Protocol):
    """Rolls out velocity controls of the hand through the planar world.

    An engine may have two more methods, for figures of what its calls did since they were last
    asked: `occupancy() -> (int, int)`, lanes of work used and computed, and `flops() -> float`,
    floating-point operations computed (`physics/flops.py` counts those of a function).

    Attributes:
      name: as registered.
      physics: the constants it simulates.
      n_objects: N, fixed at construction.
      lanes: L, the number of robots in one call (each with K rollouts); for equal L a robot's
        results are bit-equal whatever the other lanes hold.
    """

    name: str
    physics: Physics
    n_objects: int
    lanes: int

    def rollout(
        self,
        start: World,
        controls: Array,
        gripper: Array,
        substeps: int,
        wanted: Array | None = None,
    ) -> Rollout:
        """Roll out from `start`.

        An engine that takes one more argument, `shelf`, simulates any objects; it gets a `Shelf`
        with [B] in front of each array, or None where all are standard. Others are refused scenes
        that are not standard.

        Args:
          start: [B] worlds.
          controls: [B, T, 3] hand velocity of each knot along the world axes (m/s, m/s, rad/s).
          gripper: [B, T] gripper value that each knot moves to, linearly within the knot.
          substeps: physics substeps per knot.
          wanted: [B] bool, rollouts to compute (None: all). An engine may leave out the others,
            such as a batch's padding; their results have no meaning.

        Returns:
          The rollout; non-finite positions mark one that diverged.
        """
        ...


ENGINES: Registry[Callable[..., Engine]] = Registry(
    "engine",
    {
        "mjx": "pgf_jax.physics.mjx:MjxEngine",
        "native": "pgf_jax.physics.native:NativeEngine",
        "planar": "pgf_jax.physics.planar.engine:PlanarEngine",
        "solid": "pgf_jax.physics.worlds.engine:SolidEngine",
    },
    # 2: each pair of objects once, sums in another order; objects at rest sleep between knots.
    revisions={"planar": 2},
)


def register_engine(
    name: str, make: Callable[..., Engine], *, version: str | None = None, replace: bool = False
) -> None:
    """Register an engine under a name, by which settings ask for it.

    Results are named by the source of the package that registers it. So changed code computes its
    cells again.

    Args:
      name: of the engine.
      make: called as `make(physics, n_objects, lanes=..., **options)`; returns an `Engine`.
      version: stands for the source where that cannot be seen; raise it when results change.
      replace: take the place of the engine that has this name.

    Raises:
      BadInput: the name is taken; or neither a source nor a version is there.
    """
    ENGINES.register(name, make, caller=caller(), version=version, replace=replace)


def engine_names() -> list[str]:
    """Names of all registered engines, the built-in ones first."""
    return ENGINES.names()


def check_engine(name: str) -> None:
    """BadInput unless an engine of that name is registered."""
    ENGINES.check(name)


# L is a constant of an engine, because `mjx` rounds differently at another L. C MuJoCo rolls out
# one by one and gains nothing from a larger call, which would only pad more; `planar` computes no
# padding, and fills its chunks better from a larger call.
_LANES = {"mjx": 8, "native": 1, "planar": 64, "solid": 1}
_OTHER_LANES = 8


def default_lanes(engine: str) -> int:
    """L where none is given: robots in one call of the engine."""
    return _LANES.get(engine, _OTHER_LANES)


def calls_use_one_core(engine: str) -> bool:
    """Whether a call of the engine computes on one core, so that several may run side by side."""
    return engine == "planar"


def default_processes(engine: str) -> int:
    """Workers where no number is given: one a core, unless the engine's calls use all cores."""
    return len(cores.usable()) if calls_use_one_core(engine) else 1


def takes_shelves(engine: Engine) -> bool:
    """Whether an engine simulates shelves that are not standard, see `Engine.rollout`."""
    return "shelf" in inspect.signature(engine.rollout).parameters


def choice(engine: str, option: str, value: str, choices: Mapping[str, Any]) -> Any:
    """Return `choices[value]`; raise BadInput that names the engine's option if it has none."""
    if value not in choices:
        expected = ", ".join(choices)
        raise BadInput(f"engine {engine}: {option} must be one of {expected}, got {value!r}")
    return choices[value]


def make_engine(
    name: str, *, physics: Physics | None = None, n_objects: int = 20, lanes: int = 1, **options
) -> Engine:
    """Build the engine of a name.

    Args:
      name: `planar`, `native`, `mjx` or another registered name.
      physics: the planar world's constants; the default ones if None.
      n_objects: N, the number of movable objects in every scene.
      lanes: L, robots per call.
      **options: the engine's own (solver, iterations, threads ...).

    Raises:
      BadInput: no engine of that name, or a size that is not positive.
    """
    make = ENGINES.make(name)
    if n_objects < 1 or lanes < 1:
        raise BadInput(
            f"engine {name}: n_objects and lanes must be positive, got {n_objects}, {lanes}"
        )
    engine = make(physics or Physics(), n_objects, lanes=lanes, **options)
    missing = [a for a in ("rollout", "physics", "n_objects", "lanes") if not hasattr(engine, a)]
    if missing:
        raise BadInput(f"engine {name!r}: {short_repr(engine)} has no {missing[0]}, see Engine")
    return engine
