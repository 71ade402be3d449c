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
    samples: Any,
    state: Any,
    keep: Callable[[Output], Any] = lambda output: output,
) -> tuple[Any, Any]:
    """Run over all samples from `state`; returns the last state and what `keep` takes of each output."""

    def body(carry: Any, sample: Any) -> tuple[Any, Any]:
        carry, output = system.step(parameters, carry, sample)
        return carry, keep(output)

    return jax.lax.scan(body, state, samples)


class Packed(NamedTuple):
    """Recordings laid end to end in columns, the trailing lane axis C; a new one begins with a new chunk.

    `samples` tree of `(T, ..., C)`; `opening` tree of `(chunks, ..., C)`, read where `begin (chunks, C)` is
    true; `slot (T, C)` int is the row of its chunk's buffer in which a sample's position is kept, −1 for
    none. T is a multiple of the number of chunks.
    """

    samples: Any
    opening: Any
    begin: Array
    slot: Array


class Points(NamedTuple):
    """What a score needs of a run: `position (chunks, slots, 3, *L)` where it looks, and for each chunk the
    sum of stance weights `updates (chunks, *L)` and `healthy (chunks, *L)`."""

    position: Array
    updates: Array
    healthy: Array


def scan_points(system: System, parameters: Any, packed: Packed, slots: int) -> Points:
    """Positions at the chosen samples only, for any number of lanes, differentiable in little memory.

    Parameters have lanes `(S, 1)` or none; the result has lanes `(S, C)`, or `(C,)`.
    """
    chunks, columns = packed.begin.shape
    shape = lane_shape(parameters, jnp.zeros(columns))
    # The system sees one lane axis and a unit axis after it. The unit axis matters: the compiler unrolls an
    # innermost loop of sixteen into scalar code, but leaves a loop around a single turn to the vector units.
    parameters = jax.tree.map(lambda x: _flat(x, 0, shape) if x.ndim else x, parameters)
    spread = partial(jax.tree.map, lambda x: _flat(x, x.ndim - 1, shape))
    split = partial(jax.tree.map, lambda x: x.reshape(chunks, x.shape[0] // chunks, *x.shape[1:]))
    first = system.start(parameters, spread(jax.tree.map(lambda x: x[0], packed.opening)))
    like = first.navigation.position
    rows = jnp.arange(slots).reshape(slots, 1, 1, 1)

    @partial(jax.checkpoint, prevent_cse=False)  # only the state is stored for each sample, not each product
    def inner(carry: Any, sample: tuple[Any, Array]) -> tuple[Any, None]:
        state, buffer, updates = carry
        state, output = system.step(parameters, state, sample[0])
        buffer = jnp.where(rows == sample[1], output.navigation.position, buffer)
        return (state, buffer, updates + output.stance), None

    @jax.checkpoint
    def outer(state: Any, part: tuple[Any, Array, Any, Array]) -> tuple[Any, Points]:
        samples, slot, opening, begin = spread(part)
        fresh = system.start(parameters, opening)
        state = jax.tree.map(lambda new, old: jnp.where(begin, new, old), fresh, state)
        buffer = jnp.zeros((slots, *like.shape), like.dtype)
        updates = jnp.zeros(like.shape[1:], like.dtype)
        (state, buffer, updates), _ = jax.lax.scan(inner, (state, buffer, updates), (samples, slot))
        return state, Points(buffer, updates, state.healthy)

    found = jax.lax.scan(
        outer, first, (split(packed.samples), split(packed.slot), packed.opening, packed.begin)
    )[1]
    return jax.tree.map(lambda x: x.reshape(*x.shape[:-2], *shape), found)


def _flat(x: Array, structural: int, lanes: tuple[int, ...]) -> Array:
    """Lanes of `x` broadcast to `lanes` and laid out in one axis, with a unit axis after it: `(..., n, 1)`.
    All alike, they stay one: `(..., 1, 1)`."""
    if x.size == math.prod(x.shape[:structural]):
        return x.reshape(*x.shape[:structural], 1, 1)
    x = jnp.broadcast_to(align(x, structural, len(lanes)), (*x.shape[:structural], *lanes))
    return x.reshape(*x.shape[:structural], math.prod(lanes), 1)
