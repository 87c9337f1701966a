"""The command line: the commands, their settings and the functions that run them.

Modules are imported late: parsing imports neither JAX nor MuJoCo nor Polars, so that help and bad
input answer at once. Bad input of every kind ends in one line on stderr and exit code 2.
"""

import dataclasses
import gc
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from pgf_jax.arguments import parse
from pgf_jax.errors import BadInput, WorkersLost, did_you_mean
from pgf_jax.jax_setup import configure_early

PROG = "pgf-jax"
LOST, BAD_INPUT, INTERRUPTED = 1, 2, 130


@dataclasses.dataclass(frozen=True)
class Command:
    """A command of the command line.

    Attributes:
      summary: its line in the list of commands.
      config: `module:Class` of its settings, imported to parse the arguments.
      run: runs the command with its settings; imports what it needs when it is called.
      engine: the engine that JAX is configured for where the settings name none.
    """

    summary: str
    config: str
    run: Callable[[Any], None]
    engine: str | None = None


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
      argv: arguments without the program's name; those of the process if None.

    Returns:
      The exit code: 0; 2 for bad input; 1 when the workers were lost, or who reads the output has
      gone; 130 when interrupted.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        return _main(arguments)
    except BadInput as error:
        return _fail(" ".join(str(error).splitlines()), BAD_INPUT)
    except WorkersLost as error:
        return _fail(str(error), LOST)
    except KeyboardInterrupt as error:
        return _fail(str(error) or "interrupted", INTERRUPTED)
    except BrokenPipeError:  # whoever read our output (`| head`) has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _main(arguments: list[str]) -> int:
    if arguments[:1] in (["-h"], ["--help"]):
        print(_help())
        return 0
    if arguments == ["--version"]:
        from importlib.metadata import version

        print(version("pgf_jax"))
        return 0
    if not arguments:
        print(_help(), file=sys.stderr)
    if not arguments or arguments[0] not in COMMANDS:
        got = "none"
        if arguments:
            known = [*COMMANDS, "--help", "--version"]
            got = f"{arguments[0]!r}{did_you_mean(arguments[0], known)}"
        raise BadInput(f"command: expected one of {', '.join(COMMANDS)}, got {got}")
    command = COMMANDS[arguments[0]]
    module, name = command.config.split(":")
    try:
        config = parse(
            getattr(importlib.import_module(module), name), arguments[1:], f"{PROG} {arguments[0]}"
        )
    except SystemExit as stop:  # help was printed
        return int(stop.code or 0)
    configure_early(getattr(getattr(config, "config", config), "engine", command.engine))
    gc.set_threshold(50_000)  # tracing makes much that stays; looking through it takes 0.4 s
    command.run(config)
    return 0


def _fail(message: str, code: int) -> int:
    print(f"{PROG}: {message}", file=sys.stderr)
    return code


def _help() -> str:
    width = max(map(len, COMMANDS))
    commands = (f"  {name:<{width}}  {command.summary}" for name, command in COMMANDS.items())
    return "\n".join(
        [
            f"usage: {PROG} COMMAND [OPTIONS]",
            "",
            "Simulates fleets of robots that reach through clutter and share one operator.",
            "",
            "commands:",
            *commands,
            "",
            f"{PROG} COMMAND --help lists a command's options.",
        ]
    )


# --- commands -----------------------------------------------------------------------------------


def _scene(command: Any) -> None:
    from pgf_jax.scene.command import run

    run(command)


def _plan(command: Any) -> None:
    from pgf_jax.plans.command import run

    run(command)


def _execute(command: Any) -> None:
    from pgf_jax.plans.execute_command import run

    run(command)


def _sweep(config: Any) -> None:
    from pgf_jax.sweeping.sweep import sweep

    try:
        sweep(config)
    except KeyboardInterrupt:
        raise SystemExit(INTERRUPTED) from None  # it has said what is kept


def _verify(config: Any) -> None:
    from pgf_jax.inspection.verify import run

    run(config)


def _reproduce(config: Any) -> None:
    from pgf_jax.inspection.reproduce import run

    run(config)


def _collect(config: Any) -> None:
    from pgf_jax.collection.command import run

    run(config)


def _train(command: Any) -> None:
    from pgf_jax.training.command import run

    run(command)


def _fit_operator(config: Any) -> None:
    from pgf_jax.operator_fit.command import fit_operator

    fit_operator(config)


def _render(config: Any) -> None:
    from pgf_jax.render.command import render

    print(render(config))


def _profile(config: Any) -> None:
    from pgf_jax.profiling.profile import profile

    profile(config)


def _console(config: Any) -> None:
    try:
        from pgf_jax.console.command import console
    except ModuleNotFoundError as error:
        raise _lacks("console", error) from None
    console(config)


def _lacks(command: str, error: ModuleNotFoundError) -> BadInput:
    return BadInput(
        f"{command}: needs {error.name}, expected an installation with it: "
        "pip install 'pgf_jax[console]'"
    )


def _study(config: Any) -> None:
    from pgf_jax.study.command import study

    try:
        study(config)
    except ModuleNotFoundError as error:  # only `serve` needs more, and imports it first
        raise _lacks("study", error) from None


COMMANDS = {
    "scene": Command(
        "check and draw scenes, or sample them into files",
        "pgf_jax.scene.config:SceneCommand",
        _scene,
    ),
    "plan": Command("plan scenes, and write the plans", "pgf_jax.plans.config:PlanCommand", _plan),
    "execute": Command(
        "execute plans in a world in 3-D: do they grasp?",
        "pgf_jax.plans.config:ExecuteCommand",
        _execute,
    ),
    "sweep": Command(
        "simulate fleets of several sizes under several policies",
        "pgf_jax.sweeping.config:SweepConfig",
        _sweep,
    ),
    "verify": Command(
        "check a sweep's results, and compute some cells again",
        "pgf_jax.inspection.config:VerifyConfig",
        _verify,
        "planar",
    ),
    "reproduce": Command(
        "compute one iteration of a sweep again: what its rollouts did",
        "pgf_jax.inspection.config:ReproduceConfig",
        _reproduce,
        "planar",
    ),
    "console": Command(
        "guide a fleet from a browser, in real time",
        "pgf_jax.console.config:ConsoleConfig",
        _console,
    ),
    "study": Command(
        "conduct a study with people: pages, orders, questionnaires",
        "pgf_jax.study.config:StudyConfig",
        _study,
    ),
    "collect": Command(
        "plan scenes, or replay sessions, for data to train on",
        "pgf_jax.collection.config:CollectConfig",
        _collect,
    ),
    "train": Command(
        "train the predictors on collected data",
        "pgf_jax.training.config:TrainCommand",
        _train,
    ),
    "fit-operator": Command(
        "fit the operator's service times to recorded sessions",
        "pgf_jax.operator_fit.config:FitOperatorConfig",
        _fit_operator,
    ),
    "profile": Command(
        "measure the engines' speed on this computer",
        "pgf_jax.profiling.config:ProfileConfig",
        _profile,
    ),
    "render": Command(
        "draw a plan, a task or a fleet, as a picture or a film",
        "pgf_jax.render.config:RenderConfig",
        _render,
        "planar",
    ),
}
