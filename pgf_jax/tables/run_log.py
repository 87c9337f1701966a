"""Records a run while it is planned; importing this does not import Polars, which takes long."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pgf_jax.errors import BadInput

if TYPE_CHECKING:
    import polars as pl


class RunLog:
    """Records one run, iteration by iteration.

    Call `begin_segment` before each segment's iteration 0, `add` at the end of each iteration, and
    `input_given` when human input arrives: before `begin_segment("push")` where it is a push,
    before the next `add` where it is "go on reaching".
    """

    def __init__(self, *, scene: str, seed: int, scene_class: str, n_objects: int) -> None:
        self._run = {"scene": scene, "seed": seed, "class": scene_class, "n_objects": n_objects}
        self._segment = -1
        self._kind = ""
        self._asked = False
        self._rows: list[dict[str, object]] = []

    def begin_segment(self, kind: str) -> None:
        """Begin a segment, a `reach` or a `push`; the next iteration is its iteration 0."""
        if kind not in ("reach", "push"):
            raise BadInput(f"a segment is a reach or a push, got {kind!r}")
        self._segment += 1
        self._kind = kind

    def input_given(self) -> None:
        """Record that human input is given now, before the next iteration."""
        self._asked = True

    def add(self, terms: Sequence[float], *, feasible: bool) -> None:
        """Record an iteration that has ended.

        Args:
          terms: (c_d, c_f, c_b) of the best trajectory so far; in a push (c_h, c_f, c_b).
          feasible: whether that trajectory is feasible.
        """
        if self._segment < 0:
            raise RuntimeError("begin_segment comes before the first iteration")
        c_d, c_f, c_b = (float(term) for term in terms)
        self._rows.append(
            {
                **self._run,
                "segment": self._segment,
                "kind": self._kind,
                "iteration": len(self._rows),
                "c_d": c_d,
                "c_f": c_f,
                "c_b": c_b,
                "feasible": bool(feasible),
                "asked_before": self._asked,
            }
        )
        self._asked = False

    def amend(self, terms: Sequence[float], *, feasible: bool) -> None:
        """Replace what is recorded of the last iteration, which has been checked since."""
        row = self._rows[-1]
        row |= dict(zip(("c_d", "c_f", "c_b"), map(float, terms), strict=True))
        row["feasible"] = bool(feasible)

    def frame(self) -> "pl.DataFrame":
        """The run so far as a table, in the columns of `runs.parquet`."""
        import polars as pl

        from pgf_jax.tables.runs import RUN_SCHEMA

        return pl.DataFrame(self._rows, schema=RUN_SCHEMA)
