"""From a stance mask to numbered stances: merge short gaps, drop short stances."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array


def stance_id(mask: Array) -> Array:
    """`(T,)` int: 0, 1, 2, ... for the samples of each stance, −1 outside."""
    starts = mask & ~jnp.concatenate([jnp.zeros(1, bool), mask[:-1]])
    return jnp.where(mask, jnp.cumsum(starts) - 1, -1)


def _durations(mask: Array, dt: Array) -> Array:
    """Duration in s of the run of True samples that each sample belongs to (0 where False)."""
    run = stance_id(mask)
    total = jax.ops.segment_sum(jnp.where(mask, dt, 0.0), jnp.maximum(run, 0), num_segments=mask.shape[0])
    return jnp.where(mask, total[jnp.maximum(run, 0)], 0.0)


def clean_stance(mask: Array, dt: Array, merge_s: float = 0.05, drop_s: float = 0.08) -> Array:
    """Fill gaps between stances shorter than `merge_s`, then drop stances shorter than `drop_s` (not causal).

    `mask (T,)` bool, `dt (T,)` s. The leading and the trailing swing are no gaps.
    """
    slack = 1e-6
    started = jnp.cumsum(mask) > 0
    ended = jnp.cumsum(mask[::-1])[::-1] == 0
    gap = ~mask & started & ~ended
    filled = mask | (gap & (_durations(~mask, dt) < merge_s - slack))
    return filled & (_durations(filled, dt) >= drop_s - slack)
