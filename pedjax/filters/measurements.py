"""Measurement rows of the 15-state filter, and how a correction enters the state."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.filters.kalman import Rows
from pedjax.filters.strapdown import Navigation
from pedjax.lanes import constant, eye, hypotenuse, matmul, matmul_t, matvec, norm
from pedjax.rotations import skew


def zero_velocity(nav: Navigation, sigma: Array) -> Rows:
    """ZUPT: the velocity is zero with standard deviation `sigma (*L)` m/s; z = 0 − v̂, H = I on v."""
    return Rows(-nav.velocity, sigma * sigma * eye(3, nav.velocity[0]), {"v": None})


def zero_angular_rate(nav: Navigation, measured_rate: Array, sigma: Array) -> Rows:
    """ZARU: what the gyroscope reads is its bias, `sigma (*L)` rad/s; z = ω − b̂, H = I on g.

    (Ma's Eq. 36, meant as heading and velocity rows, prints exactly this one and the ZUPT.)
    """
    innovation = measured_rate - nav.gyroscope_bias
    return Rows(innovation, sigma * sigma * eye(3, innovation[0]), {"g": None})


def azimuth_row(field: Array) -> Array:
    """h `(1, 3, *L)` with δazimuth = h · t of a field `(3, *L)` that the attitude turned into navigation
    axes: [−B_z B_x/H², −B_z B_y/H², 1]. A tilt error tells on it by the field's inclination."""
    level = field[0] ** 2 + field[1] ** 2 + 1e-9
    x, y = (-field[2] * field[k] / level for k in range(2))
    return jnp.stack([x, y, jnp.ones_like(x)])[None]


def heading(innovation: Array, row: Array, sigma: Array) -> Rows:
    """Heading: z = true − estimated `(*L)` in rad, H = h `(1, 3, *L)` on t (Ma 2018, Eq. 35-38)."""
    z = (innovation * jnp.ones_like(row[0, 0]))[None]
    return Rows(z, (sigma * sigma * jnp.ones_like(z[0]))[None, None], {"t": row})


def level(nav: Navigation, force: Array, sigma: Array) -> Rows:
    """Tilt by the specific force `force (3, *L)` of a body at rest, `sigma (*L)` rad: turned into navigation
    axes and of length 1 it is (−t_y, t_x, 1), so that z = (f_y, −f_x), H = [I 0] on t. No Euler angles."""
    up = matvec(nav.attitude, force)
    size = norm(force, small=1e-12)
    z = jnp.stack([up[1] / size, -up[0] / size])
    H = constant(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), z[0]) + 0 * z[0]
    return Rows(z, sigma * sigma * eye(2, z[0]) + 0 * z[0], {"t": H})


def euler_block(attitude: Array) -> Array:
    """M `(3, 3, *L)` with δ(roll, pitch, yaw) = M t for an error t of the `attitude (3, 3, *L)` in navigation
    axes: [[cos ψ/cos θ, sin ψ/cos θ, 0], [−sin ψ, cos ψ, 0], [tan θ cos ψ, tan θ sin ψ, 1]]. (Zhang, Eq. 29,
    prints the identity.) Unbounded at θ = ±90 degrees, where it is cut off."""
    level = hypotenuse(attitude[0, 0], attitude[1, 0], small=1e-6)  # cos θ
    cos, sin = attitude[0, 0] / level, attitude[1, 0] / level
    tan, none = -attitude[2, 0] / level, 0 * level
    return jnp.stack(
        [
            jnp.stack([cos / level, sin / level, none]),
            jnp.stack([-sin, cos, none]),
            jnp.stack([tan * cos, tan * sin, none + 1]),
        ]
    )


def euler(nav: Navigation, angles: Sequence[Array], sigma: Array, printed: bool = False) -> Rows:
    """Roll, pitch and, if three are given, yaw as measured, `angles (*L)` rad, with `sigma (*L)` rad (Zhang,
    Eq. 22, 29-31): z = wrap(measured − estimated), H = the first rows of `euler_block` on t; or, as
    `printed`, of the identity."""
    count = len(angles)
    found = rotations.to_euler(nav.attitude)
    z = jnp.stack([rotations.wrap(x - found[k]) for k, x in enumerate(angles)])
    block = eye(3, z[0]) + 0 * z[0] if printed else euler_block(nav.attitude)
    return Rows(z, sigma * sigma * eye(count, z[0]) + 0 * z[0], {"t": block[:count]})


def same_field(field: Array, anchor: Array, sigma: Array) -> Rows:
    """The field is what it was at the anchor: z = B_anchor − Ĉ m = [t×] B, H = −[B×] on t, with independent
    noise of `sigma (*L)` µT in both (Afzal 2011, written in navigation axes)."""
    return Rows(anchor - field, 2 * sigma * sigma * eye(3, field[0]), {"t": -skew(field)})


def field_rate(
    nav: Navigation, measured_rate: Array, before: Array, after: Array, dt: Array, noises: tuple[Array, Array]
) -> Rows:
    """In a field that does not change, a body sees it turn as it turns itself: ṁ = −ω × m, so that z = ṁ +
    (ω − b̂) × m is g × m, H = −[m×] on g (Afzal 2011). `before`, `after (3, *L)` µT; `noises` are of one
    sample of the magnetometer, µT, and of the gyroscope, rad/s."""
    sigma_field, sigma_rate = noises
    across = skew(0.5 * (before + after))
    step = jnp.maximum(dt, 1e-6)
    z = (after - before) / step - matvec(across, measured_rate - nav.gyroscope_bias)
    noise = 2 * (sigma_field / step) ** 2 * eye(3, z[0]) + sigma_rate**2 * matmul_t(across, across)
    return Rows(z, noise, {"g": -across})


def correct(nav: Navigation, correction: dict[str, Array]) -> Navigation:
    """truth = estimate ⊞ error: C = exp([t×]) Ĉ, all else added; what is not corrected stays."""

    def added(x: Array, letter: str) -> Array:
        return x + correction[letter] if letter in correction else x

    C = nav.attitude
    return Navigation(
        attitude=matmul(rotations.exp(correction["t"]), C) if "t" in correction else C,
        gyroscope_bias=added(nav.gyroscope_bias, "g"),
        position=added(nav.position, "p"),
        velocity=added(nav.velocity, "v"),
        accelerometer_bias=added(nav.accelerometer_bias, "a"),
    )
