"""Makes the predictors of time: collects futures, trains, judges, and writes all files.

They are judged on held-out scenes. `--judge-only` judges those in `--out`, and trains none.

    python experiments/train_times.py [--scale 0.3] [--data DIR] [--out DIR] [--judge-only]

Data that are already in `--data` are kept, and an interrupted collection is continued. All figures
of `checkpoints/TIMES.md` come from this script. Intervals are 95 %, by scenes drawn again.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import polars as pl
import tyro
from matplotlib.figure import Figure
from predictor_data import EVERY, collect
from predictor_evaluation import Estimate, bootstrap, windows
from study_rows import estimate, table

from pgf_jax import configure
from pgf_jax.files import png, read_json, write_atomically
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.guidance.predictors import checkpoint as ckpt
from pgf_jax.guidance.predictors.features import STATE
from pgf_jax.guidance.predictors.registry import PredictorSpec, predictor_spec
from pgf_jax.guidance.predictors.survival import HORIZON, TimeToSolution
from pgf_jax.scene import PRESETS
from pgf_jax.tables.forks import read_futures
from pgf_jax.tables.runs import Mode, runs_path
from pgf_jax.training import train as training
from pgf_jax.training.config import TrainConfig
from pgf_jax.training.fit import Trained
from pgf_jax.training.rows import stands_for

NETWORKS = ("time_alone", "time_helped")
COLLECTIONS = (  # see `predictor_data`
    ("train", "futures", 6000, 0, (*EVERY, "--keys", "1", "--states", "5")),
    ("test", "futures", 480, 1_000_000, (*EVERY, "--keys", "6", "--states", "1")),
)
STEP_S = 2 * FleetConfig().rollout_time_s  # of an iteration
SERVICE_S = FleetConfig().service_mean_s
TASK_LIMIT_S = FleetConfig().task_limit_s
WITHIN = 10  # iterations: of the probabilities that are judged
WINDOW = 8  # robots of which one is served
TENTHS = 10


@dataclasses.dataclass(frozen=True)
class Config:
    """Options of the script."""

    scale: float = 0.3  # of the numbers of scenes
    data: Path = Path("data/times")
    out: Path = Path("checkpoints")
    judge_only: bool = False  # the networks in `out`, on scenes held out


@dataclasses.dataclass(frozen=True, eq=False)
class Futures:
    """Held-out futures: F states under K keys each.

    Attributes:
      scene, scene_class: [F].
      states: [F, S].
      seconds: which -> [F, K] until it was solved, or cut off, s.
      solved: which -> [F, K].
      remaining_s: [F] that was left of the task's limit, but for the time of checks, s.
      weight: [F] of how many states of its run each is one; see `rows.stands_for`.
    """

    scene: np.ndarray
    scene_class: np.ndarray
    states: np.ndarray
    seconds: dict[str, np.ndarray]
    solved: dict[str, np.ndarray]
    remaining_s: np.ndarray
    weight: np.ndarray

    def saved(self, keys: slice = slice(None)) -> np.ndarray:
        """[F] true time that help saves where the robot plans on, services of `SERVICE_S`, s.

        By all pairs of a future alone and one with help, of some keys; up to the task's limit.
        """
        alone = self.seconds["alone"][:, keys, None]
        helped = self.seconds["helped"][:, None, keys]
        with_help = np.minimum(
            SERVICE_S + helped, np.maximum(self.remaining_s, SERVICE_S)[:, None, None]
        )
        return np.where(alone > SERVICE_S, alone - with_help, 0.0).mean(axis=(1, 2))


def futures_of(frame: pl.DataFrame) -> Futures:
    """The arrays of a table of futures, without states that lack a feature."""
    first = frame.filter(pl.col("key") == 0)
    states = first.select(f"state:{name}" for name in STATE).to_numpy()
    kept = np.isfinite(states).all(axis=1)

    def by_key(column: str) -> np.ndarray:
        return frame[column].to_numpy().reshape(len(first), -1)[kept]

    return Futures(
        scene=first["scene"].to_numpy()[kept],
        scene_class=first["class"].to_numpy()[kept],
        states=states[kept],
        seconds={which: by_key(f"{which}_s") for which in ("alone", "helped")},
        solved={which: by_key(f"{which}_solved") for which in ("alone", "helped")},
        remaining_s=TASK_LIMIT_S - STEP_S * (0.5 + first["iteration"].to_numpy()[kept]),
        weight=stands_for(first)[kept].astype(float),
    )


def concordance(predicted: np.ndarray, seconds: np.ndarray, solved: np.ndarray) -> float:
    """Harrell's C: of pairs of states, how often the longer prediction takes longer.

    Args:
      predicted: [F] times, or [F, K] by key.
      seconds, solved: [F, K] what came. Pairs under one key count whose order is known: the
        shorter one was solved. Equal predictions count half.
    """
    right = known = 0.0
    if predicted.ndim == 1:
        predicted = np.broadcast_to(predicted[:, None], seconds.shape)
    for guess, time, done in zip(predicted.T, seconds.T, solved.T, strict=True):
        # A future that was cut off takes longer than one that was solved at that time.
        later = (time[None, :] > time[:, None]) | ((time[None, :] == time[:, None]) & ~done[None])
        pairs = done[:, None] & later
        known += pairs.sum()
        right += (pairs & (guess[None, :] > guess[:, None])).sum()
        right += 0.5 * (pairs & (guess[None, :] == guess[:, None])).sum()
    return float(right / known) if known else float("nan")


def calibration(
    predicted: np.ndarray, happened: np.ndarray, weight: np.ndarray, scene: np.ndarray
) -> list[tuple[float, Estimate]]:
    """Mean predicted probability, and how often it happened, of tenths of the weight."""
    order, out = np.argsort(predicted, kind="stable"), []
    tenth = np.minimum(TENTHS * np.cumsum(weight[order]) / weight.sum(), TENTHS - 0.5).astype(int)
    for number in range(TENTHS):
        part = order[tenth == number]

        def mean(values: np.ndarray, index: np.ndarray, part=part) -> float:
            return float(np.average(values[part][index], weights=weight[part][index]))

        seen = bootstrap(lambda i, mean=mean: mean(happened, i), scene[part], 300)
        out.append((mean(predicted, np.arange(len(part))), seen))
    return out


def of_others(seconds: np.ndarray) -> np.ndarray:
    """[F, K] the mean time of a state's other futures: what may be known but for the noise."""
    return (seconds.sum(axis=1, keepdims=True) - seconds) / (seconds.shape[1] - 1)


def restricted_mean(survival: np.ndarray) -> np.ndarray:
    """[F, H] -> [F] mean time up to H iterations, s."""
    return STEP_S * (1 + survival[:, :-1].sum(axis=1))


def time_saved(alone: np.ndarray, helped: np.ndarray, remaining_s: np.ndarray) -> np.ndarray:
    """[F] what `time-saved` would bid: by that policy itself, with services of `SERVICE_S`."""
    from pgf_jax.fleet.index import RobotState
    from pgf_jax.fleet.policies import TaskProgress, make_policy
    from pgf_jax.fleet.robots import TimeLeft
    from pgf_jax.fleet.stub import outcome

    config = FleetConfig(policy="time-saved", service_sd_s=0.0, reservation=-1e9)
    robots = [
        RobotState(
            TaskProgress(i, 0, 5, 0, float(remaining_s[i])),
            dataclasses.replace(outcome(), time_left=TimeLeft(tuple(alone[i]), tuple(helped[i]))),
            0.0,
        )
        for i in range(len(alone))
    ]
    policy = make_policy(config)
    return np.array(policy.index(robots))  # pyright: ignore[reportAttributeAccessIssue]


def judge(futures: Futures, predictor: TimeToSolution) -> dict:
    """All figures, fit for JSON."""
    survival = predictor.survival(futures.states)  # [F, 2, H]
    content: dict = {"states": len(futures.scene)}
    for i, which in enumerate(("alone", "helped")):
        seconds, solved = futures.seconds[which], futures.solved[which]
        mean = restricted_mean(survival[:, i])
        others = of_others(seconds)
        by_class = {}
        for name in (*PRESETS, "every"):
            part = np.flatnonzero((futures.scene_class == name) | (name == "every"))

            def figure(index: np.ndarray, part=part, by=mean, seconds=seconds, solved=solved):
                at = part[index]
                return concordance(by[at], seconds[at], solved[at])

            ceiling = figure(np.arange(len(part)), by=others)
            by_class[name] = (len(part), bootstrap(figure, futures.scene[part], 300), ceiling)
        # Known of all: whoever was cut off before has not been solved by then.
        seen = solved & (np.ceil(seconds / STEP_S) <= WITHIN)
        known = (solved | (np.floor(seconds / STEP_S) >= WITHIN)).all(axis=1)
        predicted, happened = 1 - survival[known, i, WITHIN - 1], seen[known].mean(axis=1)
        # A run gives one state, whatever it lasts: in a fleet states of long runs are as much more.
        weight = futures.weight[known]
        brier = np.average(((predicted[:, None] - seen[known]) ** 2).mean(axis=1), weights=weight)
        base = np.average(seen[known].mean(axis=1), weights=weight)
        content[which] = {
            "concordance": {n: (k, dataclasses.asdict(c), m) for n, (k, c, m) in by_class.items()},
            "calibration": [
                (p, dataclasses.asdict(s))
                for p, s in calibration(predicted, happened, weight, futures.scene[known])
            ],
            "brier": float(brier),
            "brier_of_the_mean": float(base * (1 - base)),
        }
    best, _ = predictor_spec("best").load()
    bids = {
        "time-saved": time_saved(survival[:, 0], survival[:, 1], futures.remaining_s),
        "best": best.gain(futures.states),
        "time left alone": restricted_mean(survival[:, 0]),
    }
    bids["chance"] = np.zeros(len(futures.scene))  # among equal bids a random one wins
    scores = windows(bids, futures.saved(), WINDOW, beside=("chance", "best"))
    # What may be known but for the noise: bids by half of the futures, judged by the others.
    halves = {"half of the futures": futures.saved(slice(0, None, 2))} | {
        name: bids[name] for name in ("chance", "best")
    }
    judged = windows(halves, futures.saved(slice(1, None, 2)), WINDOW, beside=("chance", "best"))
    scores["half of the futures"] = judged["half of the futures"]
    content["regret"] = {
        name: {
            "s": score.regret.value,
            **{other: dataclasses.asdict(share) for other, share in score.to.items()},
        }
        for name, score in scores.items()
    }
    content["saved"] = float(futures.saved().mean())
    return content


def draw(content: dict) -> bytes:
    """The reliability diagram, as a PNG."""
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    for axes, which in zip(figure.subplots(1, 2), ("alone", "helped"), strict=True):
        rows = content[which]["calibration"]
        p = [predicted for predicted, _ in rows]
        seen = [of["value"] for _, of in rows]
        ends = [[e[end] for _, e in rows] for end in ("low", "high")]
        axes.plot([0, 1], [0, 1], color="0.7")
        axes.vlines(p, *ends, color="C0")
        axes.plot(p, seen, "o", color="C0")
        axes.set(title=which, xlabel=f"predicted: solved within {WITHIN} iterations", ylabel="seen")
    return png(figure)


def readme(content: dict, files: Sequence[str], scale: float) -> str:
    """The text of TIMES.md."""
    alone, helped = content["alone"], content["helped"]
    percent: Callable[[float], str] = lambda p: f"{100 * p:.0f} %"  # noqa: E731
    return f"""# Predictors of time

The networks of the policies `time-saved`, `gain-rate` and `urgency`: how long a reach will still
take, alone and from an operator's answer on. Written, with all figures (`times.json`), by

    python experiments/train_times.py --scale {scale:g}

{table(("file", "size", "sha256"), [line.strip("| ").split(" | ") for line in files])}

They are discrete-time survival models: the network gives the chance that the reach is solved in the
iteration that is k from now, if it was not before. Trained on {content["train_states"]} states of
{content["train_scenes"]} scenes of all six classes in turn, each carried on to its end, or to the
task's limit of 180 s, once alone and once with the heuristic operator's input. Judged on
{content["states"]} states of other scenes, each with 6 futures of both kinds. Solutions were
checked in the solid world.

Harrell's concordance of the mean time to solution, 95 % by scenes drawn again. "By the others" is
that of the mean of a state's other futures: what may be known but for the noise to come.

{
        table(
            ("class", "states", "alone", "by the others", "helped", "by the others"),
            [
                (
                    name,
                    str(alone["concordance"][name][0]),
                    *(
                        cell
                        for which in (alone, helped)
                        for _, found, ceiling in [which["concordance"][name]]
                        for cell in (estimate(found), f"{ceiling:.2f}")
                    ),
                )
                for name in alone["concordance"]
            ],
        )
    }

Solved within {WITHIN} iterations (30 s), predicted and seen, by tenths of the states
([figure](times.png)). States count as often as their runs had others, as they do in a fleet. Brier
score alone {alone["brier"]:.3f} (of the mean {alone["brier_of_the_mean"]:.3f}), helped
{helped["brier"]:.3f} ({helped["brier_of_the_mean"]:.3f}).

{
        table(
            ("tenth", "alone: predicted", "seen", "helped: predicted", "seen"),
            [
                (
                    str(i + 1),
                    percent(a[0]),
                    estimate(a[1], 0, 100, " %"),
                    percent(h[0]),
                    estimate(h[1], 0, 100, " %"),
                )
                for i, (a, h) in enumerate(
                    zip(alone["calibration"], helped["calibration"], strict=True)
                )
            ],
        )
    }

Regret of serving the highest bid among {WINDOW} states: time that would have been saved more by the
best choice, with services of {SERVICE_S:g} s beside which the robot plans on. Help saves
{content["saved"]:.1f} s in the mean.

{
        table(
            ("bids by", "regret, s", "as a share of chance's", "as a share of that of `best`"),
            [
                (name, f"{of['s']:.1f}", estimate(of["chance"]), estimate(of["best"]))
                for name, of in content["regret"].items()
            ],
        )
    }
"""


def train(config: Config) -> tuple[TimeToSolution, list[str], dict]:
    """Collect the data to train on, train, and save; returns what TIMES.md says of it, too."""
    collect(COLLECTIONS[:1], config.data, config.scale)
    path = runs_path(config.data / "train", Mode.FUTURES)
    frame = read_futures(path)
    done: dict[str, Trained] = {}
    files = []
    for network in NETWORKS:
        rows = training.RECIPES[network].rows(frame)
        done[network] = training.fit_network(network, rows, TrainConfig(seed=0))
        about = training.report_of(done[network], rows)
        about["data_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
        training.save(config.out, network, done[network], about, TrainConfig())
        files.append(file_row(config.out / ckpt.checkpoint_name(network)))
        print(network, {k: v for k, v in about.items() if k != "data_sha256"}, flush=True)
    predictor = TimeToSolution(*(done[name].predictor for name in NETWORKS))
    return (
        predictor,
        files,
        {
            "scale": config.scale,
            "horizon": HORIZON,
            "train_states": frame.select("scene", "seed", "iteration").n_unique(),
            "train_scenes": frame["scene"].n_unique(),
        },
    )


def trained(folder: Path) -> tuple[TimeToSolution, list[str], dict]:
    """The networks of a folder, and what its TIMES.md says of their training."""
    predictor, _ = PredictorSpec("time", folder).load()
    before = read_json(folder / "times.json", "figures of networks")
    files = [file_row(folder / ckpt.checkpoint_name(network)) for network in NETWORKS]
    told = ("scale", "horizon", "train_states", "train_scenes")
    return predictor, files, {name: before[name] for name in told}


def file_row(file: Path) -> str:
    """A checkpoint's row in TIMES.md."""
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return f"| `{file.name}` | {file.stat().st_size / 1024:.0f} KiB | {digest} |"


def main(config: Config) -> None:
    """Collect, train, judge, write and print."""
    configure()
    predictor, files, about = trained(config.out) if config.judge_only else train(config)
    collect(COLLECTIONS[1:], config.data, config.scale)
    held_out = futures_of(read_futures(runs_path(config.data / "test", Mode.FUTURES)))
    content = judge(held_out, predictor) | about
    write_atomically(config.out / "times.json", (json.dumps(content, indent=1) + "\n").encode())
    write_atomically(config.out / "times.png", draw(content))
    text = readme(content, files, about["scale"])
    write_atomically(config.out / "TIMES.md", text.encode())
    print(text)


if __name__ == "__main__":
    main(tyro.cli(Config))
