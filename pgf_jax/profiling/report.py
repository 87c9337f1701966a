"""The tables that `profile` prints."""

from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

# Heading -> key, and the form of its number; a column is left out where no engine has the figure.
_COLUMNS = {
    "lanes": ("lanes", "d"),
    "cores": ("cores", "d"),
    "processes": ("processes", "d"),
    "steps/s": ("steps_per_s", ",.0f"),
    "iterations/s": ("iterations_per_s", ",.1f"),
    "to native": ("ratio_to_native", ".2f"),
    "full": ("occupancy", ".0%"),
    "compile s": ("compile_s", ".1f"),
    "flops/step": ("flops_per_step", ",.0f"),
    "GFLOP/s": ("gflops", ".2f"),
    "of peak": ("peak_share", ".1%"),
}


def print_report(result: dict[str, Any], console: Console) -> None:
    """Print what `profile` returns."""
    machine, engines = result["machine"], result["engines"]
    for where, title in (("one_core", "one core"), ("all_cores", f"{machine['cores']} cores")):
        entries = {name: entry[where] for name, entry in engines.items() if where in entry}
        if entries:
            console.print(_table(f"rollouts on {title}, engines taking turns", entries))
    console.print(f"peak of one core: {machine['peak_gflops']:.0f} GFLOP/s (float32 matrices)")
    for name, entry in engines.items():
        for tried in entry["tried"]:
            words = " ".join(str(v) for v in tried["settings"].values() if not isinstance(v, bool))
            console.print(f"{name}, {words}: {tried['steps_per_s']:,.0f} steps/s on one core")
        split, lanes = entry["iteration"], entry["one_core"]["lanes"]
        console.print(
            f"{name}: on one core an iteration of {lanes} robots takes {split['total_ms']:.0f} ms: "
            + ", ".join(
                f"{part} {split[part + '_ms']:.1f}"
                for part in ("rollout", "propose", "absorb", "host")
            )
        )
        if entry["memory_mib"] is not None:
            console.print(
                f"{name}: {entry['memory_mib']:,.0f} MiB resident for a batch of {lanes} robots"
            )


def _table(title: str, entries: dict[str, dict[str, Any]]) -> Table:
    rows = [(name, run, entry) for name, entry in entries.items() for run in entry["by_lanes"]]
    shown = {
        heading: column
        for heading, column in _COLUMNS.items()
        if any(column[0] in run for _, run, _ in rows)
    }
    table = Table("engine", title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in shown:
        table.add_column(heading, justify="right")
    for name, run, entry in rows:
        figures = [f"{run[key]:{form}}" if key in run else "" for key, form in shown.values()]
        style = "bold" if run["lanes"] == entry["lanes"] else ""
        table.add_row(name, *figures, style=style)
    return table
