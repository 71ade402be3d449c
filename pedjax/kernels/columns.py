"""Whole packed columns of recordings for many parameter sets, in one kernel.

Each program of the kernel walks one column for one block of lanes: the state stays in registers from the
column's first sample to its last, and memory sees the samples (the same for all lanes) and what is kept.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pedjax.kernels.graph import OPERATIONS, Known, cut, evaluate
from pedjax.kernels.program import Advance, Beginning, Place, Program, beginning, program
from pedjax.kernels.unroll import CannotUnrollError


class Layout(NamedTuple):
    """How lanes are given to the device: lanes of a block (a power of two), and warps that share it."""

    block: int = 64
    warps: int = 2


class Columns(NamedTuple):
    """Recordings laid end to end in C columns, a new one from a new chunk on.

    `samples` tree of `(T, ..., C)`; `which (chunks, C)` int32, the recording that begins with that chunk, −1
    where none does; `row (T, C)` int32, where what is kept of that sample is put, −1 for nowhere. T is a
    multiple of the number of chunks.
    """

    samples: Any
    which: Array
    row: Array


class Walked(NamedTuple):
    """What comes of it: `kept` tree of `(rows, k..., S, C)`, zero in rows that no sample names; `sums` tree
    of `(chunks, S, C)` over each chunk's samples; and `status (chunks, S, C)` int32 at each chunk's end, the
    first of its recording that was not zero."""

    kept: Any
    sums: Any
    status: Array


def on_gpu() -> bool:
    """Whether JAX runs on a GPU for which Pallas compiles."""
    return jax.default_backend() in ("gpu", "cuda")


def walk(
    advance: Advance,
    parameters: Any,
    starts: Any,
    columns: Columns,
    rows: int,
    layout: Layout | None = None,
    interpret: bool | None = None,
    start: tuple[Callable[[Any, Any], Any], Any] | None = None,
) -> Walked:
    """Run `advance` over all columns for S parameter sets.

    `parameters` has leaves `()`, the same for all sets, or `(S,)` or `(S, 1)`; `starts` is a tree of first
    states `(k..., S, R)` of R recordings, where S or R may be 1 if all sets or recordings share them. With
    `start`, the function `(parameters, opening) -> state` that made them and its openings `(..., R)`, the
    kernel makes them itself if it can: a Triton program that reads a whole state compiles for minutes.
    `interpret` runs the kernel as ordinary JAX, slowly and anywhere; by default wherever there is no GPU. To
    be called under `jit`.
    """
    if interpret is None:
        interpret = not on_gpu()
    first = jax.tree.leaves(starts)
    float_type = next(x.dtype for x in first if jnp.issubdtype(x.dtype, jnp.inexact))
    parameters = jax.tree.map(lambda x: _parameter(x, float_type), parameters)
    made = program(
        advance,
        jax.tree.map(lambda x: jax.ShapeDtypeStruct((), x.dtype), parameters),
        jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[:-2], x.dtype), starts),
        jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:-1], x.dtype), columns.samples),
    )
    lanes = int(np.prod(jnp.broadcast_shapes(*(x.shape for x in jax.tree.leaves(parameters)))))
    lanes = max(lanes, *(x.shape[-2] for x in first))
    begun = None
    if start is not None:
        one = jax.tree.map(lambda x: jax.ShapeDtypeStruct((), x.dtype), parameters)
        opening = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[:-1], x.dtype), start[1])
        with suppress(CannotUnrollError):
            begun = beginning(start[0], one, opening, made), jax.tree.leaves(start[1])
    leaves = jax.tree.leaves(parameters)
    return _run(made, leaves, first, columns, lanes, rows, layout or Layout(), interpret, begun)


def rows_of(slot: Array, chunks: int, slots: int) -> Array:
    """`Columns.row` for a buffer of so many slots for each chunk: `slot (T, C)` is the row of its chunk's
    buffer, −1 for none. With rows = chunks slots, what is kept is then `(chunks, slots, ...)`, reshaped."""
    chunk = jnp.arange(slot.shape[0], dtype=jnp.int32)[:, None] // (slot.shape[0] // chunks)
    return jnp.where(slot < 0, -1, chunk * slots + slot.astype(jnp.int32))


def rows_in_order(slot: Array) -> Array:
    """`Columns.row` with no row unused: the samples of each column with a slot, one after the other (the
    number of rows is then the largest number of them in a column)."""
    kept = slot >= 0
    return jnp.where(kept, jnp.cumsum(kept, axis=0, dtype=jnp.int32) - 1, -1)


def _parameter(x: Any, dtype: Any) -> Array:
    """A parameter as `()` or `(S,)`; plain numbers take the filter's precision."""
    x = jnp.asarray(x, dtype) if isinstance(x, bool | int | float) else jnp.asarray(x)
    return x.reshape(-1) if x.ndim else x


class _Bundle(NamedTuple):
    """Rows of one type and one layout, side by side in one array: what a kernel is given, not hundreds of
    arrays. `place` says in which bundle, and in which row of it, each element is."""

    arrays: list[Array]
    place: dict[Any, tuple[int, int]]


def _bundle(rows: dict[Any, Array], axis: int) -> _Bundle:
    """Rows stacked along `axis`, those of one type and shape together; truth values as int32."""
    groups: dict[Any, list[Any]] = {}
    for place, row in rows.items():
        groups.setdefault((row.shape, row.dtype), []).append(place)
    arrays = [jnp.stack([rows[p] for p in group], axis=axis) for group in groups.values()]
    found = {p: (k, n) for k, group in enumerate(groups.values()) for n, p in enumerate(group)}
    return _Bundle(arrays, found)


def _stored(x: Array) -> Array:
    return x.astype(jnp.int32) if x.dtype == bool else x


def _element(leaf: Array, structural: int, index: int) -> Array:
    """An element of a leaf, with what follows its structural axes."""
    return leaf.reshape(-1, *leaf.shape[structural:])[index]


def _run(
    made: Program,
    parameters: Sequence[Array],
    starts: Sequence[Array],
    columns: Columns,
    lanes: int,
    rows: int,
    layout: Layout,
    interpret: bool,
    begin: tuple[Beginning, list[Array]] | None,
) -> Walked:
    from jax.experimental import pallas as pl  # here: it takes a tenth of pedjax's start

    chunks, width = columns.which.shape
    total = columns.row.shape[0]
    if total % chunks:
        raise ValueError(f"{total} samples are no multiple of {chunks} chunks")
    length, block = total // chunks, layout.block
    padded = -(-lanes // block) * block

    def pad(x: Array, axis: int) -> Array:
        if x.shape[axis] == 1 or x.shape[axis] == padded:
            return x
        return jnp.pad(x, [(0, padded - lanes if k == axis % x.ndim else 0) for k in range(x.ndim)], "edge")

    # what depends on samples and on parameters without lanes alone is worked out beforehand, once
    leaves = [jnp.moveaxis(x, -1, 0) for x in jax.tree.leaves(columns.samples)]
    flat = [x.reshape(*x.shape[:2], -1) for x in leaves]

    def is_fixed(name: Any) -> bool:
        return name.tree == "parameter" and not parameters[name.place.leaf].ndim

    def sampled(name: Any) -> Array:
        if name.tree == "parameter":
            return parameters[name.place.leaf]
        return flat[name.place.leaf][..., name.place.at]

    step, asked, before = cut(made.graph, made.outputs, lambda n: n.tree == "sample" or is_fixed(n))
    ahead = dict(zip(before, evaluate(made.graph, before, sampled, _on_arrays), strict=True))
    names = [n.args[0] for n in (step.nodes[k] for k in step.behind(asked)) if n.op == "input"]
    read = {p for p in names if isinstance(p, Known) or p.tree == "sample"}
    shape = leaves[0].shape[:2]
    seen = {p: ahead[p.node] if isinstance(p, Known) else sampled(p) for p in read}
    samples = _bundle({p: _stored(jnp.broadcast_to(x, shape)) for p, x in seen.items()}, 2)
    kinds = {p: x.dtype for p, x in seen.items()}
    wanted = {p.place for p in names if not isinstance(p, Known) and p.tree == "parameter"}

    # so is what the first states have of the openings
    opened: dict[Any, Array] = {}
    if begin is not None:
        first, openings = begin
        flat_openings = [x.reshape(-1, x.shape[-1]) for x in openings]

        def opening_of(name: Any) -> Array:
            if name.tree == "parameter":
                return parameters[name.place.leaf]
            return flat_openings[name.place.leaf][name.place.at]

        nodes = list(first.nodes)
        begins, starting, early = cut(first.graph, nodes, lambda n: n.tree == "opening" or is_fixed(n), 1)
        found = dict(zip(early, evaluate(first.graph, early, opening_of, _on_arrays), strict=True))
        for node in (begins.nodes[k] for k in begins.behind(starting)):
            if node.op != "input":
                continue
            name = node.args[0]
            if isinstance(name, Known):
                opened[name] = found[name.node]
            elif name.tree == "opening":
                opened[name] = opening_of(name)
            else:
                wanted.add(name.place)

    # what the kernel reads, an array for each kind: parameters (n, S) or (n, 1); samples (C, T, n); of the
    # first states (R, n, S), or (n, R)
    given = {p: pad(_stored(parameters[p.leaf]).reshape(1, -1)[0], 0) for p in sorted(wanted)}
    params = _bundle(given, 0)

    def start_of(place: Place) -> Array:
        leaf = starts[place.leaf]
        return _stored(_element(leaf, leaf.ndim - 2, place.at))

    begun: dict[Any, Array] = {}
    for place in made.carried if begin is None else ():
        value = start_of(place)
        for other in (p for p, twin in made.twins.items() if twin == place):
            same = start_of(other)  # a matrix that does not start symmetric is no number, not silently wrong
            value = jnp.where((value == same) | (value != value), value, jnp.nan)
        begun[place] = pad(value.T, -1)
    for name, x in opened.items():
        begun[name] = jnp.broadcast_to(_stored(x), starts[0].shape[-1:])[:, None]
    opening = _bundle(begun, 1)

    kept_like, sums_like = jax.tree.leaves(made.kept_like), jax.tree.leaves(made.sums_like)
    shapes = [(rows, n.size, width, padded) for n in made.kept]
    shapes += [(chunks, 1, width, padded)] * (len(made.sums) + 1)
    dtypes = [jnp.int32 if x.dtype == bool else x.dtype for x in (*kept_like, *sums_like)] + [jnp.int32]
    blank = [jnp.zeros(s, d) for s, d in zip(shapes[: len(kept_like)], dtypes, strict=False)]
    sizes = [len(params.arrays), len(samples.arrays), len(opening.arrays), 2, len(blank)]
    edges = np.cumsum([0, *sizes])

    apply = _applier(made, block)
    out_types = [made.graph.nodes[int(n.flat[0])].dtype for n in (*made.kept, *made.sums)]

    def kernel(*refs: Any) -> None:
        of_params, of_samples, of_opening, (which, row), _ = (refs[a:b] for a, b in pairwise(edges))
        kept, sums, status = _cut(refs[edges[-1] :], len(made.kept), len(made.sums))
        at, column = pl.program_id(0) * block, pl.program_id(1)
        here = pl.ds(at, block)

        def real(value: Any, dtype: Any) -> Any:
            return value != 0 if jnp.dtype(dtype).kind == "b" else value

        def load(refs: Any, bundle: _Bundle, place: Any, *before: Any) -> Any:
            """One number, or one for each lane of this block."""
            k, n = bundle.place[place]
            one = bundle.arrays[k].shape[-1] == 1
            return refs[k][(*before, n, 0 if one else here)]

        parameter = {p: real(load(of_params, params, p), parameters[p.leaf].dtype) for p in given}

        def fresh(recording: Any) -> tuple[Any, ...]:
            if begin is not None:

                def known(name: Any) -> Any:
                    if name in opened:
                        return real(load(of_opening, opening, name, recording), opened[name].dtype)
                    return parameter[name.place]

                return tuple(_wide(x, block) for x in evaluate(begins, starting, known, apply))
            found = []
            for place, dtype in zip(made.carried, made.dtypes, strict=True):
                k = opening.place[place][0]
                r = recording if opening.arrays[k].shape[0] > 1 else 0
                found.append(_wide(real(load(of_opening, opening, place, r), dtype), block))
            return tuple(found)

        def sample_at(k: Any, carry: tuple[Any, ...], chunk: Any) -> tuple[Any, ...]:
            t = chunk * length + k
            state, summed, code = _cut(carry, len(made.carried), len(made.sums))
            now = dict(zip(made.carried, state, strict=True))

            def asked_for(name: Any) -> Any:
                if name in kinds:
                    k, n = samples.place[name]
                    return real(of_samples[k][column, t, n], kinds[name])
                return parameter[name.place] if name.tree == "parameter" else now[name.place]

            found = evaluate(step, asked, asked_for, apply)
            state, found = found[: len(state)], found[len(state) :]
            state = [_wide(x, block) for x in state]
            place = row[t, column]

            @pl.when(place >= 0)
            def _() -> None:
                n = 0
                for ref, numbers in zip(kept, made.kept, strict=True):
                    for k in range(numbers.size):
                        ref[place, k, column, here] = _wide(found[n], block).astype(ref.dtype)
                        n += 1

            more = found[sum(n.size for n in made.kept) : -1]
            summed = [total + _wide(x, block) for total, x in zip(summed, more, strict=True)]
            code = jnp.where(code == 0, _wide(found[-1], block), code)
            return (*state, *summed, code)

        def chunk_at(chunk: Any, carry: tuple[Any, ...]) -> tuple[Any, ...]:
            recording = which[chunk, column]
            nothing = jnp.zeros((block,), jnp.int32)
            carry = lax.cond(
                recording >= 0,
                lambda: (*fresh(jnp.maximum(recording, 0)), nothing),
                lambda: carry,
            )
            zeros = [jnp.zeros((block,), dtype) for dtype in out_types[len(made.kept) :]]
            carry = (*carry[:-1], *zeros, carry[-1])
            carry = lax.fori_loop(0, length, partial(sample_at, chunk=chunk), carry)
            state, summed, code = _cut(carry, len(made.carried), len(made.sums))
            for ref, value in zip(sums, summed, strict=True):
                ref[chunk, 0, column, here] = value
            status[chunk, 0, column, here] = code
            return (*state, code)

        blank_state = [jnp.zeros((block,), dtype) for dtype in made.dtypes]
        lax.fori_loop(0, chunks, chunk_at, (*blank_state, jnp.zeros((block,), jnp.int32)))

    found = pl.pallas_call(
        kernel,
        grid=(padded // block, width),
        in_specs=[pl.BlockSpec(memory_space=pl.ANY)] * int(edges[-1]),
        out_specs=[pl.BlockSpec(memory_space=pl.ANY)] * len(shapes),
        out_shape=[jax.ShapeDtypeStruct(s, d) for s, d in zip(shapes, dtypes, strict=True)],
        input_output_aliases={int(edges[-2]) + k: k for k in range(len(blank))},
        interpret=interpret,
        **_options(layout, interpret),
    )(*params.arrays, *samples.arrays, *opening.arrays, columns.which, columns.row, *blank)
    kept, sums, status = _cut(found, len(made.kept), len(made.sums))
    kept = [
        jnp.swapaxes(x[..., :lanes], -1, -2).reshape(rows, *like.shape, lanes, width).astype(like.dtype)
        for x, like in zip(kept, kept_like, strict=True)
    ]
    sums = [jnp.swapaxes(x[:, 0, :, :lanes], -1, -2) for x in sums]
    return Walked(
        jax.tree.unflatten(jax.tree.structure(made.kept_like), kept),
        jax.tree.unflatten(jax.tree.structure(made.sums_like), sums),
        jnp.swapaxes(status[:, 0, :, :lanes], -1, -2),
    )


def _cut(items: Sequence[Any], first: int, second: int) -> tuple[list[Any], list[Any], Any]:
    """The first so many, the next so many, and the one that is left."""
    items = list(items)
    assert len(items) == first + second + 1
    return items[:first], items[first : first + second], items[-1]


def _wide(x: Any, block: int) -> Any:
    """The same in each lane, if it is one number."""
    if jnp.ndim(x):
        return x
    return lax.full((block,), x.item(), x.dtype) if isinstance(x, np.generic) else lax.broadcast(x, (block,))


def _applier(made: Program, block: int) -> Callable[[str, np.dtype, list[Any]], Any]:
    """Operations as they stand in the kernel: of numbers for each lane, or of one for all."""

    def apply(op: str, dtype: np.dtype, args: list[Any]) -> Any:
        if any(jnp.ndim(x) for x in args):
            args = [_wide(x, block) for x in args]
        if op == "convert_element_type":
            return lax.convert_element_type(args[0], dtype)
        return OPERATIONS[op].lax(*args)

    return apply


def _on_arrays(op: str, dtype: np.dtype, args: list[Any]) -> Any:
    """Operations outside of the kernel, of whole arrays."""
    arrays = jnp.broadcast_arrays(*args) if len({jnp.shape(x) for x in args}) > 1 else args
    if op == "convert_element_type":
        return lax.convert_element_type(arrays[0], dtype)
    return OPERATIONS[op].lax(*map(jnp.asarray, arrays))


def _options(layout: Layout, interpret: bool) -> dict[str, Any]:
    """How Pallas is asked for Triton, in the words of the installed version."""
    if interpret:
        return {}
    from jax.experimental import pallas as pl
    from jax.experimental.pallas import triton

    found: dict[str, Any] = {
        "compiler_params": triton.CompilerParams(num_warps=layout.warps, num_stages=1),
    }
    if "backend" in inspect.signature(pl.pallas_call).parameters:
        found["backend"] = "triton"
    return found
