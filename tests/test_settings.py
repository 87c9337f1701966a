"""Bounds of settings: in their types, and checked with them."""

import dataclasses
import math
import sys
import typing
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from tyro.conf import Positional

from pgf_jax.collection.config import CollectConfig
from pgf_jax.console.config import ConsoleConfig
from pgf_jax.errors import BadInput, did_you_mean
from pgf_jax.fleet.config import FleetConfig
from pgf_jax.inspection.config import ReproduceConfig, VerifyConfig
from pgf_jax.plans.config import PlanCommand, PlanConfig
from pgf_jax.profiling.config import ProfileConfig
from pgf_jax.render.config import RenderConfig
from pgf_jax.settings import MAX_SEED, Bounds, Count, Seconds, check_fields, check_int, check_type
from pgf_jax.sweeping.config import SweepConfig
from pgf_jax.training.config import TrainConfig


@dataclasses.dataclass(frozen=True)
class Settings:
    one: Count = 1
    some: tuple[Count, ...] = ()
    perhaps: Seconds | None = None
    first: Positional[Count] = 1
    share: Annotated[float, Bounds(above=0, below=1)] = 0.5
    any: float = 0.0
    path: Annotated[Path | None, "no bounds"] = None
    outside: Annotated[tuple[int, ...] | None, Bounds(1)] = None
    names: tuple[str, ...] = ()
    pair: tuple[int, int] = (1, 2)
    loss: Literal["rmse", "mae"] = "rmse"

    def __post_init__(self) -> None:
        check_fields(self)


@pytest.mark.parametrize(
    ("bounds", "kind", "words"),
    [
        (Bounds(1), int, "a whole number 1 or more"),
        (Bounds(0, MAX_SEED), int, "a whole number within 0..4294967295"),
        (Bounds(most=3), int, "a whole number 3 or less"),
        (Bounds(0.0, unit="seconds"), float, "a number of seconds, 0 or more"),
        (Bounds(1e-9, unit="seconds"), float, "a number of seconds, 1e-09 or more"),
        (Bounds(above=0), float, "a number above 0"),
        (Bounds(0, below=1), float, "a number 0 or more and below 1"),
        (Bounds(above=0, below=1), float, "a number above 0 and below 1"),
        (Bounds(0, 1), float, "a number within 0..1"),
        (Bounds(), float, "a finite number"),
    ],
)
def test_bounds_in_words(bounds, kind, words):
    assert bounds.words(kind) == words


@pytest.mark.parametrize(
    ("bounds", "inside", "outside"),
    [
        (Bounds(1), (1, 2, 2**62), (0, -1)),
        (Bounds(0, 3), (0, 3), (-1, 4)),
        (Bounds(above=0, below=1), (5e-324, 0.5), (0, -0.0, 1, 1.0)),
        (Bounds(), (-1e308, 0, sys.float_info.max), (math.inf, -math.inf, math.nan, 10**400)),
        (Bounds(0.0), (0, 0.0, 1e308), (math.inf, math.nan, -5e-324, 10**400)),
    ],
)
def test_what_bounds_contain(bounds, inside, outside):
    assert all(map(bounds.contains, inside))
    assert not any(map(bounds.contains, outside))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"one": 0}, "one: expected a whole number 1 or more, got 0"),
        ({"one": True}, "one: expected a whole number 1 or more, got True"),
        ({"one": 1.0}, "one: expected a whole number 1 or more, got 1.0"),
        ({"one": 2**63}, "one: expected a whole number of 64 bits, got 9223372036854775808"),
        ({"one": None}, "one: expected a whole number 1 or more, got None"),
        ({"some": (1, 0)}, "some: expected a whole number 1 or more, got 0"),
        ({"perhaps": math.nan}, "perhaps: expected a number of seconds, 0 or more, got nan"),
        ({"perhaps": "1"}, "perhaps: expected a number of seconds, 0 or more, got '1'"),
        ({"first": 0}, "first: expected a whole number 1 or more, got 0"),
        ({"share": 1}, "share: expected a number above 0 and below 1, got 1"),
        ({"any": "x"}, "any: expected a number, got 'x'"),
        ({"path": 1}, "path: expected a path, got 1"),
        ({"outside": (1, 0)}, "outside: expected a whole number 1 or more, got 0"),
        ({"some": 5}, "some: expected a list of whole numbers, as in some=(5,), got 5"),
        ({"some": "5"}, "some: expected a list of whole numbers, got '5'"),
        ({"some": range(10_001)}, "some: expected a list of at most 10000 values, got range("),
        ({"names": "a"}, "names: expected a list of names, as in names=('a',), got 'a'"),
        ({"names": "a,b"}, "names: expected a list of names, as in names=('a', 'b'), got 'a,b'"),
        ({"pair": 1}, "pair: expected a list of 2 whole numbers, got 1"),
        ({"loss": "RMSE"}, "loss: expected one of rmse, mae, got 'RMSE': did you mean rmse?"),
        ({"path": Bounds(1)}, "path: expected a path, got a Bounds"),
    ],
)
def test_a_value_out_of_bounds_is_named(given, message):
    with pytest.raises(BadInput) as error:
        Settings(**given)
    assert str(error.value).startswith(message)


@pytest.mark.parametrize(
    ("got", "hint"),
    [
        ("PGF", ": did you mean pgf?"),
        ("or_hitl", ": did you mean or-hitl?"),  # and not or-hitl-window
        ("hitl", ": did you mean or-hitl or or-hitl-window?"),
        ("pfg", ""),
        ("quue", ": did you mean queue?"),
        ("queued", ": did you mean queue?"),
        ("q", ""),
        ("", ""),
        ("z" * 10_000, ""),
    ],
)
def test_hints(got, hint):
    assert did_you_mean(got, ["pgf", "or-hitl", "or-hitl-window", "queue", "question"]) == hint


@pytest.mark.parametrize(
    ("value", "got"),
    [
        (Settings(), "a Settings"),
        (Bounds, "the class Bounds: did you mean Bounds(...)?"),
        ({"least": 1}, "{'least': 1}"),
        (print, "the function print"),
    ],
)
def test_a_value_of_another_class_is_named(value, got):
    check_type("config", Bounds(), Bounds)
    with pytest.raises(BadInput) as error:
        check_type("config", value, Bounds)
    assert str(error.value) == f"config: expected a Bounds, got {got}"


def test_what_lies_within_is_taken():
    made = Settings(one=2**62, some=[1, 2], perhaps=0, any=math.nan, path="x")  # pyright: ignore
    assert (made.one, made.some, made.perhaps, made.path) == (2**62, (1, 2), 0, Path("x"))


@pytest.mark.parametrize(("value", "within"), [(0, True), (7, True), (8, False), ("x", False)])
def test_bounds_that_other_settings_decide(value, within):
    if within:
        return check_int("seed", value, 0, 7)
    with pytest.raises(BadInput, match=r"^seed: expected a whole number within 0\.\.7, got "):
        check_int("seed", value, 0, 7)


def numbers(hint: Any, bounded: bool = False) -> list[bool]:
    """For each number in a type: whether it has bounds."""
    if typing.get_origin(hint) is Annotated:
        inner, *metadata = typing.get_args(hint)
        return numbers(inner, bounded or any(isinstance(one, Bounds) for one in metadata))
    if hint in (int, float):
        return [bounded]
    return [found for inner in typing.get_args(hint) for found in numbers(inner, bounded)]


@pytest.mark.parametrize(
    "config",
    [
        CollectConfig,
        ConsoleConfig,
        FleetConfig,
        PlanCommand,
        PlanConfig,
        ProfileConfig,
        RenderConfig,
        ReproduceConfig,
        SweepConfig,
        TrainConfig,
        VerifyConfig,
    ],
)
def test_every_number_has_bounds(config):
    hints = typing.get_type_hints(config, include_extras=True)
    found = {field.name: numbers(hints[field.name]) for field in dataclasses.fields(config)}
    assert all(map(all, found.values())), found
    assert sum(map(len, found.values())) >= 2
