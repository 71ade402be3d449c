"""The field of a levelled body. Body forward-left-up, navigation ENU.

With the body's x ahead, roll and pitch from specific force f at rest (up),

    m_x' = m_x cos p + m_y sin p sin r + m_z sin p cos r
    m_y' = m_y cos r - m_z sin r
    m_z' = -m_x sin p + m_y cos p sin r + m_z cos p cos r

Ma 2018, Eq. 3-5, prints the opposite signs of both angles, which holds only in north-east-down, and takes
them by arc sines (Eq. 4 with a product where a quotient belongs).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.calibration.algebra import angle, norm
from pedjax.lanes import dot


def roll_pitch(force: Array) -> tuple[Array, Array]:
    """Roll and pitch in rad of a body at rest with specific force `(..., 3)`, in any unit.

    Where it says nothing of an angle (no force, or all of it along x) that is zero, with zero gradient, which
    a filter has no need of: it takes `rotations.tilt`.
    """
    return angle(force[..., 1], force[..., 2]), angle(-force[..., 0], norm(force[..., 1:]))


def level(force: Array, mag: Array, ahead: int = 0) -> Array:
    """The field `mag (..., 3)` of a body at rest in level axes `(..., 3)`: z up, x the level direction of the
    body axis `ahead`, which must not be upright."""
    axes = rotations.level_axes(jnp.moveaxis(force, -1, 0), ahead)
    return jnp.stack([dot(axis, jnp.moveaxis(mag, -1, 0)) for axis in axes], axis=-1)


def stance_means(values: Array, weights: Array, stances: Array, count: int) -> tuple[Array, Array]:
    """Weighted mean of `values (T, D)` over each stance: `(count, D)` and the weight in it `(count,)`.

    `stances (T,)` numbers them from 0, -1 outside; a stance without weight has mean zero.
    """
    index = jnp.where((stances >= 0) & (stances < count), stances, count)
    known = weights > 0
    values = jnp.where(known[:, None], values, 0.0)
    total = jax.ops.segment_sum(weights[:, None] * values, index, num_segments=count + 1)[:count]
    weight = jax.ops.segment_sum(weights, index, num_segments=count + 1)[:count]
    held = weight > 0
    return jnp.where(held[:, None], total / jnp.where(held, weight, 1.0)[:, None], 0.0), weight
