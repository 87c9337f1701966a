"""The command `collect`: collects data to train on, and shows what was collected."""

from pgf_jax.collection import collect as collecting
from pgf_jax.collection.config import CollectConfig
from pgf_jax.terminal import Progress, clock, show_table


def run(config: CollectConfig) -> None:
    """Collect the data, with a display of progress, and show a table.

    Raises:
      BadInput: a setting, a session or the folder cannot be used.
      KeyboardInterrupt: interrupted; the message says what is kept.
    """
    what = "tasks" if config.log else "scenes"
    try:
        with Progress(what) as progress:
            done = collecting.collect(config, on_progress=progress.update)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            "interrupted; nothing was written"
            if config.log
            else "interrupted; the runs that had ended are kept, and --resume goes on from them"
        ) from None
    mix = ", ".join(f"{count} {name}" for name, count in done.by_class.items())
    counts = (done.scenes, done.runs, mix, done.solved, done.iterations, done.inputs)
    show_table(
        (what, "with data", "of", "solved", "iterations", "inputs"), [tuple(map(str, counts))]
    )
    how = f"engine {config.engine}, lanes {config.lanes}"
    if config.log:
        how = f"tasks cut off by the end of their session, left out: {done.cut_off}"
    print(f"{done.path}; {how}, {clock(done.seconds)}")
