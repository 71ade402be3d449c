"""One step of a filter as a program on single numbers, with a state no larger than it needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from pedjax.kernels.graph import Graph, with_reciprocals
from pedjax.kernels.unroll import CannotUnrollError, Numbers, unknown_primitives, unroll

Advance = Callable[[Any, Any, Any], tuple[Any, Any, Any, Any]]
"""`(parameters, state, sample) -> (state, kept, sums, status)`, pure and with lanes last."""


class Place(NamedTuple):
    """An element of a tree: the number of the leaf, and where it is in the flattened leaf."""

    leaf: int
    at: int


class Input(NamedTuple):
    """The name of an input: in which tree ("parameter", "state" or "sample"), and where there."""

    tree: str
    place: Place


class Program(NamedTuple):
    """A step, unrolled.

    `carried` are the elements of the state that are kept from one sample to the next, `following` the nodes
    of their next values, `dtypes` their types. The state's other elements either have no effect on a result,
    or are the mirror image of a carried one: `twins` says of which. `kept` and `sums` are the nodes of their
    leaves' elements, `status` is one node.
    """

    graph: Graph
    carried: tuple[Place, ...]
    following: tuple[int, ...]
    dtypes: tuple[np.dtype, ...]
    twins: dict[Place, Place]
    kept: tuple[Numbers, ...]
    sums: tuple[Numbers, ...]
    status: int
    kept_like: Any
    sums_like: Any

    @property
    def outputs(self) -> list[int]:
        """The nodes that a sample asks for."""
        results = [int(k) for numbers in (*self.kept, *self.sums) for k in numbers.flat]
        return [*self.following, *results, self.status]

    def inputs(self, tree: str) -> list[Place]:
        """The elements of that tree that the step reads."""
        nodes = (self.graph.nodes[k] for k in self.graph.behind(self.outputs))
        return [n.args[0].place for n in nodes if n.op == "input" and n.args[0].tree == tree]

    @property
    def operations(self) -> int:
        """How many operations one step is."""
        nodes = (self.graph.nodes[k] for k in self.graph.behind(self.outputs))
        return sum(n.op not in ("constant", "input") for n in nodes)


def program(advance: Advance, parameters: Any, state: Any, sample: Any) -> Program:
    """The program of a step for trees of `jax.ShapeDtypeStruct` without lanes.

    A step with something that cannot be unrolled is a `CannotUnrollError`, which names it.
    """
    closed, shapes = jax.make_jaxpr(advance, return_shape=True)(parameters, state, sample)
    stopping = unknown_primitives(closed.jaxpr)
    if stopping:
        raise CannotUnrollError(f"the step uses what a kernel cannot hold: {', '.join(sorted(stopping))}")
    trees = {"parameter": jax.tree.leaves(parameters), "state": jax.tree.leaves(state)}
    trees["sample"] = jax.tree.leaves(sample)
    next_like, kept_like, sums_like, status_like = shapes
    before_and_after: tuple[Any, Any] = jax.tree.structure(state), jax.tree.structure(next_like)
    if before_and_after[0] != before_and_after[1]:
        raise ValueError("the next state is another tree than the state")
    for before, after in zip(trees["state"], jax.tree.leaves(next_like), strict=True):
        if before.shape != after.shape:
            raise ValueError(f"a part of the state has the shape {before.shape}, and then {after.shape}")
    if status_like.shape != ():
        raise ValueError("the status is not one number for each lane")

    mirrored = {k for k, x in enumerate(trees["state"]) if _square(x)}
    while True:
        graph = Graph()
        given = [
            _numbers(graph, tree, k, x, tree == "state" and k in mirrored)
            for tree, leaves in trees.items()
            for k, x in enumerate(leaves)
        ]
        found = unroll(graph, closed.jaxpr, closed.consts, given)
        first = len(trees["state"])
        after = [_typed(graph, n, x.dtype) for n, x in zip(found[:first], trees["state"], strict=True)]
        uneven = {k for k in mirrored if not np.array_equal(after[k], after[k].T)}
        if not uneven:
            break
        mirrored -= uneven
    many = len(jax.tree.leaves(kept_like))
    kept, sums = found[first : first + many], found[first + many : -1]
    status = int(_typed(graph, found[-1], np.dtype(np.int32)))
    results = [int(k) for numbers in (*kept, *sums) for k in numbers.flat] + [status]
    carried = _needed(graph, after, results)
    outputs = [int(after[p.leaf].flat[p.at]) for p in carried] + results
    graph, outputs = with_reciprocals(graph, outputs)
    left = iter(outputs)
    following = tuple(next(left) for _ in carried)
    kept, sums = ([_renumbered(n, left) for n in part] for part in (kept, sums))
    return Program(
        graph=graph,
        carried=tuple(carried),
        following=following,
        dtypes=tuple(np.dtype(trees["state"][p.leaf].dtype) for p in carried),
        twins={
            Place(k, i): Place(k, _upper(i, n))
            for k in sorted(mirrored)
            for n in [trees["state"][k].shape[0]]
            for i in range(n * n)
            if _upper(i, n) != i
        },
        kept=tuple(kept),
        sums=tuple(sums),
        status=next(left),
        kept_like=kept_like,
        sums_like=sums_like,
    )


class Beginning(NamedTuple):
    """A start, unrolled: `nodes` are the first values of the carried elements of a step's state."""

    graph: Graph
    nodes: tuple[int, ...]


def beginning(start: Callable[[Any, Any], Any], parameters: Any, opening: Any, made: Program) -> Beginning:
    """The first state `start(parameters, opening)` as a program, for trees without lanes.

    A matrix that the step keeps symmetric but that does not start so becomes NaN where it is not, which is
    seen, not silently wrong. A start that cannot be unrolled is a `CannotUnrollError`.
    """
    closed = jax.make_jaxpr(start)(parameters, opening)
    stopping = unknown_primitives(closed.jaxpr)
    if stopping:
        raise CannotUnrollError(f"the start uses what a kernel cannot hold: {', '.join(sorted(stopping))}")
    graph = Graph()
    given = [
        _numbers(graph, tree, k, x, False)
        for tree, leaves in (("parameter", parameters), ("opening", opening))
        for k, x in enumerate(jax.tree.leaves(leaves))
    ]
    found = unroll(graph, closed.jaxpr, closed.consts, given)
    nodes = []
    for place, dtype in zip(made.carried, made.dtypes, strict=True):
        node = graph.apply("convert_element_type", dtype, int(found[place.leaf].flat[place.at]))
        for other, twin in made.twins.items():
            if twin == place:
                same = graph.apply("convert_element_type", dtype, int(found[other.leaf].flat[other.at]))
                equal = graph.apply("eq", bool, node, same)
                if node != same:
                    node = graph.apply("select_n", dtype, equal, graph.constant(np.nan, dtype), node)
        nodes.append(node)
    return Beginning(graph, tuple(nodes))


def supports(advance: Advance, parameters: Any, state: Any, sample: Any) -> str:
    """Why a step cannot be a kernel; empty where it can."""
    try:
        program(advance, parameters, state, sample)
    except CannotUnrollError as error:
        return str(error)
    return ""


def _square(x: Any) -> bool:
    floating = np.issubdtype(x.dtype, np.floating)
    return floating and len(x.shape) == 2 and x.shape[0] == x.shape[1] > 1


def _upper(index: int, n: int) -> int:
    """The element across the diagonal of an n by n matrix if that is the upper of the two, or itself."""
    row, column = divmod(index, n)
    return index if row <= column else column * n + row


def _numbers(graph: Graph, tree: str, leaf: int, x: Any, mirrored: bool) -> Numbers:
    """The inputs that a leaf's elements are; of a mirrored one, the upper half's stand for both."""
    size = int(np.prod(x.shape, dtype=int))
    at = [_upper(i, x.shape[0]) if mirrored else i for i in range(size)]
    found = [graph.input(Input(tree, Place(leaf, i)), x.dtype) for i in at]
    return np.array(found, np.int32).reshape(x.shape)


def _typed(graph: Graph, numbers: Numbers, dtype: Any) -> Numbers:
    flat = [graph.apply("convert_element_type", dtype, int(k)) for k in numbers.flat]
    return np.array(flat, np.int32).reshape(numbers.shape)


def _renumbered(numbers: Numbers, new: Iterator[int]) -> Numbers:
    return np.array([next(new) for _ in range(numbers.size)], np.int32).reshape(numbers.shape)


def _needed(graph: Graph, after: list[Numbers], results: list[int]) -> list[Place]:
    """The elements of the state on which results depend, now or after any number of steps."""
    needed: set[Place] = set()
    todo = results
    while todo:
        nodes = (graph.nodes[k] for k in graph.behind(todo))
        read = {n.args[0].place for n in nodes if n.op == "input" and n.args[0].tree == "state"} - needed
        needed |= read
        todo = [int(after[p.leaf].flat[p.at]) for p in read]
    return sorted(needed)
