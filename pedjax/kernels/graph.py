"""Scalar arithmetic as a graph in which nothing is there twice.

A node is one number for each lane. Equal operations on equal operands are one node, whichever way round a
commutative one is written, and what is known beforehand is folded: zeros and ones of identities and constant
matrices cost nothing. A structural zero times anything is zero here, also where the other is not finite.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from jax import lax


class Meaning(NamedTuple):
    """An elementwise operation in numpy, to fold constants and to check, and in `jax.lax`, for kernels."""

    numpy: Callable[..., Any]
    lax: Callable[..., Any]


def _divide(a: Any, b: Any) -> Any:
    if np.issubdtype(np.asarray(a).dtype, np.integer):
        return np.asarray(np.trunc(np.true_divide(a, b))).astype(np.asarray(a).dtype)
    return np.divide(a, b)


def _special(name: str) -> Callable[..., Any]:
    def found(x: Any) -> Any:
        from scipy import special  # here: it takes a tenth of pedjax's start

        return getattr(special, name)(x)

    return found


def _select(which: Any, off: Any, on: Any) -> Any:
    return np.where(which, on, off)


OPERATIONS: dict[str, Meaning] = {
    "add": Meaning(np.add, lax.add),
    "sub": Meaning(np.subtract, lax.sub),
    "mul": Meaning(np.multiply, lax.mul),
    "div": Meaning(_divide, lax.div),
    "rem": Meaning(np.fmod, lax.rem),
    "neg": Meaning(np.negative, lax.neg),
    "abs": Meaning(np.abs, lax.abs),
    "sign": Meaning(np.sign, lax.sign),
    "floor": Meaning(np.floor, lax.floor),
    "ceil": Meaning(np.ceil, lax.ceil),
    "max": Meaning(np.maximum, lax.max),
    "min": Meaning(np.minimum, lax.min),
    "lt": Meaning(np.less, lax.lt),
    "le": Meaning(np.less_equal, lax.le),
    "gt": Meaning(np.greater, lax.gt),
    "ge": Meaning(np.greater_equal, lax.ge),
    "eq": Meaning(np.equal, lax.eq),
    "ne": Meaning(np.not_equal, lax.ne),
    "and": Meaning(np.bitwise_and, lax.bitwise_and),
    "or": Meaning(np.bitwise_or, lax.bitwise_or),
    "xor": Meaning(np.bitwise_xor, lax.bitwise_xor),
    "not": Meaning(np.bitwise_not, lax.bitwise_not),
    "select_n": Meaning(_select, lax.select_n),
    "is_finite": Meaning(np.isfinite, lax.is_finite),
    "sqrt": Meaning(np.sqrt, lax.sqrt),
    "rsqrt": Meaning(lambda x: 1 / np.sqrt(x), lax.rsqrt),
    "cbrt": Meaning(np.cbrt, lax.cbrt),
    "pow": Meaning(np.power, lax.pow),
    "exp": Meaning(np.exp, lax.exp),
    "exp2": Meaning(np.exp2, lax.exp2),
    "expm1": Meaning(np.expm1, lax.expm1),
    "log": Meaning(np.log, lax.log),
    "log1p": Meaning(np.log1p, lax.log1p),
    "logistic": Meaning(_special("expit"), lax.logistic),
    "sin": Meaning(np.sin, lax.sin),
    "cos": Meaning(np.cos, lax.cos),
    "tan": Meaning(np.tan, lax.tan),
    "asin": Meaning(np.arcsin, lax.asin),
    "acos": Meaning(np.arccos, lax.acos),
    "atan": Meaning(np.arctan, lax.atan),
    "atan2": Meaning(np.arctan2, lax.atan2),
    "sinh": Meaning(np.sinh, lax.sinh),
    "cosh": Meaning(np.cosh, lax.cosh),
    "tanh": Meaning(np.tanh, lax.tanh),
    "asinh": Meaning(np.arcsinh, lax.asinh),
    "acosh": Meaning(np.arccosh, lax.acosh),
    "atanh": Meaning(np.arctanh, lax.atanh),
    "erf_inv": Meaning(_special("erfinv"), lax.erf_inv),
}
"""Every elementwise primitive that a kernel can hold: those that Pallas lowers to Triton."""

_COMMUTATIVE = {"add", "mul", "max", "min", "and", "or", "xor", "eq", "ne"}


class Node(NamedTuple):
    """An operation on the nodes `args`; or a "constant" with its value, or an "input" with its name."""

    op: str
    dtype: np.dtype
    args: tuple[Any, ...]


class Graph:
    """Nodes in an order in which each comes after its operands; a node is known by its number."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._number: dict[Node, int] = {}

    def _add(self, node: Node) -> int:
        if node not in self._number:
            self._number[node] = len(self.nodes)
            self.nodes.append(node)
        return self._number[node]

    def constant(self, value: Any, dtype: Any) -> int:
        """A number that is known."""
        dtype = np.dtype(dtype)
        return self._add(Node("constant", dtype, (dtype.type(value).item(),)))

    def input(self, name: Any, dtype: Any) -> int:
        """A number that a run gives."""
        return self._add(Node("input", np.dtype(dtype), (name,)))

    def known(self, number: int) -> Any:
        """The value of a constant, None for anything else."""
        node = self.nodes[number]
        return node.args[0] if node.op == "constant" else None

    def apply(self, op: str, dtype: Any, *args: int) -> int:
        """An operation of the table, or `convert_element_type` to `dtype`, simplified."""
        dtype = np.dtype(dtype)
        values = [self.known(a) for a in args]
        if all(v is not None for v in values):
            typed = [self.nodes[a].dtype.type(v) for a, v in zip(args, values, strict=True)]
            with np.errstate(all="ignore"):
                found = typed[0] if op == "convert_element_type" else OPERATIONS[op].numpy(*typed)
                return self.constant(found, dtype)
        found = self._simpler(op, dtype, args, values)
        if found is not None:
            return found
        if op in _COMMUTATIVE:
            args = tuple(sorted(args))
        return self._add(Node(op, dtype, tuple(args)))

    def _simpler(self, op: str, dtype: np.dtype, args: tuple[int, ...], values: list[Any]) -> int | None:
        """The node that an operation comes down to, None if it has to be made."""
        a, b = args[0], args[-1]
        x, y = values[0], values[-1]
        match op:
            case "convert_element_type":
                return a if self.nodes[a].dtype == dtype else None
            case "mul" | "and" if (x == 0 or y == 0) and dtype.kind != "b":
                return self.constant(0, dtype)
            case "mul" if x == 1 or y == 1:
                return b if x == 1 else a
            case "mul" if x == -1 or y == -1:
                return self.apply("neg", dtype, b if x == -1 else a)
            case "add" if x == 0 or y == 0:
                return b if x == 0 else a
            case "add" if self.nodes[b].op == "neg":
                return self.apply("sub", dtype, a, self.nodes[b].args[0])
            case "add" if self.nodes[a].op == "neg":
                return self.apply("sub", dtype, b, self.nodes[a].args[0])
            case "sub" if y == 0:
                return a
            case "sub" if x == 0:
                return self.apply("neg", dtype, b)
            case "sub" if self.nodes[b].op == "neg":
                return self.apply("add", dtype, a, self.nodes[b].args[0])
            case "div" if y == 1 or x == 0:
                return a
            case "neg" | "not" if self.nodes[a].op == op:
                return self.nodes[a].args[0]
            case "and" | "or" if dtype.kind == "b" and (x is not None or y is not None):
                known, other = (x, b) if x is not None else (y, a)
                return other if known == (op == "and") else self.constant(known, bool)
            case "max" | "min" | "and" | "or" if a == b:
                return a
            case "select_n" if x is not None:
                return args[1 + int(x)]
            case "select_n" if len(set(args[1:])) == 1:
                return args[1]
        return None

    def behind(self, outputs: Iterable[int]) -> list[int]:
        """All nodes that those need, in order, themselves included."""
        found: set[int] = set()
        todo = list(outputs)
        while todo:
            number = todo.pop()
            if number not in found:
                found.add(number)
                node = self.nodes[number]
                if node.op not in ("constant", "input"):
                    todo.extend(node.args)
        return sorted(found)


def with_reciprocals(graph: Graph, outputs: list[int], shared: int = 3) -> tuple[Graph, list[int]]:
    """The same with one reciprocal for each divisor that at least so many divide by: a division is a dozen
    instructions on a GPU. It differs by rounding."""
    needed = graph.behind(outputs)
    uses = Counter(
        graph.nodes[k].args[1]
        for k in needed
        if graph.nodes[k].op == "div" and graph.nodes[k].dtype.kind == "f"
    )
    made, moved = Graph(), dict[int, int]()
    for number in needed:
        op, dtype, args = graph.nodes[number]
        if op == "constant":
            moved[number] = made.constant(args[0], dtype)
        elif op == "input":
            moved[number] = made.input(args[0], dtype)
        elif op == "div" and uses[args[1]] >= shared:
            inverse = made.apply("div", dtype, made.constant(1, dtype), moved[args[1]])
            moved[number] = made.apply("mul", dtype, moved[args[0]], inverse)
        else:
            moved[number] = made.apply(op, dtype, *(moved[a] for a in args))
    return made, [moved[number] for number in outputs]


def evaluate(
    graph: Graph,
    outputs: list[int],
    given: Callable[[Any], Any],
    apply: Callable[[str, np.dtype, list[Any]], Any],
) -> list[Any]:
    """Values of nodes: `given(name)` of an input, a numpy scalar of a constant, `apply` of the rest."""
    value: dict[int, Any] = {}
    for number in graph.behind(outputs):
        op, dtype, args = graph.nodes[number]
        if op == "constant":
            value[number] = dtype.type(args[0])
        elif op == "input":
            value[number] = given(args[0])
        else:
            value[number] = apply(op, dtype, [value[a] for a in args])
    return [value[number] for number in outputs]


def with_numpy(op: str, dtype: np.dtype, args: list[Any]) -> Any:
    """`apply` of `evaluate` on numpy arrays: slow, and the measure of everything else."""
    with np.errstate(all="ignore"):
        found = args[0] if op == "convert_element_type" else OPERATIONS[op].numpy(*args)
        return np.asarray(found, dtype)


_COSTLY = {"div", "rem", "sqrt", "rsqrt", "cbrt", "pow", "exp", "exp2", "expm1", "log", "log1p", "logistic"}
_COSTLY |= {"sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh"}
_COSTLY |= {"atanh", "erf_inv"}


class Known(NamedTuple):
    """The name of an input that stands for a node of another graph."""

    node: int


def cut(
    graph: Graph, outputs: list[int], known: Callable[[Any], bool], least: int = 8
) -> tuple[Graph, list[int], list[int]]:
    """The same without what can be worked out beforehand: nodes behind which all inputs are `known` by their
    names become inputs `Known(node)`, where something else or an output needs them and they are worth it (as
    many operations as `least`, a division or a root counting for ten). Returns the new graph, its outputs,
    and those nodes."""
    needed = graph.behind(outputs)
    free: dict[int, int] = {}  # node to what it costs, where it can be worked out
    for number in needed:
        op, _, args = graph.nodes[number]
        if op == "constant":
            free[number] = 0
        elif op == "input":
            if known(args[0]):
                free[number] = 0
        elif all(a in free for a in args):
            free[number] = (10 if op in _COSTLY else 1) + sum(free[a] for a in dict.fromkeys(args))
    asked = set(outputs) | {a for k in needed if k not in free for a in _operands(graph.nodes[k])}
    worth = {k for k in asked if free.get(k, 0) >= least}
    made, moved = Graph(), dict[int, int]()

    def move(number: int) -> int:
        if number not in moved:
            op, dtype, args = graph.nodes[number]
            if number in worth:
                moved[number] = made.input(Known(number), dtype)
            elif op == "constant":
                moved[number] = made.constant(args[0], dtype)
            elif op == "input":
                moved[number] = made.input(args[0], dtype)
            else:
                moved[number] = made.apply(op, dtype, *(move(a) for a in args))
        return moved[number]

    for number in needed:  # in order: no deep recursion
        if number not in free or number in worth:
            move(number)
    found = [move(number) for number in outputs]
    return made, found, sorted(worth)


def _operands(node: Node) -> tuple[int, ...]:
    return () if node.op in ("constant", "input") else node.args
