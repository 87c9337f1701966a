"""The command `train`: trains the predictors, and shows a table of them."""

from pgf_jax.terminal import show_table
from pgf_jax.training.config import TrainCommand
from pgf_jax.training.train import train

_COUNTS = ("runs", "scenes", "rows", "non_finite", "short", "epochs", "best_epoch")
_LOSSES = ("loss_train", "loss_val", "target_std_val")  # in units of the target


def run(command: TrainCommand) -> None:
    """Train the predictors, write their checkpoints and show a table.

    Raises:
      BadInput: data or a setting cannot be used, or a checkpoint cannot be written.
    """
    report = train(command.data, command.out, command.config)
    networks = [name for name in report if name != "files"]
    rows = [(name, *(str(report[network][name]) for network in networks)) for name in _COUNTS]
    rows += [(name, *(f"{report[network][name]:.2f}" for network in networks)) for name in _LOSSES]
    show_table(("", *networks), rows)
    print("\n".join(report["files"]))
