"""Counts the floating-point operations of a JAX function.

XLA's own cost analysis takes a loop's body once, because it does not know how often it runs.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Literal

# One operation for each element of the result; of functions such as `exp`, too.
_EACH = {
    *("add", "sub", "mul", "div", "rem", "neg", "abs", "sign", "max", "min", "add_any"),
    *("sqrt", "rsqrt", "cbrt", "square", "pow", "exp", "exp2", "expm1", "log", "log1p"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "logistic"),
    *("erf", "erf_inv", "floor", "ceil", "round", "nextafter", "select_n"),
    *("cumsum", "cumprod", "cummax", "cummin"),
}
_COMPARED = {"eq", "ne", "lt", "le", "gt", "ge", "is_finite"}
_REDUCED = {"reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "argmax", "argmin"}
_SCATTERED = {"scatter-add", "scatter-sub", "scatter-mul", "scatter-min", "scatter-max"}


def count(fn: Callable[..., Any], *args: Any, rounds: float | None = None) -> float:
    """Count the floating-point operations of `fn(*args)`.

    An addition, multiplication, division, root, minimum, comparison, choice or function of one
    number counts 1, a fused multiply-add 2, a matrix product 2 m n k. Operations on whole numbers,
    and those that only move numbers, count nothing. Of a condition's branches the costliest counts.

    Args:
      fn: a function that JAX can trace.
      args: its arguments, arrays or numbers; their values are not looked at.
      rounds: how often loops run whose values decide it.

    Returns:
      The number of operations.

    Raises:
      ValueError: a loop runs as often as its values decide, and `rounds` is not given.
    """
    closed = jax.make_jaxpr(fn)(*args)
    known = dict(zip(closed.jaxpr.constvars, closed.consts, strict=True))
    return _count(closed.jaxpr, known, rounds)


def _count(jaxpr: Any, known: dict[Any, Any], rounds: float | None) -> float:
    """Count a jaxpr's operations; `known` has the values of those variables that are constants."""
    return sum(_of_equation(equation, known, rounds) for equation in jaxpr.eqns)


def _of_equation(equation: Any, known: dict[Any, Any], rounds: float | None) -> float:
    name, params = equation.primitive.name, equation.params
    inputs, outputs = equation.invars, equation.outvars
    if name == "scan":
        return params["length"] * _inside(params["jaxpr"], [], rounds)
    if name == "while":
        return _of_while(params, [_value(atom, known) for atom in inputs], rounds)
    if name == "cond":
        values = [_value(atom, known) for atom in inputs[1:]]
        return max(_inside(branch, values, rounds) for branch in params["branches"])
    if name == "dot_general":
        (contracted, _), _ = params["dimension_numbers"]
        shape = inputs[0].aval.shape
        return 2.0 * _floats(outputs) * math.prod(shape[axis] for axis in contracted)
    if name == "integer_pow":  # by repeated squaring
        power = abs(params["y"])
        products = power.bit_length() + power.bit_count() - 2 + (params["y"] < 0)
        return _floats(outputs) * max(products, 0)
    if name == "clamp":
        return 2.0 * _floats(outputs)
    if name in _EACH:
        return _floats(outputs)
    if name in _COMPARED:
        return _floats(inputs[:1]) and float(outputs[0].aval.size)
    if name in _REDUCED:
        return _floats(inputs[:1]) and float(inputs[0].aval.size - outputs[0].aval.size)
    if name in _SCATTERED:
        return _floats(inputs[2:])
    for key in ("jaxpr", "call_jaxpr", "fun_jaxpr"):  # `jit` and its like
        if key in params:
            return _inside(params[key], [_value(atom, known) for atom in inputs], rounds)
    return 0.0


def _of_while(params: dict[str, Any], values: list[Any], rounds: float | None) -> float:
    """Count a loop that counts from a constant to a constant, as `fori_loop` makes it."""
    condition, body = params["cond_jaxpr"], params["body_jaxpr"]
    of_condition, of_body = params["cond_nconsts"], params["body_nconsts"]
    constants, carried = values[:of_condition], values[of_condition + of_body :]
    trips = _trips(condition.jaxpr, body.jaxpr, constants, carried, of_body)
    trips = rounds if trips is None else trips
    if trips is None:
        raise ValueError("a while loop without a constant number of rounds cannot be counted")
    inside = [*values[of_condition : of_condition + of_body], *[None] * len(carried)]
    return trips * _inside(body, inside, rounds)


def _trips(condition: Any, body: Any, constants: list, carried: list, of_body: int) -> int | None:
    """How often a loop `i < end; i += 1` runs; None where it is another, or not constant."""
    start, end = len(constants), None
    if [equation.primitive.name for equation in condition.eqns] != ["lt"]:
        return None
    counter, limit = condition.eqns[0].invars
    if isinstance(counter, Literal) or counter not in condition.invars[start:]:
        return None
    number = condition.invars.index(counter) - start
    if isinstance(limit, Literal):
        end = limit.val
    elif limit in condition.invars[:start]:
        end = constants[condition.invars.index(limit)]
    elif limit in condition.invars:  # the loop carries it, unchanged
        place = condition.invars.index(limit) - start
        if body.outvars[place] is body.invars[of_body + place]:
            end = carried[place]
    ours, after = body.invars[of_body + number], body.outvars[number]
    by_one = any(
        equation.outvars == [after]
        and equation.primitive.name == "add"
        and equation.invars[0] is ours
        and isinstance(equation.invars[1], Literal)
        and equation.invars[1].val == 1
        for equation in body.eqns
    )
    if end is None or carried[number] is None or not by_one:
        return None
    return max(int(end) - int(carried[number]), 0)


def _inside(inner: Any, values: list[Any], rounds: float | None) -> float:
    """Count the operations of a jaxpr that an equation holds, given the constants among inputs."""
    jaxpr = getattr(inner, "jaxpr", inner)
    known = dict(zip(jaxpr.constvars, getattr(inner, "consts", ()), strict=False))
    known |= {var: v for var, v in zip(jaxpr.invars, values, strict=False) if v is not None}
    return _count(jaxpr, known, rounds)


def _value(atom: Any, known: dict[Any, Any]) -> Any:
    """The value of a number that is constant; None: it is not."""
    return atom.val if isinstance(atom, Literal) else known.get(atom)


def _floats(atoms: Iterable[Any]) -> float:
    """Number of elements of those arrays that have floating-point numbers."""
    return float(sum(a.aval.size for a in atoms if jnp.issubdtype(a.aval.dtype, jnp.floating)))
