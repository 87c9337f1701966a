"""`fit-operator`: reads service times from event logs and fits the distribution of sweeps.

`fit(service_times(events))` is the whole computation for one fleet.
"""

import dataclasses
import json
import math
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgf_jax.errors import BadInput, short_repr
from pgf_jax.files import png, write_atomically
from pgf_jax.fleet.events import Event, EventKind
from pgf_jax.operator_fit.config import FitOperatorConfig
from pgf_jax.operator_fit.lognormal import (
    ANSWERS,
    NO_ANSWER,
    Fit,
    Service,
    ServiceSample,
    arrays,
    fit,
    kaplan_meier,
)
from pgf_jax.tables.event_log import read_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def service_times(events: Sequence[Event]) -> ServiceSample:
    """The services of one fleet: each is a grant and the end of the same robot's service.

    Raises:
      BadInput: grants and ends do not match, or an outcome is unknown.
    """
    granted: dict[int | None, int] = {}
    services = []
    for event in events:
        where = f"robot {event.robot}, {event.time_ns / 1e9:.3f} s"
        if event.kind is EventKind.GRANT:
            if event.robot in granted:
                raise BadInput(f"{where}: granted again before the service before ended")
            granted[event.robot] = event.time_ns
        elif event.kind is EventKind.SERVICE_END:
            start_ns = granted.pop(event.robot, None)
            if start_ns is None or start_ns > event.time_ns:
                raise BadInput(f"{where}: a service ends that no grant before it began")
            if event.outcome not in (*ANSWERS, *NO_ANSWER):
                raise BadInput(
                    f"{where}: a service's outcome: expected one of "
                    f"{', '.join((*ANSWERS, *NO_ANSWER))}, got {event.outcome!r}"
                )
            draw = (event.robot, event.task, event.request)
            services.append(Service((event.time_ns - start_ns) / 1e9, event.outcome, draw))
    return ServiceSample(tuple(services), len(granted))


def read_services(paths: Iterable[Path]) -> ServiceSample:
    """The services of all logs together, in seconds of the operator's time.

    In a live session of `speed` 2, two simulated seconds pass in each second of the operator.

    Raises:
      BadInput: one line that names the file: damaged, given twice, or no services in any.
    """
    services: list[Service] = []
    cut_off = 0
    files: list[Path] = []
    for log in map(read_log, paths):
        path = log.path
        if path.resolve() in {file.resolve() for file in files}:
            raise BadInput(f"{path}: given twice, its services would count twice")
        files.append(path)
        speed = log.settings.get("speed", 1) if isinstance(log.settings, dict) else 1
        if not _is_number(speed) or not 0 < speed <= sys.float_info.max:
            raise BadInput(f"{path}: speed: expected a positive number, got {short_repr(speed)}")
        for events in log.fleets:
            try:
                sample = service_times(events)
            except BadInput as error:
                raise BadInput(f"{path}: {error}") from None
            cut_off += sample.cut_off
            services += (
                Service(seconds / speed, outcome, (path, draw))
                for seconds, outcome, draw in sample.services
            )
    if not services:
        cut = f" ({cut_off} began and are cut off)" if cut_off else ""
        raise BadInput(f"{', '.join(map(str, files))}: holds no service that ended{cut}")
    return ServiceSample(tuple(services), cut_off)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def fit_operator(config: FitOperatorConfig) -> Fit:
    """Read logs, fit, print and draw; returns the fit.

    Raises:
      BadInput: one line that names the file.
    """
    sample = read_services(config.log)
    try:
        result = fit(sample)
    except BadInput as error:
        raise BadInput(f"{', '.join(map(str, config.log))}: {error}") from None
    if config.out is not None:
        write_atomically(config.out, png(figure(sample, result)))
    if config.json:
        sys.stdout.write(json.dumps(_json_content(result), indent=2) + "\n")
    else:
        _print(result)
    return result


def figure(sample: ServiceSample, result: Fit) -> "Figure":
    """Draw the distribution functions of the services (Kaplan-Meier) and of the fit."""
    from matplotlib.figure import Figure

    seconds, answered = arrays(sample)
    lengths, shares = kaplan_meier(seconds, answered)
    drawing = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = drawing.subplots()
    axes.step(
        np.concatenate([[0.0], lengths]),
        np.concatenate([[0.0], shares]),
        where="post",
        label=f"services ({result.answered} answered)",
    )
    limits = np.unique(seconds[~answered])
    if len(limits):
        at = shares[np.searchsorted(lengths, limits)]
        label = f"ended without an answer ({result.without_answer})"
        axes.plot(limits, at, "|", color="black", markersize=9, label=label)
    right = 1.1 * float(lengths[-1]) or 1.0
    x = np.linspace(0.0, right, 400)
    label = f"log-normal: mean {result.mean_s:.3g} s, sd {result.sd_s:.3g} s"
    axes.plot(x, result.cdf(x), "--", label=label)
    axes.set(xlim=(0.0, right), ylim=(-0.02, 1.02))
    axes.set_xlabel("service time (s)")
    axes.set_ylabel("share that takes no longer")
    axes.grid(alpha=0.3)
    axes.legend()
    return drawing


def _json_content(result: Fit) -> dict[str, Any]:
    """The fit as JSON; infinity, which JSON does not have, becomes null."""
    content = dataclasses.asdict(result)
    for key in ("mean_interval_s", "sd_interval_s", "median_interval_s"):
        if content[key] is not None:
            content[key] = [value if math.isfinite(value) else None for value in content[key]]
    return content | {"warnings": list(result.warnings), "sweep": result.command}


def _print(result: Fit) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table()
    for heading in ("service time", "s", "95 % interval"):
        table.add_column(heading, justify="left" if heading == "service time" else "right")
    for name in ("mean", "sd", "median"):
        interval = getattr(result, f"{name}_interval_s")
        words = "-" if interval is None else f"{interval[0]:.3g} to {interval[1]:.3g}"
        table.add_row(name, f"{getattr(result, f'{name}_s'):.3g}", words)
    Console().print(table)
    services = result.answered + result.without_answer
    counts = [f"{result.answered} answered ({result.push_share:.0%} pushes)"]
    counts += [f"{result.without_answer} ended without an answer (right-censored)"]
    if result.draws < result.answered:
        counts += [f"only {result.draws} of the answers independent draws"]
    if result.cut_off:
        counts += [f"{result.cut_off} more cut off by the end of a log and left out"]
    print(f"{services} services: {', '.join(counts)}")
    print(f"Kolmogorov-Smirnov distance {result.ks:.3f}; intervals by bootstrap")
    for line in result.warnings:
        print(f"warning: {line}")
    print(result.command)
