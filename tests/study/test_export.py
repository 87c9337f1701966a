"""What comes of a study: its data set, its analysis, and its blocks under other policies."""

import csv
import json
import math
import re
from pathlib import Path

import polars as pl
import pytest
from study_toys import arrive, take_part, toy_study

from pgf_jax.cli import main
from pgf_jax.errors import BadInput
from pgf_jax.fleet.events import EventKind
from pgf_jax.study.analysis import Measured, analyse, difference_of
from pgf_jax.study.codebook import TABLES, TEXTS, variables
from pgf_jax.study.design import load_design
from pgf_jax.study.export import DESCRIPTION, export, table_file
from pgf_jax.study.orders import balanced_orders
from pgf_jax.study.records import inputs_of, read_people
from pgf_jax.study.sample_size import needed, sample_size
from pgf_jax.study.what_if import what_if
from pgf_jax.sweeping.replay import replay, replay_difference
from pgf_jax.tables.event_log import digest, read_log


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Two participants who have done all, and one who stopped in the first block."""
    design = toy_study(tmp_path_factory.mktemp("study") / "study", minutes=0.06)
    for _ in range(2):
        visit, page = arrive(design)
        take_part(visit, page)
        visit.close()
    visit, page = arrive(design)
    for step in ("consent", "instructions"):
        assert page.page["step"] == ("consent", "instructions").index(step)
        visit.receive({"type": "done", "step": page.page["step"]})
    page.wait_for("practice")
    visit.close()
    return design


@pytest.fixture(scope="module")
def exported(study, tmp_path_factory):
    out = tmp_path_factory.mktemp("export") / "data set"
    return out, export(study, out)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_data_set_keeps_the_rules_of_psych_ds(exported):
    # Those that its validator counts as errors (psychds-docs, "Rules and Conventions").
    out, _ = exported
    about = json.loads((out / DESCRIPTION).read_text())
    assert about["@context"].startswith("https://schema.org") and about["@type"] == "Dataset"
    assert about["name"] and about["description"]
    named = [variable["name"] for variable in about["variableMeasured"]]
    assert len(set(named)) == len(named)
    for variable in about["variableMeasured"]:
        assert variable["@type"] == "PropertyValue" and variable["description"]
    files = list((out / "data").glob("**/*.csv"))
    assert len(files) == len(TABLES)
    used = set()
    for file in files:
        assert re.fullmatch(r"([a-z]+-[a-zA-Z0-9]+)(_[a-z]+-[a-zA-Z0-9]+)*_data\.csv", file.name)
        with file.open(newline="", encoding="utf-8") as lines:
            head, *body = csv.reader(lines)
        assert all(len(line) == len(head) for line in body)
        assert len(set(head)) == len(head) and "row_id" not in head
        used |= set(head)
    assert used == set(named)


def test_every_column_of_the_codebook_is_read(exported):
    out, frames = exported
    described = {variable["name"]: variable for variable in variables()}
    assert described.keys() <= TEXTS.keys()
    filled = set()
    for name, (_, schema) in TABLES.items():
        path = out / "data" / table_file(name)
        read = pl.read_csv(path, schema=dict(schema))
        assert read.equals(frames[name]) and len(read)
        filled |= {column for column in read.columns if read[column].null_count() < len(read)}
    assert described["took_s"]["unitText"] == "s" and described["x"]["unitText"] == "m"
    # What this trivial world has none of: checks, and times of robots that plan on.
    never = {"checks", "check_misses", "attempts", "asking_s", "served_s", "lost_s", "withdrawn",
             "round_trip_ms", "clock_offset_ms", "action"}  # fmt: skip
    assert described.keys() - filled <= never


def test_what_was_done_is_in_the_data_set(study, exported):
    out, _ = exported
    people = rows(out / "data" / table_file("participants"))
    assert [one["order"] for one in people] == ["stuck time", "time stuck", "stuck time"]
    assert [one["finished"] for one in people] == ["true", "true", "false"]
    sessions = rows(out / "data" / table_file("sessions"))
    assert [one["session"] for one in sessions] == ["practice", "block1", "block2"] * 2 + [
        "practice"
    ]
    inputs = rows(out / "data" / table_file("inputs"))
    answered = [one for one in inputs if one["outcome"] in ("push", "go_on")]
    assert answered and {one["outcome"] for one in answered} == {"push", "go_on"}
    for one in answered:
        if one["acknowledged"] == "true":
            assert float(one["reorientation_s"]) >= 0 and float(one["interaction_s"]) >= 0
    # At most one answer of a session came too late for its word.
    for session in {(one["participant"], one["session"]) for one in inputs}:
        mine = [one for one in answered if (one["participant"], one["session"]) == session]
        assert sum(one["acknowledged"] == "false" for one in mine) <= 1
    scores = rows(out / "data" / table_file("scores"))
    assert {one["score"] for one in scores if one["questionnaire"] == "nasa_tlx"} == {"35.0"}
    given = rows(out / "data" / table_file("answers"))
    assert [one["answer"] for one in given if one["item"] == "attention"] == ["green"] * 2
    everything = "".join(path.read_text() for path in out.glob("**/*.csv"))
    assert "127.0.0.1" not in everything


def test_a_session_is_replayed_from_the_data_set_bit_for_bit(exported):
    out, frames = exported
    sessions = frames["sessions"]
    for row in sessions.filter(pl.col("ended")).iter_rows(named=True):
        folder = out / "data" / "raw" / f"participant-{row['participant']:03d}" / row["session"]
        runner, log = replay(folder)
        runner.run_until(log.events[-1].time_ns)
        assert digest(runner.fleet.events) == row["events_sha256"]
        assert replay_difference(runner.fleet.events, log) is None


def test_an_export_is_the_same_again_and_replaces_only_its_own(study, exported, tmp_path):
    out, _ = exported
    export(study, tmp_path / "again")
    first, second = ({p.relative_to(where): p.read_bytes() for p in where.glob("**/*")
                      if p.is_file()} for where in (out, tmp_path / "again"))  # fmt: skip
    assert first == second
    export(study, tmp_path / "again")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(BadInput, match="no exported study"):
        export(study, tmp_path / "mine")
    assert [path.name for path in tmp_path.iterdir()] == ["again", "mine"]


def test_the_analysis_is_of_those_who_did_all_blocks(study):
    found = analyse(study, read_people(study))
    assert found.participants == (1, 2) and found.unfinished == (3,)
    assert found.conditions["nasa_tlx", "stuck"].mean == 35
    values = {(one.participant, one.condition): one.value for one in found.measured
              if one.measure == "services_per_minute"}  # fmt: skip
    expected = [values[who, "time"] - values[who, "stuck"] for who in (1, 2)]
    (difference,) = [one for one in found.differences if one.measure == "services_per_minute"]
    assert difference.difference.mean == pytest.approx(sum(expected) / 2)
    firsts = [one.value for one in found.measured
              if (one.measure, one.block) == ("services_per_minute", 1)]  # fmt: skip
    assert found.order["services_per_minute", 1].mean == pytest.approx(sum(firsts) / 2)
    assert found.operator is not None and found.operator.answered > 3


def test_differences_are_within_participants():
    def of(who, condition, value):
        return Measured(who, 1, condition, "success", value)

    measured = [of(1, "a", 0.5), of(1, "b", 0.7), of(2, "a", 0.1), of(2, "b", 0.5),
                of(3, "a", 0.9), of(3, "b", math.nan), of(4, "b", 0.3)]  # fmt: skip
    found = difference_of(measured, "success", "b", "a")
    assert found.difference.mean == pytest.approx(0.3) and found.difference.n == 2
    assert found.effect == pytest.approx(0.3 / (0.02**0.5))


@pytest.mark.parametrize(("effect", "least"), [(0.5, 34), (0.8, 15), (1.0, 10), (-0.5, 34)])
def test_participants_needed(effect, least):
    # G*Power 3.1, paired t-test, two-sided, 5 %, 80 %: 34, 15, 10.
    assert needed(effect, 1) == least
    assert needed(effect, 2) == least + least % 2
    assert needed(0.0, 2) is None and needed(math.nan, 2) is None


def test_a_simulated_study_says_how_many_are_needed(study):
    found = sample_size(study, 4)
    assert {one.difference.measure for one in found} >= {"task_time_s", "success"}
    for one in found:
        assert one.difference.difference.n in (0, 4)
        assert one.participants is None or one.participants % len(balanced_orders(2)) == 0
    assert repr(sample_size(study, 4)) == repr(found)


def test_under_its_own_policy_every_input_carries_over(study):
    people = read_people(study)[:1]
    policies = [study.policy(block.condition) for block in people[0].blocks]
    for own, block in zip(policies, people[0].blocks, strict=True):
        (same,) = [one for one in what_if(study, people, [own]) if one.block.name == block.name]
        log = read_log(block.folder)
        answered = [one for one in inputs_of(log.events, ()) if one.outcome in ("push", "go_on")]
        assert len(same.operator.carried) >= len(answered) > 0
        events = same.outcome.events
        # The same to the bit, until the first service that the recording has no answer for.
        others = same.operator.others
        unknown = [
            i
            for i, event in enumerate(events)
            if event.kind is EventKind.GRANT and (event.robot, event.task, event.request) in others
        ]
        until = min(unknown, default=len(log.events))
        assert until > 10 and digest(events[:until]) == digest(log.events[:until])


def test_under_another_policy_some_inputs_are_of_the_fitted_operator(study):
    people = read_people(study)[:1]
    found = what_if(study, people, ["random"])
    assert [one.block.name for one in found] == ["block1", "block2"]
    for one in found:
        services = {*one.operator.carried, *one.operator.others}
        granted = inputs_of(one.outcome.events, ())
        assert services == {(g.robot, g.task, g.request) for g in granted}
        assert not one.operator.carried.keys() & one.operator.others


def test_commands_of_a_study(study, tmp_path, capsys):
    where = str(study.folder)
    assert main(["study", "export", where, "--out", str(tmp_path / "out")]) == 0
    assert "3 participants" in capsys.readouterr().out
    assert main(["study", "analyse", where, "--out", str(tmp_path / "found")]) == 0
    shown = capsys.readouterr().out
    assert "2 participants have done all blocks" in shown and "--robots 40" in shown
    assert "--policies asking always" in shown
    names = {path.name for path in (tmp_path / "found").iterdir()}
    assert names == {"analysis.png", "conditions.csv", "differences.csv", "order.csv",
                     "participants.csv"}  # fmt: skip
    assert main(["study", "what-if", where, "--policies", "asking"]) == 0
    assert "carried: inputs of the person" in capsys.readouterr().out
    assert main(["study", "what-if", where]) == 2
    assert main(["study", "what-if", where, "--policies", "nobody"]) == 2
    assert main(["study", "size", where, "--participants", "1"]) == 2
    assert main(["study", "size", where, "--participants", "2"]) == 0
    assert "take these numbers as the least" in capsys.readouterr().out


def test_an_empty_study_has_nothing_to_analyse(tmp_path, capsys):
    design = toy_study(tmp_path / "new")
    assert main(["study", "analyse", str(design.folder)]) == 2
    assert "no participant has done all blocks yet" in capsys.readouterr().err
    assert main(["study", "what-if", str(design.folder), "--policies", "pgf"]) == 2
    assert main(["study", "export", str(design.folder)]) == 0
    assert load_design(design.folder).dataset.authors == ()


def test_gaps_are_from_when_the_page_was_lost(study):
    person = read_people(study)[0]
    happened = [
        *(("connected", 0), ("done", 5), ("lost", 7), ("paused", 8), ("connected", 10)),
        *(("done", 20), ("connected", 26), ("reached_the_end", 30), ("connected", 90)),
    ]
    events = [{"kind": kind, "at_ms": 1_000_000 + 1000 * s} for kind, s in happened]
    person.progress.events = events
    assert person.gaps == (2, 3 + 6)  # the second without a word: from the last that happened
