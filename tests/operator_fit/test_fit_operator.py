"""The fit of service times: to samples of a known distribution, to a fleet's log, to bad logs."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from write_log import write_log

from pgf_jax.cli import main
from pgf_jax.errors import BadInput
from pgf_jax.files import write_atomically
from pgf_jax.fleet import Event, EventKind, Fleet, FleetConfig
from pgf_jax.fleet.config import Cell
from pgf_jax.fleet.service import LogNormal
from pgf_jax.fleet.stub import StubRobots, drive, outcome
from pgf_jax.operator_fit import command, lognormal
from pgf_jax.operator_fit.command import service_times
from pgf_jax.operator_fit.lognormal import Service, ServiceSample, fit
from pgf_jax.planning.types import UNANSWERED, Push
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.tables import results
from pgf_jax.tables.event_log import Journal
from pgf_jax.tables.parquet import encode_table

MEAN, SD = 8.0, 4.0
SIGMA = math.sqrt(math.log1p((SD / MEAN) ** 2))
MU = math.log(MEAN) - SIGMA**2 / 2


@pytest.fixture
def few_resamples(monkeypatch):
    monkeypatch.setattr(lognormal, "BOOTSTRAP", 40)


def sample_of(seconds: ArrayLike, limits: ArrayLike = math.inf, draws: list[int] | None = None):
    """Services that are cut off at `limits`."""
    seconds = np.asarray(seconds, dtype=float)
    pairs = zip(seconds, np.broadcast_to(limits, seconds.shape), strict=True)
    return ServiceSample(
        tuple(
            Service(float(min(s, end)), "push" if s <= end else "expired", draws[i] if draws else i)
            for i, (s, end) in enumerate(pairs)
        )
    )


def drawn(count, seed=0):
    times = LogNormal(seed, MEAN, SD)
    return np.array([times.seconds(0, 0, request) for request in range(count)], dtype=float)


def log_likelihood(sample, mu, sigma):
    """The log-likelihood of ln(s), implemented independently."""
    total = 0.0
    for seconds, outcome_, _ in sample.services:
        z = (math.log(seconds) - mu) / sigma
        if outcome_ == "push":
            total -= math.log(sigma) + z * z / 2 + math.log(2 * math.pi) / 2
        else:
            total += math.log(math.erfc(z / math.sqrt(2)) / 2)
    return total


def standard_errors(sample, mu, sigma, h=1e-3):
    """Standard errors of mu and sigma, from the curvature of the log-likelihood."""

    def at(i, j):
        return log_likelihood(sample, mu + i * h, sigma + j * h)

    cross = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4
    mus, sigmas = (at(1, 0) + at(-1, 0) - 2 * at(0, 0)), (at(0, 1) + at(0, -1) - 2 * at(0, 0))
    return np.sqrt(np.diag(np.linalg.inv(-np.array([[mus, cross], [cross, sigmas]]) / h**2)))


# --- the fit ------------------------------------------------------------------------------------


@pytest.mark.parametrize("limits", [math.inf, 8.0, "random"])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_distribution_of_a_sample_is_recovered(limits, seed, few_resamples):
    if limits == "random":
        limits = np.random.default_rng(seed).uniform(2.0, 20.0, 1500)
    sample = sample_of(drawn(1500, seed), limits)
    result = fit(sample)
    mu_error, sigma_error = standard_errors(sample, MU, SIGMA)
    assert abs(math.log(result.median_s) - MU) < 4 * mu_error
    assert abs(result.sigma - SIGMA) < 4 * sigma_error
    # The mean and the sd by the delta method, to first order with room for the second.
    assert abs(math.log(result.mean_s / MEAN)) < 4 * (mu_error + SIGMA * sigma_error)
    slope = SIGMA + SIGMA * math.exp(SIGMA**2) / math.expm1(SIGMA**2)  # of ln(sd) in sigma
    assert abs(math.log(result.sd_s / SD)) < 4 * (mu_error + slope * sigma_error)
    assert result.ks < 1.63 / math.sqrt(result.answered)  # 1 % for a distribution chosen beforehand
    assert result.answered + result.without_answer == 1500
    assert result.draws == result.answered
    assert (result.without_answer == 0) == (limits is math.inf)
    # What the sweep draws by has the fitted parameters.
    assert math.sqrt(math.log1p((result.sd_s / result.mean_s) ** 2)) == pytest.approx(result.sigma)


def test_without_the_censoring_the_fit_would_be_too_short(few_resamples):
    sample = sample_of(drawn(1000), 8.0)
    naive = ServiceSample(tuple(s for s in sample.services if s.outcome == "push"))
    assert fit(naive).mean_s < 0.8 * MEAN < 0.9 * fit(sample).mean_s


@pytest.mark.parametrize(("count", "seed", "limit"), [(30, 0, 9.0), (200, 1, 6.0), (40, 2, 4.0)])
def test_it_agrees_with_scipy(count, seed, limit, few_resamples):
    stats = pytest.importorskip("scipy.stats")
    optimize = pytest.importorskip("scipy.optimize")
    limits = np.random.default_rng(seed).uniform(0.5 * limit, 1.5 * limit, count)
    seconds = drawn(count, seed)
    data = stats.CensoredData.right_censored(np.minimum(seconds, limits), seconds > limits)

    def closely(function, start, args=(), disp=0):
        return optimize.fmin(
            function, start, args, xtol=1e-11, ftol=1e-13, maxfun=9999, maxiter=9999, disp=disp
        )

    sigma, _, median = stats.lognorm.fit(data, floc=0, optimizer=closely)
    result = fit(sample_of(seconds, limits))
    theirs = stats.lognorm(sigma, scale=median)
    assert result.without_answer > 0
    assert (result.sigma, result.median_s) == pytest.approx((sigma, median), rel=1e-6)
    assert (result.mean_s, result.sd_s) == pytest.approx((theirs.mean(), theirs.std()), rel=1e-6)
    x = np.linspace(0.0, 30.0, 50)
    np.testing.assert_allclose(result.cdf(x), theirs.cdf(x), atol=1e-6)


def test_the_distance_agrees_with_scipy(few_resamples):
    stats = pytest.importorskip("scipy.stats")
    seconds = drawn(60)
    result = fit(sample_of(seconds))
    assert result.ks == pytest.approx(stats.kstest(seconds, result.cdf).statistic)


def test_kaplan_meier_against_hand_computation():
    # 5 services: ends at 1, 2 and 4 (twice); 2 and 3 only at least. At a tie, who ended counts
    # first: 4/5, then 3/4 of it, then 0 of the last.
    lengths, shares = lognormal.kaplan_meier(
        np.array([4.0, 1.0, 2.0, 2.0, 3.0]), np.array([True, True, True, False, False])
    )
    assert lengths.tolist() == [1.0, 2.0, 3.0, 4.0]
    np.testing.assert_allclose(shares, [0.2, 0.4, 0.4, 1.0])


@pytest.mark.parametrize("z", [-60.0, -8.0, 0.0, 3.0, 29.999, 30.001, 300.0])
def test_the_hazard_and_the_survival_far_out(z):
    stats = pytest.importorskip("scipy.stats")
    theirs = stats.norm.logsf(z)
    assert lognormal._log_survival(np.array([z]))[0] == pytest.approx(theirs, rel=1e-12)
    hazard = math.exp(stats.norm.logpdf(z) - theirs)
    assert lognormal._hazard(np.array([z]))[0] == pytest.approx(hazard, rel=1e-10)


SAMPLES = st.lists(st.tuples(st.floats(-3.0, 3.0), st.booleans()), min_size=2, max_size=25).filter(
    lambda rows: len({round(x, 3) for x, answered in rows if answered}) >= 2
)


def sample_from(rows, factor=1.0):
    return ServiceSample(
        tuple(
            Service(factor * math.exp(round(x, 3)), "push" if answered else "censored", i)
            for i, (x, answered) in enumerate(rows)
        )
    )


@settings(max_examples=60, deadline=None)
@given(rows=SAMPLES)
def test_nothing_near_is_likelier(rows):
    sample = sample_from(rows)
    seconds, answered = lognormal.arrays(sample)
    mu, sigma = lognormal._maximum(np.log(seconds), answered, np.ones(len(seconds)))
    best = log_likelihood(sample, mu, sigma)
    for step in (1e-3, 1e-1, 1.0):
        for angle in np.arange(8) * math.pi / 4:
            other = mu + sigma * step * math.cos(angle), sigma * math.exp(step * math.sin(angle))
            assert log_likelihood(sample, *other) <= best + 1e-9


@settings(max_examples=25, deadline=None)
@given(rows=SAMPLES, factor=st.floats(1e-3, 1e3))
def test_another_unit_of_time_scales_the_fit(rows, factor):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lognormal, "BOOTSTRAP", 10)
        try:
            one, other = fit(sample_from(rows)), fit(sample_from(rows, factor))
        except BadInput:  # a spread without bounds
            return
    assert other.sigma == pytest.approx(one.sigma, rel=1e-6)
    for name in ("mean_s", "sd_s", "median_s"):
        assert getattr(other, name) == pytest.approx(factor * getattr(one, name), rel=1e-5)
    assert other.ks == pytest.approx(one.ks, abs=1e-6)
    assert (other.answered, other.push_share) == (one.answered, one.push_share)


def test_intervals_hold_the_estimate_and_what_it_was_drawn_from():
    result = fit(sample_of(drawn(80), 15.0))
    for name, true in (("mean_s", MEAN), ("sd_s", SD), ("median_s", math.exp(MU))):
        low, high = getattr(result, name.replace("_s", "_interval_s"))
        assert low < getattr(result, name) < high
        assert low < true < high
    # About 1.96 standard errors to either side of the median.
    errors = standard_errors(sample_of(drawn(80), 15.0), math.log(result.median_s), result.sigma)
    low, high = result.median_interval_s or (0.0, 0.0)
    assert math.log(high / low) / 2 == pytest.approx(1.96 * errors[0], rel=0.2)
    assert fit(sample_of(drawn(80), 15.0)) == result  # a fixed seed
    assert fit(sample_of(drawn(80), 15.0), seed=1).mean_interval_s != result.mean_interval_s


def test_services_of_one_draw_say_no_more_than_one(few_resamples):
    one = fit(sample_of(drawn(30), 12.0, draws=list(range(30))))
    thrice = fit(sample_of(np.tile(drawn(30), 3), 12.0, draws=[*range(30)] * 3))
    assert (thrice.answered, thrice.draws) == (3 * one.answered, one.answered)
    assert 20 <= one.answered < 30
    assert thrice.mean_s == pytest.approx(one.mean_s)
    assert thrice.mean_interval_s == pytest.approx(one.mean_interval_s)
    assert not thrice.warnings


# --- edge cases ---------------------------------------------------------------------------------


@pytest.mark.parametrize("limits", [math.inf, [9.0, 8.0, 3.0, 8.0]])
@pytest.mark.parametrize("seconds", [8.0, 0.0])
def test_equal_times_are_a_constant(seconds, limits):
    result = fit(sample_of([seconds] * 4, limits))
    assert (result.mean_s, result.sd_s, result.median_s) == (seconds, 0.0, seconds)
    assert result.mean_interval_s == (seconds, seconds) and result.sd_interval_s == (0.0, 0.0)
    assert result.ks == 0.0
    assert result.cdf(np.array([seconds - 1, seconds, 9.0])).tolist() == [0.0, 1.0, 1.0]
    arguments = result.command.split()[2:]
    config = SweepConfig(service_mean=float(arguments[1]), service_sd=float(arguments[3]))
    assert LogNormal(0, config.service_mean, config.service_sd).seconds(0, 0, 0) == seconds


def test_equal_times_beside_a_longer_limit_are_no_constant(few_resamples):
    result = fit(sample_of([8.0, 8.0, 9.0, 99.0], [20.0, 20.0, 20.0, 20.0]))
    assert result.sd_s > 0 and result.without_answer == 1


def test_a_single_answer_has_no_interval():
    result = fit(sample_of([8.0]))
    assert (result.mean_s, result.mean_interval_s, result.sd_interval_s) == (8.0, None, None)
    assert result.median_interval_s is None
    assert len(result.warnings) == 1 and "fewer than 20 answers (1)" in result.warnings[0]


def test_a_service_without_an_answer_after_0_s_says_nothing(few_resamples):
    limits = [math.inf] * 30
    one, two = (fit(sample_of(drawn(30 + i), limits + [0.0] * i)) for i in (0, 2))
    assert (two.mean_s, two.sd_s) == pytest.approx((one.mean_s, one.sd_s))
    assert two.without_answer == 2


@pytest.mark.parametrize(
    ("sample", "message"),
    [
        (ServiceSample(()), "no service had an answer"),
        (sample_of([9.0, 9.0], 5.0), r"no service had an answer \(2 without\)"),
        (sample_of([0.0, 3.0, 0.0]), "2 of 3 answers took 0 s"),
        (sample_of([0.1, *[1e300] * 9], [1.0, *[1e290] * 9]), "too few to fit"),
    ],
)
def test_what_cannot_be_fitted(sample, message):
    with pytest.raises(BadInput, match=message):
        fit(sample)


@pytest.mark.parametrize("count", [19, 20])
def test_few_answers_come_with_a_warning(count, few_resamples):
    assert bool(fit(sample_of(drawn(count))).warnings) == (count < 20)


def test_mostly_unanswered_comes_with_a_warning(few_resamples):
    assert "most services" in fit(sample_of(drawn(100), 5.0)).warnings[0]


# --- services of a log --------------------------------------------------------------------------


def fleet_of(mean_s=MEAN, sd_s=SD, decide=lambda work: None, **changes):
    """Robots that are stuck in every other iteration, and so served again and again."""
    config = FleetConfig(
        **{"robots": 4, "tasks": 6, "policy": "queue", "operators": 2, "seed": 3} | changes
    )
    stub = StubRobots(lambda work: outcome(stuck=True), decide)
    fleet = Fleet(config, stub, service=LogNormal(config.seed, mean_s, sd_s))
    drive([(fleet, stub)])
    return fleet


@pytest.mark.parametrize("horizon", [None, 700.0])
def test_services_of_a_fleet(horizon):
    fleet = fleet_of(decide=lambda w: Push(0, 0.4, 0.1) if w.request % 3 else None)
    if horizon is not None:
        fleet = fleet_of(horizon_s=horizon)
    sample = service_times(fleet.events)
    interaction_s = sum(record.interaction_s for record in fleet.records)
    assert math.fsum(s.seconds for s in sample.services) == pytest.approx(interaction_s)
    assert len(sample.services) == sum(record.grants for record in fleet.records)
    answered = [s for s in sample.services if s.outcome in lognormal.ANSWERS]
    assert len(answered) == sum(record.answered for record in fleet.records) > 100
    # An answered one is the draw itself, another one is shorter.
    times = LogNormal(fleet.config.seed, MEAN, SD)
    for seconds, outcome_, draw in sample.services:
        assert isinstance(draw, tuple)
        whole = times.seconds(*draw)
        assert whole is not None
        if outcome_ in lognormal.ANSWERS:
            assert seconds == pytest.approx(whole, abs=1e-8)
        else:
            assert seconds <= whole + 1e-8 and outcome_ in ("expired", "censored")
    assert {s.outcome for s in sample.services} > ({"censored"} if horizon else {"expired"})
    result = fit(sample)
    for name, true in (("mean_interval_s", MEAN), ("sd_interval_s", SD)):
        low, high = getattr(result, name)
        assert low < true < high
    assert 0 < result.push_share < 1 if horizon is None else result.push_share == 0
    assert sample.cut_off == 0 and len({s.draw for s in sample.services}) == len(sample.services)


def test_an_operator_who_keeps_silent_is_censored():
    fleet = fleet_of(decide=lambda work: UNANSWERED if work.request % 2 else None)
    sample = service_times(fleet.events)
    outcomes = {s.outcome for s in sample.services}
    assert {"go_on", "unanswered"} <= outcomes
    result = fit(sample)
    assert result.answered == sum(s.outcome == "go_on" for s in sample.services)
    assert result.mean_s > MEAN  # half of the services are known to have lasted longer


def test_a_log_that_breaks_off_leaves_its_last_services_out():
    fleet = fleet_of()
    grants = [i for i, event in enumerate(fleet.events) if event.kind is EventKind.GRANT]
    sample = service_times(fleet.events[: grants[40] + 1])
    assert 1 <= sample.cut_off <= 2  # operators
    assert len(sample.services) == 41 - sample.cut_off
    assert sample.services == service_times(fleet.events).services[: len(sample.services)]


GRANT, END = EventKind.GRANT, EventKind.SERVICE_END


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([(GRANT, 0, None), (GRANT, 1, None)], "robot 7, 1.000 s: granted again"),
        ([(END, 2, "push")], "robot 7, 2.000 s: a service ends that no grant"),
        ([(GRANT, 3, None), (END, 2, "push")], "a service ends that no grant before it began"),
        ([(GRANT, 0, None), (END, 2, "shrug")], "expected one of push, .* got 'shrug'"),
        ([(GRANT, 0, None), (END, 2, None)], "got None"),
    ],
)
def test_a_log_that_does_not_pair_up(rows, message):
    events = [Event(t * 10**9, kind, robot=7, outcome=text) for kind, t, text in rows]
    with pytest.raises(BadInput, match=message):
        service_times(events)


# --- the command --------------------------------------------------------------------------------


def session(seconds, ending="push"):
    """Events of one robot that is served for `seconds`, again and again."""
    events, now = [], 0
    for request, length in enumerate(seconds):
        for kind, text, after in ((GRANT, None, 10**9), (END, ending, round(length * 1e9))):
            now += after
            events.append(Event(now, kind, robot=0, task=0, request=request, outcome=text))
    return events


def run(arguments, capsys):
    code = main(["fit-operator", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, out, err


def write_journal(path, events, speed=None):
    about = {"settings": {} if speed is None else {"speed": speed}, "identity": {"versions": {}}}
    journal = Journal(path, about)
    journal.append(events)
    journal.close()
    return path


def write_table(path, *fleets):
    """A log as a sweep writes it: of one cell, or merged."""
    frames = [results.events_frame(events) for events in fleets]
    cells = [(Cell("queue", robots, 1), frame) for robots, frame in enumerate(frames, 1)]
    write_atomically(path, encode_table(results.merge(cells) if len(cells) > 1 else frames[0]))
    return path


def test_the_table_and_how_to_use_it(tmp_path, capsys):
    log = write_journal(tmp_path / "events.jsonl", session(drawn(40)))
    code, out, err = run(["--log", log], capsys)
    assert (code, err) == (0, "")
    for word in ("mean", "sd", "median", "95 % interval", "40 services: 40 answered (100% pushes)"):
        assert word in out
    result = fit(service_times(session(drawn(40))))
    last = out.splitlines()[-1]
    assert last == result.command
    arguments = last.split()
    assert arguments[:2] == ["pgf-jax", "sweep"] and "warning" not in out
    assert float(arguments[3]) == pytest.approx(result.mean_s, rel=5e-3)
    assert float(arguments[5]) == pytest.approx(result.sd_s, rel=5e-3)
    folder = run(["--log", tmp_path], capsys)
    assert folder == (0, out, "")


def test_json_is_the_whole_fit(tmp_path, capsys):
    log = write_journal(tmp_path / "events.jsonl", session(drawn(10)))
    code, out, err = run(["--log", log, "--json"], capsys)
    assert (code, err) == (0, "")
    content = json.loads(out)
    result = fit(service_times(session(drawn(10))))
    assert content["mean_s"] == pytest.approx(result.mean_s)
    assert content["mean_interval_s"] == pytest.approx(result.mean_interval_s)
    assert content["sweep"] == result.command
    assert content["warnings"] == list(result.warnings) != []


def test_json_has_no_infinity():
    result = fit(sample_of([2.0, 3.0]))
    result = dataclasses.replace(result, mean_interval_s=(2.0, math.inf))
    assert command._json_content(result)["mean_interval_s"] == [2.0, None]


def test_several_logs_are_taken_together_each_in_its_operators_seconds(tmp_path, capsys):
    one = write_journal(tmp_path / "one.jsonl", session([4.0, 9.0]))
    two = write_journal(tmp_path / "two.jsonl", session([8.0, 14.0], "go_on"), speed=2.0)
    three = tmp_path / "three.parquet"
    write_log(three, session([2.5]), {"settings": {"speed": 0.5}, "identity": {"versions": {}}})
    sample = command.read_services([one, two, three])
    assert [s.seconds for s in sample.services] == [4.0, 9.0, 4.0, 7.0, 5.0]
    assert len({s.draw for s in sample.services}) == 5
    code, out, _ = run(["--log", one, two, three, "--json"], capsys)
    content = json.loads(out)
    assert code == 0 and (content["answered"], content["draws"]) == (5, 5)
    assert content["push_share"] == 3 / 5


def test_fleets_of_a_sweep_are_told_apart_and_share_their_draws(tmp_path, capsys):
    fleets = [fleet_of(robots=robots, operators=1, tasks=3) for robots in (1, 3)]
    log = write_table(tmp_path / "events.parquet", *(fleet.events for fleet in fleets))
    sample = command.read_services([log])
    each = [service_times(fleet.events).services for fleet in fleets]
    assert [s[:2] for s in sample.services] == [s[:2] for services in each for s in services]
    code, out, err = run(["--log", log], capsys)
    assert (code, err) == (0, "")
    draws = {s.draw for services in each for s in services if s.outcome == "go_on"}
    assert f"only {len(draws)} of the answers independent draws" in " ".join(out.split())
    assert len(draws) < len(sample.services)
    alone = write_table(tmp_path / "cell.parquet", fleets[0].events)
    assert len(command.read_services([alone]).services) == len(each[0])


def test_a_session_that_was_killed_counts_what_it_left_out(tmp_path, capsys):
    log = write_journal(tmp_path / "events.jsonl", session([4.0, 9.0, 3.0])[:-1])
    log.write_bytes(log.read_bytes() + b'{"time_ns"')
    code, out, _ = run(["--log", log], capsys)
    words = " ".join(out.split())
    assert code == 0 and "2 services" in words and "1 more cut off by the end" in words
    assert "warning: fewer than 20 answers (2)" in words


@pytest.mark.parametrize("seconds", [[3.0], [5.0, 5.0], [0.0, 0.0], [3.0, 5.0, 4.0, 20.0, 1.0]])
def test_the_figure_shows_the_services_and_the_fit(seconds, tmp_path, capsys):
    log = write_journal(tmp_path / "a.jsonl", session(seconds))
    silent = write_journal(tmp_path / "b.jsonl", session([2.0], "unanswered"))
    logs = [log] if seconds[0] == 0 else [log, silent]
    out = tmp_path / "new" / "fit.png"
    code, _, err = run(["--log", *logs, "--out", out], capsys)
    assert (code, err) == (0, "")
    assert out.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in out.parent.iterdir()] == ["fit.png"]
    sample = command.read_services(logs)
    axes = command.figure(sample, fit(sample)).axes[0]
    services, line = axes.lines[0], axes.lines[-1]
    assert np.asarray(services.get_ydata())[0] == 0.0
    assert np.all(np.diff(np.asarray(line.get_ydata(), float)) >= 0)
    assert len(axes.lines) == (2 if seconds[0] == 0 else 3)


BAD = {
    "none": ([], "options missing: --log"),
    "empty": (["--log"], "--log: expected "),
    "missing": (["--log", "{}/nothing.jsonl"], "nothing.jsonl"),
    "no events": (["--log", "{}/empty.jsonl"], "empty.jsonl: holds no service that ended\n"),
    "cut off": (["--log", "{}/cut.jsonl"], "holds no service that ended (1 began"),
    "silent": (["--log", "{}/silent.jsonl"], "silent.jsonl: no service had an answer (2 without)"),
    "zero": (["--log", "{}/zero.jsonl"], "zero.jsonl: 1 of 2 answers took 0 s"),
    "twice": (["--log", "{}/folder", "{}/folder/events.jsonl"], "events.jsonl: given twice"),
    "pairs": (["--log", "{}/good.jsonl", "{}/pairs.jsonl"], "pairs.jsonl: robot 0, 1.000 s"),
    "speed": (["--log", "{}/speed.jsonl"], "speed.jsonl: speed: expected a positive number"),
    "word": (["--log", "{}/word.jsonl"], "expected a positive number, got 'fast'"),
    "figure": (["--log", "{}/good.jsonl", "--out", "{}/a.pdf"], "--out: expected a .png file"),
    "folder": (["--log", "{}/good.jsonl", "--out", "{}/good.jsonl/a.png"], "cannot be written"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(case, tmp_path, capsys):
    good = session([3.0, 5.0])
    write_journal(tmp_path / "good.jsonl", good)
    write_journal(tmp_path / "folder" / "events.jsonl", good)
    write_journal(tmp_path / "empty.jsonl", [])
    write_journal(tmp_path / "cut.jsonl", good[:1])
    write_journal(tmp_path / "silent.jsonl", session([3.0, 5.0], "unanswered"))
    write_journal(tmp_path / "zero.jsonl", session([3.0, 0.0]))
    write_journal(tmp_path / "pairs.jsonl", [good[0], *good])
    write_journal(tmp_path / "speed.jsonl", good, speed=0)
    write_journal(tmp_path / "word.jsonl", good, speed="fast")
    arguments, message = BAD[case]
    code, out, err = run([text.format(tmp_path) for text in arguments], capsys)
    assert (code, out) == (2, "")
    assert err.startswith("pgf-jax: ") and err.count("\n") == 1 and message in err
    assert not list(tmp_path.glob("*.png"))
