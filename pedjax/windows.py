"""Sliding windows over time, first axis, in O(T log W), without cancellation.

A window's value is merged from two overlapping-free halves again and again (W = 5 is 4 + 1, 4 is 2 + 2),
so every result depends on its own W samples alone, in a fixed order: cropping a recording at either end
changes no bit of what is left. `trailing` windows end at their sample and are causal; `centred` ones are not.
The first W − 1 trailing windows reach before the first sample: it is repeated to fill them, and
`is_complete` tells which are whole.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import Array

Tree = TypeVar("Tree")


def delay(x: Tree, steps: int) -> Tree:
    """`x` as it was that many samples ago, the first sample repeated."""
    if steps == 0:
        return x

    def shift(a: Array) -> Array:
        lead = jnp.broadcast_to(a[:1], (min(steps, a.shape[0]), *a.shape[1:]))
        return jnp.concatenate([lead, a[: max(a.shape[0] - steps, 0)]])

    return jax.tree.map(shift, x)


def trailing(merge: Callable[[Tree, Tree], Tree], x: Tree, width: int) -> Tree:
    """Merge the `width` samples that end at each sample by an associative `merge(earlier, later)`."""
    if width < 1:
        raise ValueError(f"a window needs at least one sample, not {width}")
    result: Tree | None = None
    covered, block, size, rest = 0, x, 1, width
    while rest:
        if rest & 1:
            result = block if result is None else merge(delay(block, covered), result)
            covered += size
        rest >>= 1
        if rest:
            block = merge(delay(block, size), block)
            size *= 2
    assert result is not None
    return result


def trailing_mean(x: Array, width: int) -> Array:
    """Mean of the window that ends at each sample."""
    return trailing(jnp.add, x, width) / width


def trailing_moments(x: Array, width: int) -> tuple[Array, Array]:
    """Mean and variance (population) of the window that ends at each sample, `(T, ...)` both.

    The halves' means and squared deviations are merged pairwise (Chan), exact to rounding even where the
    mean is thousands of deviations away.
    """
    Moments = tuple[Array, Array, Array]

    def merge(a: Moments, b: Moments) -> Moments:
        count_a, mean_a, square_a = a
        count_b, mean_b, square_b = b
        count = count_a + count_b
        step = mean_b - mean_a
        mean = mean_a + step * (count_b / count)
        return count, mean, square_a + square_b + step * step * (count_a * count_b / count)

    ones = jnp.ones((x.shape[0],) + (1,) * (x.ndim - 1), x.dtype)
    _, mean, square = trailing(merge, (ones, x, jnp.zeros_like(x)), width)
    return mean, square / width


def is_complete(length: int, width: int) -> Array:
    """Whether the trailing window of each of `length` samples is whole."""
    return jnp.arange(length) >= width - 1
