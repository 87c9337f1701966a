"""Command lines of any words: parsed, or refused in one line with exit code 2."""

import contextlib
import dataclasses
import io
import re
from typing import Any

import fuzz_cases
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import pgf_jax.cli as cli

OPTIONS = re.findall(
    r"\S+",
    """--seed --out --scene --scenes --preset --count --config --engine --physics --cost --update
    --operator --ask --lanes --predictor --service-mean --service-sd --task-limit --robots
    --policies --policy --tasks --window --rollout-time --compute --horizon --workers --resume
    --no-resume --log --host --port --speed --patience --classes --chunk --keys --ask-from --ask-to
    --data --hidden --loss --batch --learning-rate --dropout --json --engines --cores --repeats
    --robot --task --at --start --stop --fps --view --size --random-winner --context-switch
    --scene-class --scene-classes --help -h -- --tyro-print-completion --seed=1 --out=x --lanes=None
    --no-such-option -x -1""",
)
WORDS = [
    "plan",
    "autonomous",
    "human",
    "forks",
    "task",
    "fleet",
    "tight",
    "quick",
    "paper",
    "x.png",
]
WORDS += ["x.plan.json", "1", "2", "0", "-1", "0.5", "nan", "inf", "1e999", "1e308", "None", "True"]
WORDS += ["pgf", "or-hitl", "planar", "native", "shared:96", "shared:" + "9" * 5000, "dedicated"]
WORDS += [
    "after:3",
    "after:" + "9" * 5000,
    "9" * 400,
    "9" * 5000,
    "",
    " ",
    "\0",
    "\n",
    "ä\U0001f600",
]
WORDS += ["\udcff", "\x1b[2J", "{}", "[1,2]", "--", "=", "x" * 5000, "127.0.0.1", "::1", "@file"]
WORDS += [
    "%s",
    "{x}",
    "[red]x[/red]",
    "\\",
    "'",
    '"',
    "<script>",
    "٣",
    "1_0",
    "0x10",
    "best:",
    "rmse",
]
TOKENS = (
    st.sampled_from(OPTIONS)
    | st.sampled_from(OPTIONS)
    | st.sampled_from(WORDS)
    | st.sampled_from(WORDS)
    | st.text(max_size=6)
    | st.integers().map(str)
    | st.floats().map(str)
)
ENOUGH = {
    "scene": ["--scene-class", "tight"],
    "plan": ["--scene-class", "tight"],
    "collect": ["human", "--scenes", "2", "--out", "x"],
    "execute": ["x"],
    "verify": ["x"],
    "reproduce": ["x"],
    "train": ["--data", "x", "--out", "y"],
    "fit-operator": ["--log", "x"],
    "study": ["check", "x"],
    "render": ["plan", "x.plan.json", "--out", "x.png"],
}


def lines() -> st.SearchStrategy[list[str]]:
    """A command, often what it needs, and more."""
    commands = st.sampled_from([*cli.COMMANDS, *cli.COMMANDS, "", "--help", "plam", "\0"])
    words = st.lists(TOKENS, max_size=8)

    def of(command: str) -> st.SearchStrategy[list[str]]:
        enough = ENOUGH.get(command, [])
        return st.sampled_from([enough, enough, []]).flatmap(
            lambda first: words.map(lambda rest: [command, *first, *rest])
        )

    return commands.flatmap(of) | words


@pytest.fixture
def idle(monkeypatch) -> list[Any]:
    """Nothing runs, nothing is set; the settings that would have been run."""
    ran: list[Any] = []
    for name, command in cli.COMMANDS.items():
        monkeypatch.setitem(cli.COMMANDS, name, dataclasses.replace(command, run=ran.append))
    monkeypatch.setattr(cli, "configure_early", lambda engine: None)
    return ran


def check(arguments: list[str], ran: list[Any]) -> None:
    ran.clear()
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.main(arguments)
    said = err.getvalue()
    if not arguments:  # the commands are listed before the line
        assert said.startswith("usage: pgf-jax COMMAND")
        said = said.removeprefix(cli._help() + "\n")
    if code == 0:
        assert said == "" and (len(ran) == 1 or out.getvalue())
    else:
        assert code == 2 and not ran and out.getvalue() == ""
        assert said.startswith("pgf-jax: ") and said.endswith("\n")
        assert said[:-1].isprintable() and len(said) <= fuzz_cases.LONGEST + len("pgf-jax: \n")


def fuzz(examples: int, ran: list[Any]) -> None:
    kept = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture]

    @settings(
        max_examples=examples,
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=kept,
    )
    @given(lines())
    def run(arguments: list[str]) -> None:
        check(arguments, ran)

    run()


def test_any_words(idle):
    fuzz(150, idle)


@pytest.mark.slow
def test_any_words_many(idle):
    fuzz(2000, idle)


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_each_word_after_each_command(command, idle):
    for word in WORDS:
        check([command, word], idle)
    check([command, *ENOUGH.get(command, [])], idle)
    assert len(idle) == 1


@pytest.mark.parametrize("rest", [["bash", "a\0b"], ["bash", "/dev/null/x"], ["x", "y"], ["-"]])
def test_completions_that_cannot_be_written(rest, idle):
    check(["plan", "--tyro-write-completion", *rest], idle)
    check(["plan", "--tyro-print-completion", *rest[::-1]], idle)
