"""The command `pgf-jax plan`: plans scenes, writes the plans and shows a table."""

from pathlib import Path

from pgf_jax.errors import BadInput
from pgf_jax.plans.config import PlanCommand
from pgf_jax.plans.file import Plan, save_plan
from pgf_jax.plans.plan import iter_plans
from pgf_jax.scene import load_scene, sample_scene
from pgf_jax.terminal import Progress, show_table


def run(command: PlanCommand) -> None:
    """Plan the scenes, write the plans, show a table.

    Raises:
      BadInput: a scene or a setting cannot be used, or a plan cannot be written.
    """
    seeds = range(command.seed, command.seed + command.count)
    if command.scene_class is not None:
        scenes = [(sample_scene(seed, command.scene_class), seed) for seed in seeds]
    else:
        scenes = [(load_scene(path), command.seed) for path in command.scene]
    names = [scene.name for scene, _ in scenes]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"--scene: expected scenes of different names, got {name} twice")
    if command.out is not None:
        _make_folder(command.out)

    plans: dict[int, Plan] = {}
    with Progress("scenes", every_s=None) as progress:
        progress.update(0, len(scenes))
        for i, plan in iter_plans(scenes, command.config):
            plans[i] = plan
            if command.out is not None:
                save_plan(command.out, plan)
            progress.update(len(plans), len(scenes))
    _show_plans([plans[i] for i in range(len(scenes))], command)


def _show_plans(plans: list[Plan], command: PlanCommand) -> None:
    rows = [
        (
            plan.scene.name,
            str(plan.status),
            str(plan.iterations),
            f"{plan.planning_time_s:.1f}",
            f"{plan.cost['total']:.2f}",
            str(plan.pushes),
        )
        for plan in plans
    ]
    show_table(("scene", "status", "iterations", "planning time (s)", "cost", "pushes"), rows)
    config = command.config
    solved = sum(plan.solved for plan in plans)
    where = "" if command.out is None else f"; plans in {command.out}"
    print(
        f"{solved} of {len(plans)} solved; engine {config.engine}, physics {config.physics}, "
        f"lanes {config.lanes}{where}"
    )


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"--out {path}: expected a folder to write to ({error.strerror})") from None
