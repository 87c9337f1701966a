"""Throughput studies of one human guiding a fleet of robots that reach through clutter.

    import pgf_jax

    scene = pgf_jax.sample_scene(7, "tight")
    plan = pgf_jax.plan(0, scene, pgf_jax.PlanConfig(engine="native"))

Importing this imports nothing else: each name below is looked up in its module when it is first
used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pgf_jax.errors import BadInput as BadInput
    from pgf_jax.fleet.config import FleetConfig as FleetConfig
    from pgf_jax.guidance.train_config import TrainConfig as TrainConfig
    from pgf_jax.guidance.training import train as train
    from pgf_jax.physics.config import Physics as Physics
    from pgf_jax.physics.engine import make_engine as make_engine
    from pgf_jax.planning.types import Push as Push
    from pgf_jax.planning.types import Status as Status
    from pgf_jax.scene.mjcf import load_scene as load_scene
    from pgf_jax.scene.sampling import sample_scene as sample_scene
    from pgf_jax.scene.scene import Scene as Scene
    from pgf_jax.study.collect import collect as collect
    from pgf_jax.study.collect_config import CollectConfig as CollectConfig
    from pgf_jax.study.plan import plan as plan
    from pgf_jax.study.plan_config import PlanConfig as PlanConfig
    from pgf_jax.study.plan_file import Plan as Plan
    from pgf_jax.study.plan_file import load_plan as load_plan
    from pgf_jax.study.plan_file import save_plan as save_plan
    from pgf_jax.study.sweep import sweep as sweep
    from pgf_jax.study.sweep import sweeps as sweeps
    from pgf_jax.study.sweep_config import SweepConfig as SweepConfig
    from pgf_jax.study.verify import verify as verify
    from pgf_jax.study.verify_config import VerifyConfig as VerifyConfig

_MODULES = {
    "BadInput": "errors",
    "CollectConfig": "study.collect_config",
    "FleetConfig": "fleet.config",
    "Physics": "physics.config",
    "Plan": "study.plan_file",
    "PlanConfig": "study.plan_config",
    "Push": "planning.types",
    "Scene": "scene.scene",
    "Status": "planning.types",
    "SweepConfig": "study.sweep_config",
    "TrainConfig": "guidance.train_config",
    "VerifyConfig": "study.verify_config",
    "collect": "study.collect",
    "load_plan": "study.plan_file",
    "load_scene": "scene.mjcf",
    "make_engine": "physics.engine",
    "plan": "study.plan",
    "sample_scene": "scene.sampling",
    "save_plan": "study.plan_file",
    "sweep": "study.sweep",
    "sweeps": "study.sweep",
    "train": "guidance.training",
    "verify": "study.verify",
}

__all__ = list(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("pgf_jax")
    if name not in _MODULES:
        raise AttributeError(f"module 'pgf_jax' has no attribute {name!r}")
    return getattr(importlib.import_module(f"pgf_jax.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_MODULES])
