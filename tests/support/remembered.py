"""Rollouts of C MuJoCo that a module's tests ask for again and again: each computed once."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from pgf_jax.physics.engine import Rollout, World, contact_slots
from pgf_jax.physics.native import NativeEngine

AGAIN = 8  # every so many that are remembered are computed all the same: they must be equal
_rollout = NativeEngine.rollout


@contextmanager
def remembered_rollouts() -> Iterator[None]:
    """Within it every engine `native` of this process has the memory of all of them.

    A rollout depends on its own start and controls alone, whatever shares the call and however many
    threads there are (`test_physics_native.py`); what is remembered is compared now and then.
    """
    kept: dict[tuple, list[np.ndarray]] = {}
    recalled = 0

    def rollout(self, start, controls, gripper, substeps, wanted=None, shelf=None) -> Rollout:
        nonlocal recalled
        assert shelf is None, "remembered are rollouts on standard shelves"
        start = World(*(np.asarray(x, np.float64) for x in start))
        controls, gripper = np.asarray(controls, np.float64), np.asarray(gripper, np.float64)
        wanted = np.ones(len(controls), bool) if wanted is None else np.array(wanted, bool)
        options = self._model.opt
        engine = (
            self.physics,
            self.n_objects,
            substeps,
            *(options.solver, options.jacobian, options.iterations, options.tolerance),
            *(options.enableflags, options.disableflags),
        )
        keys = {
            int(i): (engine, *(x[i].tobytes() for x in (*start, controls, gripper)))
            for i in np.flatnonzero(wanted)
        }
        compute = np.zeros(len(controls), bool)
        for i, key in keys.items():
            recalled += key in kept
            compute[i] = key not in kept or recalled % AGAIN == 0
        (b, t), n, c = gripper.shape, self.n_objects, contact_slots(self.n_objects)
        out = Rollout(
            objects=np.full((b, t, n, 2), np.nan),
            hand=np.full((b, t, 3), np.nan),
            velocities=np.full((b, n, 2), np.nan),
            force=np.zeros((b, t, c)),
            bodies=np.zeros((b, t, c, 2), np.int32),
        )
        if compute.any():
            fresh = _rollout(self, start, controls, gripper, substeps, compute)
            for i in np.flatnonzero(compute):
                now = [x[i].copy() for x in fresh]
                for ours, theirs in zip(kept.setdefault(keys[int(i)], now), now, strict=True):
                    np.testing.assert_array_equal(ours, theirs)
        for i, key in keys.items():
            for whole, one in zip(out, kept[key], strict=True):
                whole[i] = one
        return out

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NativeEngine, "rollout", rollout)
        yield


@contextmanager
def computed_rollouts() -> Iterator[None]:
    """Within it every rollout is computed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NativeEngine, "rollout", _rollout)
        yield
