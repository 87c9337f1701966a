"""The command line: one frozen config a command, parsed by tyro, run with late imports.

Parsing imports neither JAX nor MuJoCo nor Polars, so that help and bad input answer at once. Bad
input of every kind ends in one line on stderr and exit code 2.
"""

import contextlib
import dataclasses
import importlib
import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro import _errors as tyro_errors

from pgf_jax.errors import BadInput, WorkersLost
from pgf_jax.training.config import TrainConfig

if TYPE_CHECKING:
    from pgf_jax.collection.config import CollectConfig
    from pgf_jax.console.config import ConsoleConfig

PROG = "pgf-jax"
LOST, BAD_INPUT, INTERRUPTED = 1, 2, 130


@dataclasses.dataclass(frozen=True)
class TrainCommand:
    """Train phi_auto and phi_human on collected runs, early-stopped on scenes held out.

    Attributes:
      data: folder with autonomous/runs.parquet and human/runs.parquet, as `collect` writes it.
      out: folder for the two checkpoints and the figure of their losses.
      config: settings.
    """

    data: Path
    out: Path
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = dataclasses.field(
        default_factory=TrainConfig
    )


@dataclasses.dataclass(frozen=True)
class Command:
    """A subcommand.

    Attributes:
      summary: its line in the list of commands.
      config: `module:Class` of its settings; imported to parse its arguments.
      run: takes the settings; imports what it needs when it runs.
    """

    summary: str
    config: str
    run: Callable[[Any], None]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
      argv: arguments without the program's name; those of the process if None.

    Returns:
      The exit code: 0, 2 for bad input, 1 when what computes was lost, 130 when interrupted.
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
    if not arguments or arguments[0] not in COMMANDS:
        got = repr(arguments[0]) if arguments else "none"
        raise BadInput(f"command: expected one of {', '.join(COMMANDS)}, got {got}")
    command = COMMANDS[arguments[0]]
    module, name = command.config.split(":")
    try:
        config = _parse(getattr(importlib.import_module(module), name), arguments)
    except SystemExit as stop:  # help was printed
        return int(stop.code or 0)
    _keep_compiled()
    _one_thread(config)
    command.run(config)
    return 0


def _one_thread(config: Any) -> None:
    """Keep XLA from starting threads for `planar`, whose short kernels only wait for them.

    It reads the number as it starts. With the threads of two cores, calls take half as long again.
    """
    if getattr(getattr(config, "config", config), "engine", None) == "planar":
        os.environ.setdefault("NPROC", "1")


def _parse(config: type, arguments: list[str]) -> Any:
    """Parse the arguments of a command; BadInput of one line in place of tyro's box."""
    prog, box = f"{PROG} {arguments[0]}", io.StringIO()

    def reject(event: tyro_errors.ParseErrorEvent) -> None:
        message = _rejection(event, prog)
        if message is not None:
            raise BadInput(message)

    try:
        with contextlib.redirect_stderr(box), tyro_errors.on_parse_error(reject):
            return tyro.cli(config, prog=prog, args=arguments[1:])
    except BadInput as error:
        raise BadInput(_as_flag(str(error))) from None
    except (AssertionError, OSError, ValueError) as error:  # tyro's own options, of completions
        raise BadInput(f"arguments: {error}") from None
    except SystemExit as stop:
        if stop.code:  # an event of a kind that is not known here: tyro's own words
            words = " ".join(
                re.sub(r"[^\w\s.,:;'\"()<>=/-]|-{2,}(?!\w)", " ", box.getvalue()).split()
            )
            raise BadInput(f"arguments: {words}") from None
        raise


def _rejection(event: tyro_errors.ParseErrorEvent, prog: str) -> str | None:
    """One line for what tyro rejects.

    tyro's hook is private to it; its public way is a drawn box, wrapped to the terminal's width.
    """
    see = f"(see {prog} --help)"
    match event:
        case tyro_errors.UnrecognizedArgs(tokens=tokens):
            return f"unrecognized options: {' '.join(tokens)} {see}"
        case tyro_errors.MissingArgs(missing_arguments=missing):
            return f"options missing: {', '.join(m.arg.display_name() for m in missing)} {see}"
        case tyro_errors.InvalidChoice(argument=argument, value=value, choices=choices):
            # The choices of an option that may be None come in another order each time.
            expected = ", ".join(sorted({*choices} - {"None"}))
            return f"{argument.display_name()}: expected one of {expected}, got {value!r}"
        case tyro_errors.BadValue(argument=argument, offending_value=None):
            return f"{argument.display_name()}: expected a value, got none {see}"
        case tyro_errors.InstantiationFailure(message=message, argument=None):
            return message
        case tyro_errors.InstantiationFailure(message=message, argument=argument) if argument:
            for theirs, ours in _WORDS.items():
                message = message.replace(theirs, ours)
            return f"{argument.display_name()}: {message}"
    return None


_WORDS = {
    "invalid literal for int() with base 10:": "expected a whole number, got",
    "could not convert string to float:": "expected a number, got",
}


def _as_flag(message: str) -> str:
    """`task_limit: ...`, as settings call it, is `--task-limit: ...` to who typed it."""
    return re.sub(r"^([a-z][a-z_]*)(?=: | must )", lambda m: "--" + m[1].replace("_", "-"), message)


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
            "One human guiding a fleet of robots that reach through clutter: planning and studies.",
            "",
            "commands:",
            *commands,
            "",
            f"{PROG} COMMAND --help lists a command's options.",
        ]
    )


def _keep_compiled() -> None:
    """Keep compiled programs between calls, in processes that are started from here too.

    By environment, and so before JAX is imported; what the user has set stays.
    """
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path.home() / ".cache" / "pgf_jax"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")


# --- commands -----------------------------------------------------------------------------------


def _plan(command: Any) -> None:
    from pgf_jax.plans.command import run

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


def _collect(config: "CollectConfig") -> None:
    from pgf_jax.collection.collect import collect
    from pgf_jax.terminal import Progress, clock, show_table

    try:
        with Progress("tasks" if config.log else "scenes") as progress:
            done = collect(config, on_progress=progress.update)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            "interrupted; nothing was written"
            if config.log
            else "interrupted; the runs that had ended are kept, and --resume goes on from them"
        ) from None
    mix = ", ".join(f"{count} {name}" for name, count in done.by_class.items())
    show_table(
        ("tasks" if config.log else "scenes", "with data", "of", "solved", "iterations", "inputs"),
        [
            (
                *(str(count) for count in (done.scenes, done.runs)),
                mix,
                *(str(count) for count in (done.solved, done.iterations, done.inputs)),
            )
        ],
    )
    how = f"engine {config.engine}, lanes {config.lanes}"
    if config.log:
        how = f"tasks cut off by the end of their session, left out: {done.cut_off}"
    print(f"{done.path}; {how}, {clock(done.seconds)}")


def _train(command: TrainCommand) -> None:
    from pgf_jax.terminal import show_table
    from pgf_jax.training.train import train

    report = train(command.data, command.out, command.config)
    networks = [name for name in report if name != "files"]
    counts = ("runs", "scenes", "rows", "non_finite", "short", "epochs", "best_epoch")
    figures = ("loss_train", "loss_val", "target_std_val")  # in units of the target
    rows = [(name, *(str(report[network][name]) for network in networks)) for name in counts]
    rows += [(name, *(f"{report[network][name]:.2f}" for network in networks)) for name in figures]
    show_table(("", *networks), rows)
    print("\n".join(report["files"]))


def _fit_operator(config: Any) -> None:
    from pgf_jax.operator_fit.command import fit_operator

    fit_operator(config)


def _render(config: Any) -> None:
    os.environ.setdefault("NPROC", "1")  # a plan's one rollout keeps no second thread busy
    from pgf_jax.render.command import render

    print(render(config))


def _profile(config: Any) -> None:
    from pgf_jax.profiling.profile import profile

    profile(config)


def _console(config: "ConsoleConfig") -> None:
    try:
        from pgf_jax.console.command import console
    except ModuleNotFoundError as error:
        raise BadInput(
            f"console: needs {error.name}, expected an installation with it: "
            "pip install 'pgf_jax[console]'"
        ) from None
    console(config)


COMMANDS = {
    "plan": Command("plan scenes, and write the plans", "pgf_jax.plans.config:PlanCommand", _plan),
    "sweep": Command(
        "simulate fleets under several policies and sizes",
        "pgf_jax.sweeping.config:SweepConfig",
        _sweep,
    ),
    "verify": Command(
        "check a sweep's results, and compute some of its cells again",
        "pgf_jax.inspection.config:VerifyConfig",
        _verify,
    ),
    "reproduce": Command(
        "compute one iteration of a sweep again, to see what its rollouts did",
        "pgf_jax.inspection.config:ReproduceConfig",
        _reproduce,
    ),
    "console": Command(
        "guide a fleet from a browser, in real time",
        "pgf_jax.console.config:ConsoleConfig",
        _console,
    ),
    "collect": Command(
        "plan sampled scenes, or replay sessions, and keep every iteration, to train on",
        "pgf_jax.collection.config:CollectConfig",
        _collect,
    ),
    "train": Command("train the predictors on collected runs", "pgf_jax.cli:TrainCommand", _train),
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
    ),
}
