"""Heading errors: by how much an attitude is turned about up from the true one, the best constant taken
off."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array, lax

from pedjax import rotations
from pedjax.evaluation.landmarks import Reference, onto
from pedjax.lanes import matmul_t, root


def turn_about_up(attitude: Array, true: Array) -> Array:
    """The angle in rad about up of Ĉ Cᵀ for attitudes `(3, 3, *L)`: the error of the heading however the body
    is held, also where Euler's angles are not defined."""
    turn = matmul_t(attitude, true)
    return jnp.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])


def heading_rms(attitude: Array, reference: Reference) -> Array:
    """RMS in degrees `(*L)` of the heading errors of attitudes `(K, 3, 3, *L)`, after the best constant.

    The error is followed from point to point, so that it may grow beyond half a turn. NaN where no point
    has a true attitude.
    """
    reference = onto(reference, attitude.ndim - 3)
    true, known = reference.attitude, reference.oriented
    assert true is not None
    assert known is not None
    attitude, true = jnp.moveaxis(attitude, 0, 2), jnp.moveaxis(true, 0, 2)
    # where nothing is known there may be no rotation either, and then no slope
    error = turn_about_up(jnp.where(known > 0, attitude, true), true)
    known = known * jnp.ones_like(error)
    # from one known point to the next, over what is unknown between them
    place = jnp.arange(len(error)).reshape(-1, *(1,) * (error.ndim - 1))
    last = lax.cummax(jnp.where(known > 0, place, -1))
    before = jnp.concatenate([jnp.full_like(last[:1], -1), last[:-1]])
    steps = rotations.wrap(error - jnp.take_along_axis(error, jnp.maximum(before, 0), axis=0))
    steps = steps * known * (before >= 0)
    followed = jnp.cumsum(steps, axis=0)
    count = jnp.maximum(jnp.sum(known, axis=0), 1.0)
    away = (followed - jnp.sum(followed * known, axis=0) / count) * known
    square = jnp.sum(away * away, axis=0) / count
    return jnp.degrees(jnp.where(jnp.sum(known, axis=0) > 0, root(square), jnp.nan))
