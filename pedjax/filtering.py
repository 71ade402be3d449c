"""The one driver: any system over time, one walk or many lanes, forward or with gradients.

Time runs in chunks of about √T samples inside an outer scan. Reverse-mode differentiation then keeps only
the state at the chunks' borders and recomputes inside (memory grows with √T, not T), and a score needs only
the few samples of a chunk that it looks at.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pedjax.lanes import align
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

    Parameters have lanes `(..., 1)` or none; the result has lanes `(..., C)`.
    """
    chunks = packed.begin.shape[0]
    split = partial(jax.tree.map, lambda x: x.reshape(chunks, x.shape[0] // chunks, *x.shape[1:]))
    first = system.start(parameters, jax.tree.map(lambda x: x[0], packed.opening))
    like = jax.eval_shape(
        lambda s: system.step(parameters, s, jax.tree.map(lambda x: x[0], packed.samples))[1], first
    ).navigation.position
    lanes = len(like.shape) - 1
    rows = jnp.arange(slots).reshape((slots,) + (1,) * (lanes + 1))

    def inner(carry: Any, sample: tuple[Any, Array]) -> tuple[Any, None]:
        state, buffer, updates = carry
        state, output = system.step(parameters, state, sample[0])
        here = align(sample[1], 0, lanes)[None]
        buffer = jnp.where(rows == here, output.navigation.position, buffer)
        return (state, buffer, updates + output.stance), None

    @jax.checkpoint
    def outer(state: Any, part: tuple[Any, Array, Any, Array]) -> tuple[Any, Points]:
        samples, slot, opening, begin = part
        fresh = system.start(parameters, opening)
        state = jax.tree.map(lambda new, old: jnp.where(begin, new, old), fresh, state)
        buffer = jnp.zeros((slots, *like.shape), like.dtype)
        updates = jnp.zeros(like.shape[1:], like.dtype)
        (state, buffer, updates), _ = jax.lax.scan(inner, (state, buffer, updates), (samples, slot))
        return state, Points(buffer, updates, state.healthy)

    return jax.lax.scan(
        outer, first, (split(packed.samples), split(packed.slot), packed.opening, packed.begin)
    )[1]
