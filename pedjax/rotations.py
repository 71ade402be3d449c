"""Rotations for any lanes: matrices `(3, 3, *L)`, vectors `(3, *L)`, angles in rad.

C maps body to navigation axes. Euler angles are ZYX: C = Rz(yaw) Ry(pitch) Rx(roll), yaw counter-clockwise
about the navigation frame's +z. Gradients are finite everywhere, at angle zero and at gimbal lock too.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax.lanes import constant, dot, eye, hypotenuse, matmul, matmul_t, matvec, norm


def wrap(angle: Array) -> Array:
    """The same angle in (-pi, pi]."""
    return jnp.arctan2(jnp.sin(angle), jnp.cos(angle))


_EPSILON = np.cross(np.eye(3)[:, None], np.eye(3)[None]).transpose(2, 1, 0)
"""skew(x)[i, j] = sum over k of this [i, j, k] x[k]."""


def skew(x: Array) -> Array:
    """[x×], the matrix of the vector product: skew(x) y = x × y."""
    return jnp.sum(constant(_EPSILON, x[0]) * x[None, None], axis=2)


def _sinc_terms(square: Array) -> tuple[Array, Array]:
    """sin(a)/a and (1 − cos(a))/a² from a².

    Through tan(a/2)/(a/2) = N/D, the [4/4] convergent of its continued fraction: sin(a)/a is
    D N / (D² + N² a²/4) and the other N²/2 over the same. Smooth at zero, without a branch or a sine, and a
    rotation made of them is orthonormal whatever N/D. Exact to rounding up to 1.5 rad, to 1e-9 up to half
    a turn.
    """
    x = 0.25 * square
    n = 34459425.0 - x * (4729725.0 - x * (135135.0 - x * (990.0 - x)))
    d = 34459425.0 - x * (16216200.0 - x * (945945.0 - x * (13860.0 - 45.0 * x)))
    n, d = n * 1e-7, d * 1e-7  # keeps squares small in float32
    whole = d * d + x * n * n
    return d * n / whole, 0.5 * n * n / whole


def exp(phi: Array) -> Array:
    """Rotation matrix of the rotation vector `phi (3, *L)`, up to half a turn (Rodrigues)."""
    square = dot(phi, phi)
    sine, cosine = _sinc_terms(square)
    one, epsilon = constant(np.eye(3), square), constant(_EPSILON, square)
    # one sum over k, so that the compiler makes the matrix once: it repeats anything cheaper in every use
    turn = epsilon * (sine * phi)
    stretch = one[None] * (cosine * phi[:, None, None] * phi)
    keep = one[:, :, None] * one[None] * (1 - cosine * square)
    return jnp.sum(keep + turn + stretch, axis=2)


def cayley(phi: Array) -> Array:
    """Padé (Cayley) approximation (2I + [phi×])(2I − [phi×])⁻¹ in closed form: turns by 2 atan(|phi|/2)."""
    half = 0.5 * phi
    square = dot(half, half)
    identity = eye(3, square)
    return identity + 2 / (1 + square) * (skew(half) + half[:, None] * half[None] - square * identity)


def first_order(phi: Array) -> Array:
    """I + [phi×], not a rotation: follow it with `orthonormalise`."""
    return eye(3, phi[0]) + skew(phi)


def orthonormalise(c: Array) -> Array:
    """One Newton step towards the nearest rotation: C − ½ (C Cᵀ − I) C."""
    return c - 0.5 * matmul(matmul_t(c, c) - eye(3, c[0, 0]), c)


def log(c: Array) -> Array:
    """Rotation vector `(3, *L)` of a rotation matrix, for angles below pi; of what is none it is finite."""
    axial = 0.5 * jnp.stack([c[2, 1] - c[1, 2], c[0, 2] - c[2, 0], c[1, 0] - c[0, 1]])
    sine_square = dot(axial, axial)
    cosine = 0.5 * (c[0, 0] + c[1, 1] + c[2, 2] - 1)
    small = (sine_square < 1e-12) & (cosine > 0)
    safe = jnp.sqrt(jnp.where(small, 1.0, jnp.maximum(sine_square, 1e-24)))
    angle = jnp.arctan2(safe, cosine)
    return jnp.where(small, 1 + sine_square / 6, angle / safe) * axial


def from_euler(roll: Array, pitch: Array, yaw: Array) -> Array:
    """C = Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp, cy, sy = (
        jnp.cos(roll), jnp.sin(roll), jnp.cos(pitch), jnp.sin(pitch), jnp.cos(yaw), jnp.sin(yaw),
    )  # fmt: skip
    return jnp.stack(
        [
            jnp.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr]),
            jnp.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr]),
            jnp.stack([-sp + 0 * cy, cp * sr + 0 * cy, cp * cr + 0 * cy]),
        ]
    )


def to_euler(c: Array) -> Array:
    """(roll, pitch, yaw) as `(3, *L)`; pitch through atan2, whose gradient stays finite at ±90 degrees."""
    level = hypotenuse(c[2, 1], c[2, 2], small=1e-24)
    return jnp.stack(
        [
            jnp.arctan2(c[2, 1], c[2, 2] + 1e-15),
            jnp.arctan2(-c[2, 0], level),
            jnp.arctan2(c[1, 0], c[0, 0] + 1e-15),
        ]
    )


def from_quaternion(q: Array) -> Array:
    """Rotation matrix of the scalar-first quaternion `q (4, *L)`, normalised here."""
    w, x, y, z = q / norm(q, small=1e-30)
    return jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def tilt(force: Array) -> tuple[Array, Array]:
    """Roll and pitch of a body at rest from its specific force `(3, *L)`, z up."""
    level = hypotenuse(force[1], force[2], small=1e-24)
    return jnp.arctan2(force[1], force[2] + 1e-15), jnp.arctan2(-force[0], level)


def level_axes(up: Array, ahead: int = 0) -> tuple[Array, Array, Array]:
    """The axes x, y, z `(3, *L)` of a level frame, seen by a body in which `up (3, *L)`, of any length,
    points up: z is up, and x the level direction of the body axis `ahead` (0, 1, 2), which must not be
    upright itself. With axis 0 they are the rows of Ry(pitch) Rx(roll).
    """
    z = _unit(up)
    x = _unit(constant(np.eye(3)[ahead], up[0]) - z[ahead] * z)
    return x, matvec(skew(z), x), z


def _unit(x: Array) -> Array:
    """x over its length; with a finite slope, and itself, where it has none."""
    square = dot(x, x)
    some = square > 1e-12
    return x / jnp.sqrt(jnp.where(some, square, 1.0))


def levelled(force: Array, heading: Array) -> Array:
    """Attitude of a body at rest: roll and pitch from `force (3, *L)`, yaw given."""
    roll, pitch = tilt(force)
    shape = jnp.broadcast_shapes(roll.shape, heading.shape)
    return from_euler(*(jnp.broadcast_to(angle, shape) for angle in (roll, pitch, heading)))
