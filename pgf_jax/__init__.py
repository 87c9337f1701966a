"""Simulates fleets of robots that reach through clutter and share one human operator.

    import pgf_jax

    scene = pgf_jax.sample_scene(7, "tight")
    plan = pgf_jax.plan(0, scene, pgf_jax.PlanConfig(engine="native"))

Importing this package imports nothing else: each name is looked up in its module when it is first
used. The names stand here twice, once for type checkers and once for the look-up.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pgf_jax.collection.collect import collect as collect
    from pgf_jax.collection.config import CollectConfig as CollectConfig
    from pgf_jax.errors import BadInput as BadInput
    from pgf_jax.fleet.config import FleetConfig as FleetConfig
    from pgf_jax.fleet.policies import Discipline as Discipline
    from pgf_jax.fleet.policies import PolicyBase as PolicyBase
    from pgf_jax.fleet.policies import register_policy as register_policy
    from pgf_jax.guidance.operators.registry import register_operator as register_operator
    from pgf_jax.guidance.view import View as View
    from pgf_jax.inspection.config import VerifyConfig as VerifyConfig
    from pgf_jax.inspection.verify import verify as verify
    from pgf_jax.jax_setup import configure as configure
    from pgf_jax.physics.config import Physics as Physics
    from pgf_jax.physics.engine import Rollout as Rollout
    from pgf_jax.physics.engine import make_engine as make_engine
    from pgf_jax.physics.engine import register_engine as register_engine
    from pgf_jax.planning.types import Push as Push
    from pgf_jax.planning.types import Status as Status
    from pgf_jax.plans.config import ExecuteConfig as ExecuteConfig
    from pgf_jax.plans.config import PlanConfig as PlanConfig
    from pgf_jax.plans.execute import Execution as Execution
    from pgf_jax.plans.execute import execute as execute
    from pgf_jax.plans.file import Plan as Plan
    from pgf_jax.plans.file import load_plan as load_plan
    from pgf_jax.plans.file import save_plan as save_plan
    from pgf_jax.plans.plan import plan as plan
    from pgf_jax.scene.file import save_scene as save_scene
    from pgf_jax.scene.load import load_scene as load_scene
    from pgf_jax.scene.sampling import sample_scene as sample_scene
    from pgf_jax.scene.scene import Scene as Scene
    from pgf_jax.sweeping.config import SweepConfig as SweepConfig
    from pgf_jax.sweeping.load import load_sweep as load_sweep
    from pgf_jax.sweeping.sweep import sweep as sweep
    from pgf_jax.sweeping.sweep import sweeps as sweeps
    from pgf_jax.training.config import TrainConfig as TrainConfig
    from pgf_jax.training.train import train as train

_MODULES = {
    "BadInput": "errors",
    "CollectConfig": "collection.config",
    "Discipline": "fleet.policies",
    "ExecuteConfig": "plans.config",
    "Execution": "plans.execute",
    "FleetConfig": "fleet.config",
    "Physics": "physics.config",
    "Plan": "plans.file",
    "PlanConfig": "plans.config",
    "PolicyBase": "fleet.policies",
    "Push": "planning.types",
    "Rollout": "physics.engine",
    "Scene": "scene.scene",
    "Status": "planning.types",
    "SweepConfig": "sweeping.config",
    "TrainConfig": "training.config",
    "VerifyConfig": "inspection.config",
    "View": "guidance.view",
    "collect": "collection.collect",
    "configure": "jax_setup",
    "execute": "plans.execute",
    "load_plan": "plans.file",
    "load_scene": "scene.load",
    "load_sweep": "sweeping.load",
    "make_engine": "physics.engine",
    "plan": "plans.plan",
    "register_engine": "physics.engine",
    "register_operator": "guidance.operators.registry",
    "register_policy": "fleet.policies",
    "sample_scene": "scene.sampling",
    "save_plan": "plans.file",
    "save_scene": "scene.file",
    "sweep": "sweeping.sweep",
    "sweeps": "sweeping.sweep",
    "train": "training.train",
    "verify": "inspection.verify",
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
