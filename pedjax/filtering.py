"""The one driver: any system over time, one walk or many lanes, forward or with gradients.

Time runs in chunks of about √T samples inside an outer scan. Reverse-mode differentiation then keeps only
the state at the chunks' borders and recomputes inside (memory grows with √T, not T), and a score needs only
the few samples of a chunk that it looks at.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import cache, partial
from typing import Any, Literal, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from pedjax.kernels.columns import Columns, Layout, on_gpu, rows_of, walk
from pedjax.kernels.tangents import Dual, dual, tangents
from pedjax.kernels.unroll import CannotUnrollError
from pedjax.lanes import align, lane_shape
from pedjax.parameters import with_leaves
from pedjax.system import Output, System

Kernel = Literal["auto", "never", "interpreted"]

T = TypeVar("T")


def scan(
    system: System,
    parameters: Any,
    site: Any,
    samples: Any,
    state: Any,
    keep: Callable[[Output], Any] = lambda output: output,
) -> tuple[Any, Any]:
    """Run over all samples from `state`; returns the last state and what `keep` takes of each output."""

    def body(carry: Any, sample: Any) -> tuple[Any, Any]:
        carry, output = system.step(parameters, site, carry, sample)
        return carry, keep(output)

    return jax.lax.scan(body, state, samples)


class Packed(NamedTuple):
    """R recordings laid end to end in columns, the trailing lane axis C; a new one begins with a new chunk.

    `samples` tree of `(T, ..., C)`; `openings` tree of `(n, ..., R)`; `which (chunks, C)` int is the
    recording that begins with a chunk, −1 where none does; `slot (T, C)` int is the row of its chunk's
    buffer in which what is kept of a sample goes, −1 for none. T is a multiple of the number of chunks.
    `site` is data beside the samples, the same for all of them.
    """

    samples: Any
    openings: Any
    which: Array
    slot: Array
    site: Any = None


class Points(NamedTuple):
    """What a score needs of a run: `kept` by field of the estimate, `(chunks, slots, ..., *L)` where it
    looks; and for each chunk the sums of the weights of `gates` by name, and the `status`, `(chunks, *L)`:
    the first of its recording so far that is not healthy."""

    kept: dict[str, Array]
    gates: dict[str, Array]
    status: Array


def starts_of(system: System, parameters: Any, packed: Packed) -> Any:
    """The first state of each parameter set and recording, with lanes `(S, R)`, or `(R,)`."""
    state = system.start(parameters, packed.site, packed.openings)
    lanes = lane_shape(parameters, jnp.zeros(jax.tree.leaves(packed.openings)[0].shape[-1]))
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[: x.ndim - len(lanes)], *lanes)), state)


def points(
    system: System,
    parameters: Any,
    packed: Packed,
    slots: int,
    keep: tuple[str, ...] = ("position",),
    kernel: Kernel = "auto",
) -> Points:
    """The chosen fields of the estimate at the chosen samples only, for any number of lanes: by one kernel
    made from the step where there is a GPU and the step allows it, else by `scan_points`. Not differentiable
    where it is a kernel.

    `kernel` is `auto`, `never`, or `interpreted`, which runs the kernel on any device, slowly.
    """
    return _by_kernel_or(
        lambda interpret: _kernel_points(system, parameters, packed, slots, keep, interpret),
        lambda: scan_points(system, parameters, packed, slots, keep),
        system,
        kernel,
    )


def _by_kernel_or(
    by_kernel: Callable[[bool], T], by_scan: Callable[[], T], system: System, kernel: Kernel
) -> T:
    """The kernel's result where one is wanted and the step allows it, else the scan's."""
    if kernel == "interpreted" or (kernel == "auto" and on_gpu()):
        try:
            return by_kernel(kernel == "interpreted")
        except CannotUnrollError as error:
            _say_once(system.name, str(error))
    return by_scan()


@cache
def _say_once(system: str, why: str) -> None:
    warnings.warn(
        f"system '{system}': {why}; it runs on the GPU as a scan, many times slower than as a kernel",
        stacklevel=4,
    )


def _advance(system: System, site: Any, keep: tuple[str, ...]) -> Any:
    """A system's step with what is kept and summed of it, and its status."""

    def advance(parameters: Any, state: Any, sample: Any) -> tuple[Any, Any, Any, Array]:
        state, output = system.step(parameters, site, state, sample)
        kept = {name: getattr(output.estimate, name) for name in keep}
        return state, kept, {name: gate.weight for name, gate in output.gates.items()}, output.status

    return advance


def _walked(
    advance: Any,
    parameters: Any,
    starts: Any,
    packed: Packed,
    slots: int,
    layout: Layout | None,
    interpret: bool,
    start: Callable[[Any, Any], Any],
) -> Points:
    """Columns through a kernel, as `Points`; of a `Dual` step each field is one."""
    chunks = packed.which.shape[0]
    columns = Columns(packed.samples, packed.which, rows_of(packed.slot, chunks, slots))
    opened = (start, packed.openings)
    found = walk(advance, parameters, starts, columns, chunks * slots, layout, interpret, opened)
    kept = jax.tree.map(lambda x: x.reshape(chunks, slots, *x.shape[1:]), found.kept)
    return Points(kept, found.sums, found.status)


def _kernel_points(
    system: System,
    parameters: Any,
    packed: Packed,
    slots: int,
    keep: tuple[str, ...],
    interpret: bool,
    layout: Layout | None = None,
) -> Points:
    shape = lane_shape(parameters, jnp.zeros(packed.which.shape[1]))
    starts = starts_of(system, parameters, packed)
    if len(shape) == 1:  # no parameter has lanes: one set
        starts = jax.tree.map(lambda x: x[..., None, :], starts)

    def start(p: Any, opening: Any) -> Any:
        return system.start(p, packed.site, opening)

    advance = _advance(system, packed.site, keep)
    found = _walked(advance, parameters, starts, packed, slots, layout, interpret, start)
    return found if len(shape) == 2 else jax.tree.map(lambda x: x[..., 0, :], found)


def tangent_points(
    system: System,
    parameters: Any,
    directions: dict[str, Array],
    packed: Packed,
    slots: int,
    keep: tuple[str, ...] = ("position",),
    kernel: Kernel = "auto",
) -> tuple[Points, dict[str, Array]]:
    """`points`, and how what is kept moves as the parameters at the paths of `directions` move by them: one
    direction a lane, `(S, 1)`, carried forward beside the state. The second is like `Points.kept`."""

    def by_scan() -> tuple[Points, dict[str, Array]]:
        run = partial(scan_points, system, packed=packed, slots=slots, keep=keep)
        moves = with_leaves(jax.tree.map(jnp.zeros_like, parameters), directions)
        found, moved = jax.jvp(run, (parameters,), (moves,))
        return found, moved.kept

    def by_kernel(interpret: bool) -> tuple[Points, dict[str, Array]]:
        both = Dual(parameters, with_leaves(jax.tree.map(lambda x: None, parameters), directions))
        starts = dual(partial(starts_of, system, packed=packed), both)

        def start(given: Dual, opening: Any) -> Dual:
            return dual(lambda p: system.start(p, packed.site, opening), given)

        advance = tangents(_advance(system, packed.site, keep))
        found = _walked(advance, both, starts, packed, slots, Layout(32, 1), interpret, start)
        kept: Any = found.kept
        gates: Any = found.gates
        return Points(kept.value, gates.value, found.status), kept.slope

    return _by_kernel_or(by_kernel, by_scan, system, kernel)


def scan_points(
    system: System, parameters: Any, packed: Packed, slots: int, keep: tuple[str, ...] = ("position",)
) -> Points:
    """The chosen fields of the estimate at the chosen samples only, for any number of lanes,
    differentiable in little memory.

    Parameters have lanes `(S, 1)` or none; the result has lanes `(S, C)`, or `(C,)`.
    """
    chunks, columns = packed.which.shape
    shape = lane_shape(parameters, jnp.zeros(columns))
    starts = starts_of(system, parameters, packed)
    # The system sees one lane axis and a unit axis after it. The unit axis matters: the compiler unrolls an
    # innermost loop of sixteen into scalar code, but leaves a loop around a single turn to the vector units.
    parameters = jax.tree.map(lambda x: _flat(x, 0, shape) if x.ndim else x, parameters)
    spread = partial(jax.tree.map, lambda x: _flat(x, x.ndim - 1, shape))
    split = partial(jax.tree.map, lambda x: x.reshape(chunks, x.shape[0] // chunks, *x.shape[1:]))

    def begin(which: Array) -> Any:
        """The states with which the columns' recordings begin, laid out in the step's lanes."""
        picked = jnp.maximum(which, 0)
        return jax.tree.map(lambda x: _flat(x[..., picked], x.ndim - len(shape), shape), starts)

    advance = _advance(system, packed.site, keep)
    first = begin(packed.which[0])
    sample = spread(jax.tree.map(lambda x: x[0], packed.samples))
    _, kept_like, gates_like, status_like = jax.eval_shape(lambda: advance(parameters, first, sample))
    rows = jnp.arange(slots)

    @partial(jax.checkpoint, prevent_cse=False)  # only the state is stored for each sample, not each product
    def inner(carry: Any, sample: tuple[Any, Array]) -> tuple[Any, None]:
        state, buffer, gates, status = carry
        state, kept, weights, now = advance(parameters, state, sample[0])
        buffer = {
            name: jnp.where(rows.reshape(slots, *(1,) * x.ndim) == sample[1], x, buffer[name])
            for name, x in kept.items()
        }
        gates = {name: total + weights[name] for name, total in gates.items()}
        return (state, buffer, gates, jnp.where(status == 0, now, status)), None

    @jax.checkpoint
    def outer(carry: Any, part: tuple[Any, Array, Array]) -> tuple[Any, Points]:
        samples, slot, which = part
        state, status = carry
        starting = spread(which) >= 0
        state = jax.tree.map(lambda new, old: jnp.where(starting, new, old), begin(which), state)
        state = _apart(state, which)
        status = jnp.where(starting, 0, status)
        buffer = {name: jnp.zeros((slots, *x.shape), x.dtype) for name, x in kept_like.items()}
        gates = {name: jnp.zeros(x.shape, x.dtype) for name, x in gates_like.items()}
        inside = (spread(samples), spread(slot))
        (state, buffer, gates, status), _ = jax.lax.scan(inner, (state, buffer, gates, status), inside)
        return (state, status), Points(buffer, gates, status)

    none = jnp.zeros(status_like.shape, status_like.dtype)
    found = jax.lax.scan(outer, (first, none), (split(packed.samples), split(packed.slot), packed.which))[1]
    return jax.tree.map(lambda x: x.reshape(*x.shape[:-2], *shape), found)


@jax.custom_jvp
def _apart(state: Any, which: Array) -> Any:
    """The same state. Where a run is differentiated, a call that does nothing keeps the loop over chunks from
    being compiled as one with those inside it: they are then programs of their own, and sooner done, since
    the compiler's time goes with the square of the loops in one program."""
    return state


def _apart_with_slope(given: tuple[Any, Array], moves: tuple[Any, Any]) -> tuple[Any, Any]:
    """What does not move is not made to: written-out derivatives take what moves as linear."""
    state, which = given
    if not on_gpu():
        one = 1.0 + jnp.abs(which[:1, None]).astype(jnp.float32)
        always = jax.lax.linalg.cholesky(one)[0, 0] > 0  # a library's: no part of a compiled loop
        state = jax.tree.map(lambda x: jnp.where(always, x, jnp.zeros_like(x)), state)
    return state, moves[0]


_apart.defjvp(_apart_with_slope, symbolic_zeros=True)


def _flat(x: Array, structural: int, lanes: tuple[int, ...]) -> Array:
    """Lanes of `x` broadcast to `lanes` and laid out in one axis, with a unit axis after it: `(..., n, 1)`.
    All alike, they stay one: `(..., 1, 1)`."""
    if x.size == math.prod(x.shape[:structural]):
        return x.reshape(*x.shape[:structural], 1, 1)
    x = jnp.broadcast_to(align(x, structural, len(lanes)), (*x.shape[:structural], *lanes))
    return x.reshape(*x.shape[:structural], math.prod(lanes), 1)
