"""The one driver: any system over time, one walk or many lanes, forward or with gradients.

Time runs in chunks of about √T samples inside an outer scan. Reverse-mode differentiation then keeps only
the state at the chunks' borders and recomputes inside (memory grows with √T, not T), and a score needs only
the few samples of a chunk that it looks at.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pedjax.lanes import align, lane_shape
from pedjax.system import Output, System


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

    def kept_of(output: Output) -> dict[str, Array]:
        return {name: getattr(output.estimate, name) for name in keep}

    first = begin(packed.which[0])
    sample = spread(jax.tree.map(lambda x: x[0], packed.samples))
    like = jax.eval_shape(lambda: system.step(parameters, packed.site, first, sample)[1])
    rows = jnp.arange(slots)

    @partial(jax.checkpoint, prevent_cse=False)  # only the state is stored for each sample, not each product
    def inner(carry: Any, sample: tuple[Any, Array]) -> tuple[Any, None]:
        state, buffer, gates, status = carry
        state, output = system.step(parameters, packed.site, state, sample[0])
        buffer = {
            name: jnp.where(rows.reshape(slots, *(1,) * x.ndim) == sample[1], x, buffer[name])
            for name, x in kept_of(output).items()
        }
        gates = {name: total + output.gates[name].weight for name, total in gates.items()}
        return (state, buffer, gates, jnp.where(status == 0, output.status, status)), None

    @jax.checkpoint
    def outer(carry: Any, part: tuple[Any, Array, Array]) -> tuple[Any, Points]:
        samples, slot, which = part
        state, status = carry
        starting = spread(which) >= 0
        state = jax.tree.map(lambda new, old: jnp.where(starting, new, old), begin(which), state)
        status = jnp.where(starting, 0, status)
        buffer = {name: jnp.zeros((slots, *x.shape), x.dtype) for name, x in kept_of(like).items()}
        gates = {name: jnp.zeros(x.weight.shape, x.weight.dtype) for name, x in like.gates.items()}
        inside = (spread(samples), spread(slot))
        (state, buffer, gates, status), _ = jax.lax.scan(inner, (state, buffer, gates, status), inside)
        return (state, status), Points(buffer, gates, status)

    none = jnp.zeros(like.status.shape, like.status.dtype)
    found = jax.lax.scan(outer, (first, none), (split(packed.samples), split(packed.slot), packed.which))[1]
    return jax.tree.map(lambda x: x.reshape(*x.shape[:-2], *shape), found)


def _flat(x: Array, structural: int, lanes: tuple[int, ...]) -> Array:
    """Lanes of `x` broadcast to `lanes` and laid out in one axis, with a unit axis after it: `(..., n, 1)`.
    All alike, they stay one: `(..., 1, 1)`."""
    if x.size == math.prod(x.shape[:structural]):
        return x.reshape(*x.shape[:structural], 1, 1)
    x = jnp.broadcast_to(align(x, structural, len(lanes)), (*x.shape[:structural], *lanes))
    return x.reshape(*x.shape[:structural], math.prod(lanes), 1)
