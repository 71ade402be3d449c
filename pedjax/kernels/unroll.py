"""A function's jaxpr with its structural axes unrolled: from arrays to a graph of single numbers.

The function is traced without lanes, so that every element of every array in it is one number; how many
lanes each has is decided where the graph is evaluated. What only moves elements costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from pedjax.kernels.graph import OPERATIONS, Graph

Numbers = np.ndarray
"""An array of node numbers, of the shape of the array that they stand for."""


class CannotUnrollError(ValueError):
    """A step has something that a kernel cannot hold; the message names it."""


_SAME = {"stop_gradient", "copy", "copy_p", "optimization_barrier"}
_REDUCTIONS = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_and": "and",
    "reduce_or": "or",
}
_RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}
_EXTREMES = {"argmax": "gt", "argmin": "lt"}
_CALLS = {
    "jit", "pjit", "closed_call", "core_call", "remat", "remat2", "checkpoint",
    "custom_jvp_call", "custom_vjp_call", "custom_vjp_call_jaxpr", "linear_call",
}  # fmt: skip
_DATA = {
    "gather": (0,), "scatter": (0, 2), "dynamic_slice": (0,), "dynamic_update_slice": (0, 1), "pad": (0, 1),
}  # fmt: skip
"""Which operands are moved; the others say where to, and have to be known."""
_LONGEST = 64  # turns of a loop inside a step that are written out


def _split(x: Numbers, p: dict[str, Any]) -> list[Numbers]:
    return np.split(x, np.cumsum(p["sizes"])[:-1], axis=p["axis"])


def _broadcast(x: Numbers, p: dict[str, Any]) -> Numbers:
    shape = [1] * len(p["shape"])
    for to, n in zip(p["broadcast_dimensions"], x.shape, strict=True):
        shape[to] = n
    return np.broadcast_to(x.reshape(shape), p["shape"])


def _slice(x: Numbers, p: dict[str, Any]) -> Numbers:
    strides = p["strides"] or (1,) * x.ndim
    cuts = zip(p["start_indices"], p["limit_indices"], strides, strict=True)
    return x[tuple(slice(*cut) for cut in cuts)]


_MOVES: dict[str, Callable[[list[Numbers], dict[str, Any], tuple[int, ...]], Any]] = {
    "reshape": lambda x, p, shape: x[0].reshape(shape),
    "squeeze": lambda x, p, shape: x[0].reshape(shape),
    "expand_dims": lambda x, p, shape: x[0].reshape(shape),
    "broadcast_in_dim": lambda x, p, shape: _broadcast(x[0], p),
    "transpose": lambda x, p, shape: x[0].transpose(p["permutation"]),
    "slice": lambda x, p, shape: _slice(x[0], p),
    "rev": lambda x, p, shape: np.flip(x[0], p["dimensions"]),
    "concatenate": lambda x, p, shape: np.concatenate(x, axis=p["dimension"]),
    "stack": lambda x, p, shape: np.stack(x, axis=p["axis"]),
    "split": lambda x, p, shape: _split(x[0], p),
    "unstack": lambda x, p, shape: list(np.moveaxis(x[0], p["axis"], 0)),
}

KNOWN = (
    set(OPERATIONS) | set(_REDUCTIONS) | set(_RUNNING) | set(_EXTREMES) | set(_MOVES) | set(_DATA)
    | {"add_any", "square", "integer_pow", "clamp", "convert_element_type", "iota", "dot_general"}
    | {"cond", "scan"} | _CALLS | _SAME
)  # fmt: skip
"""Every primitive that can be unrolled (some only with indices that are known)."""


def _inner(value: Any) -> list[Jaxpr]:
    if isinstance(value, ClosedJaxpr):
        return [value.jaxpr]
    if isinstance(value, Jaxpr):
        return [value]
    if isinstance(value, tuple | list):
        return [jaxpr for each in value for jaxpr in _inner(each)]
    return []


def primitives(jaxpr: Jaxpr) -> set[str]:
    """Names of all primitives in a jaxpr and in what it calls."""
    found = set()
    for eqn in jaxpr.eqns:
        name = eqn.primitive.name
        found.add(name)
        if name in KNOWN and not name.startswith(("reduce_", "scatter", "custom_")):
            for value in eqn.params.values():
                for inner in _inner(value):
                    found |= primitives(inner)
        elif name.startswith("custom_"):
            found |= primitives(_called(eqn.params)[0])
    return found


def unknown_primitives(jaxpr: Jaxpr) -> set[str]:
    """Those that cannot be unrolled."""
    return primitives(jaxpr) - KNOWN


def _called(params: dict[str, Any]) -> tuple[Jaxpr, Sequence[Any]]:
    """The jaxpr behind a call, and its constants."""
    inner = next(params[key] for key in ("jaxpr", "call_jaxpr", "fun_jaxpr", "callee") if key in params)
    return (inner.jaxpr, inner.consts) if isinstance(inner, ClosedJaxpr) else (inner, ())


def constants(graph: Graph, x: Any) -> Numbers:
    """Nodes of an array that is known."""
    x = np.asarray(x)
    flat = [graph.constant(each, x.dtype) for each in x.reshape(-1)]
    return np.array(flat, np.int32).reshape(x.shape)


def unroll(graph: Graph, jaxpr: Jaxpr, consts: Sequence[Any], args: Sequence[Numbers]) -> list[Numbers]:
    """Nodes of a jaxpr's results from nodes of its arguments."""
    value: dict[Any, Numbers] = dict(zip(jaxpr.invars, args, strict=True))
    value |= {var: constants(graph, c) for var, c in zip(jaxpr.constvars, consts, strict=True)}

    def read(var: Any) -> Numbers:
        if isinstance(var, Literal):
            aval: Any = var.aval
            return constants(graph, np.asarray(var.val, aval.dtype))
        return value[var]

    for eqn in jaxpr.eqns:
        found = _rule(graph, eqn, [read(var) for var in eqn.invars])
        for var, numbers in zip(eqn.outvars, found, strict=True):
            numbers = np.asarray(numbers, np.int32)
            shape: Any = var.aval
            assert numbers.shape == tuple(shape.shape), (eqn, numbers.shape)
            value[var] = numbers
    return [read(var) for var in jaxpr.outvars]


def _rule(graph: Graph, eqn: Any, x: list[Numbers]) -> list[Numbers]:
    name, p, out = eqn.primitive.name, eqn.params, eqn.outvars[0].aval
    shape, dtype = tuple(out.shape), out.dtype

    def each(op: str, *operands: Numbers, dtype: Any = dtype) -> Numbers:
        wide = np.broadcast_arrays(*operands)
        flat = [graph.apply(op, dtype, *map(int, e)) for e in zip(*(w.flat for w in wide), strict=True)]
        return np.array(flat, np.int32).reshape(wide[0].shape)

    if name in _MOVES:
        found = _MOVES[name](x, p, shape)
        return found if isinstance(found, list) else [found]
    if name in _SAME:
        return x
    if name in _CALLS:
        return unroll(graph, *_called(p), x)
    if name == "select_n" and len(x) != 3:
        raise CannotUnrollError(f"a choice among {len(x) - 1}")
    if name in OPERATIONS or name == "convert_element_type":
        return [np.broadcast_to(each(name, *x), shape)]
    if name == "add_any":
        return [each("add", *x)]
    if name == "square":
        return [each("mul", x[0], x[0])]
    if name == "clamp":
        return [each("min", each("max", x[1], x[0]), x[2])]
    if name == "integer_pow":
        return [_power(graph, x[0], p["y"], each)]
    if name == "iota":
        with jax.ensure_compile_time_eval():
            return [constants(graph, jax.lax.broadcasted_iota(dtype, p["shape"], p["dimension"]))]
    if name in _REDUCTIONS:
        axes = tuple(p["axes"])
        first = np.moveaxis(x[0], axes, range(len(axes))).reshape(-1, *shape)
        if not len(first):
            raise CannotUnrollError(f"{name} of nothing")
        return [reduce(lambda a, b: each(_REDUCTIONS[name], a, b), first)]
    if name in _RUNNING:
        rows = list(np.moveaxis(x[0], p["axis"], 0))
        rows = rows[::-1] if p["reverse"] else rows
        for k in range(1, len(rows)):
            rows[k] = each(_RUNNING[name], rows[k - 1], rows[k])
        return [np.stack(rows[::-1] if p["reverse"] else rows, axis=p["axis"])]
    if name in _EXTREMES:
        (axis,) = p["axes"]
        rows = list(np.moveaxis(x[0], axis, 0))
        best, where = rows[0], np.full(shape, graph.constant(0, dtype), np.int32)
        for k, row in enumerate(rows[1:], 1):
            better = each(_EXTREMES[name], row, best, dtype=bool)
            best = each("select_n", better, best, row, dtype=eqn.invars[0].aval.dtype)
            where = each("select_n", better, where, np.array(graph.constant(k, dtype)))
        return [where]
    if name == "dot_general":
        return [_product(x[0], x[1], p["dimension_numbers"], each, shape)]
    if name in _DATA:
        return _moved(graph, eqn, x)
    if name == "cond":
        return _cond(graph, eqn, x)
    if name == "scan":
        return _scan(graph, eqn, x)
    raise CannotUnrollError(f"the primitive {name}")


def _power(graph: Graph, x: Numbers, exponent: int, each: Callable[..., Numbers]) -> Numbers:
    found, square, left = None, x, abs(exponent)
    while left:
        if left & 1:
            found = square if found is None else each("mul", found, square)
        left >>= 1
        square = each("mul", square, square) if left else square
    one = np.full(x.shape, graph.constant(1, graph.nodes[x.flat[0]].dtype), np.int32)
    if found is None:
        return one
    return found if exponent > 0 else each("div", one, found)


def _product(
    a: Numbers, b: Numbers, numbers: Any, each: Callable[..., Numbers], shape: tuple[int, ...]
) -> Numbers:
    (sum_a, sum_b), (batch_a, batch_b) = numbers

    def laid(x: Numbers, batch: Any, summed: Any) -> Numbers:
        rest = [k for k in range(x.ndim) if k not in (*batch, *summed)]
        size = [int(np.prod([x.shape[k] for k in part], dtype=int)) for part in (batch, rest, summed)]
        return x.transpose(*batch, *rest, *summed).reshape(size)

    left, right = laid(a, batch_a, sum_a)[:, :, None], laid(b, batch_b, sum_b)[:, None]
    parts = [each("mul", left[..., k], right[..., k]) for k in range(left.shape[-1])]
    return reduce(lambda u, v: each("add", u, v), parts).reshape(shape)


def _value(graph: Graph, numbers: Numbers, what: str) -> np.ndarray:
    """The array behind nodes that are all known."""
    known = [graph.known(k) for k in numbers.flat]
    if any(v is None for v in known):
        raise CannotUnrollError(f"{what} with an index that depends on data")
    dtype = graph.nodes[numbers.flat[0]].dtype if numbers.size else np.int32
    return np.array(known, dtype).reshape(numbers.shape)


def _moved(graph: Graph, eqn: Any, x: list[Numbers]) -> list[Numbers]:
    """What moves elements to places that are known does so with their numbers."""
    name = eqn.primitive.name
    operands = [numbers if k in _DATA[name] else _value(graph, numbers, name) for k, numbers in enumerate(x)]
    with jax.ensure_compile_time_eval():
        found = np.asarray(eqn.primitive.bind(*map(jnp.asarray, operands), **eqn.params))
    if found.min(initial=0) < 0:
        raise CannotUnrollError(f"{name} with an index out of bounds")
    return [found]


def _cond(graph: Graph, eqn: Any, x: list[Numbers]) -> list[Numbers]:
    """All branches, and a choice among their results."""
    branches = [unroll(graph, b.jaxpr, b.consts, x[1:]) for b in eqn.params["branches"]]
    index = int(x[0])
    found = branches[-1]
    for k in range(len(branches) - 2, -1, -1):
        here = graph.apply("eq", bool, index, graph.constant(k, graph.nodes[index].dtype))
        found = [
            np.array(
                [
                    graph.apply("select_n", graph.nodes[b].dtype, here, int(a), int(b))
                    for a, b in zip(other.flat, mine.flat, strict=True)
                ],
                np.int32,
            ).reshape(mine.shape)
            for other, mine in zip(found, branches[k], strict=True)
        ]
    return found


def _scan(graph: Graph, eqn: Any, x: list[Numbers]) -> list[Numbers]:
    """A short loop of known length, written out."""
    p = eqn.params
    length, consts, carried = p["length"], p["num_consts"], p["num_carry"]
    if length > _LONGEST:
        raise CannotUnrollError(f"a loop of {length} turns")
    fixed, carry, given = x[:consts], x[consts : consts + carried], x[consts + carried :]
    rows: list[list[Numbers]] = []
    for k in range(length)[:: -1 if p["reverse"] else 1]:
        found = unroll(graph, p["jaxpr"].jaxpr, p["jaxpr"].consts, [*fixed, *carry, *(g[k] for g in given)])
        carry = found[:carried]
        rows.append(found[carried:])
    rows = rows[::-1] if p["reverse"] else rows
    return [*carry, *(np.stack(column) for column in zip(*rows, strict=True))]
