"""Strapdown mechanisation in the ENU frame: attitude, velocity and position from rate and force."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.lanes import eye, matmul, matvec

ATTITUDE_UPDATES = ("exponential", "pade", "first_order")
FORCE_ATTITUDES = ("mean", "new")


class Navigation(NamedTuple):
    """What the filter estimates, lanes last.

    `attitude (3, 3, *L)` body to navigation; `gyroscope_bias`, `position`, `velocity`, `accelerometer_bias`
    `(3, *L)` in rad/s, m, m/s, m/s^2. Biases are what is in the measurement: measured = true + bias.
    """

    attitude: Array
    gyroscope_bias: Array
    position: Array
    velocity: Array
    accelerometer_bias: Array


def still_at_origin(attitude: Array) -> Navigation:
    """At the origin, at rest, biases zero."""
    zero = jnp.zeros_like(attitude[0])
    return Navigation(attitude, zero, zero, zero, zero)


def turn(attitude: Array, phi: Array, method: str = "exponential") -> Array:
    """The attitude after the body turned by `phi = omega dt`.

    `exponential` is exact for a constant rate; `pade` is Ma Eq. 27 and Zhang Eq. 6 (turns by
    2 atan(|phi|/2)); `first_order` is Wang Eq. 1, made a rotation again by one Newton step.
    """
    if method == "exponential":
        return matmul(attitude, rotations.exp(phi))
    if method == "pade":
        return matmul(attitude, rotations.cayley(phi))
    return rotations.orthonormalise(matmul(attitude, rotations.first_order(phi)))


def mechanise(
    nav: Navigation,
    force: Array,
    rate: Array,
    dt: Array,
    gravity: Array,
    method: str = "exponential",
    force_attitude: str = "mean",
) -> tuple[Navigation, Array, Array]:
    """One step of `dt` s with bias-free specific force `(3, *L)` and angular rate `(3, *L)`.

    The force is turned by the mean of the old and the new attitude (Fischer), or by the `new` one (Wang
    Eq. 1, PyShoe), which fits a force that lags the rate by half a sample. The position moves with the *old*
    velocity plus a dt²/2 (Wang's Eq. 1 takes the new one and overshoots). Returns the new state, the attitude
    that turned the force, and the specific force in the navigation frame.
    """
    attitude = turn(nav.attitude, rate * dt, method)
    middle = attitude if force_attitude == "new" else 0.5 * (nav.attitude + attitude)
    force_n = matvec(middle, force)
    up = eye(3, force_n[0])[2]
    acceleration = force_n - gravity * up
    position = nav.position + dt * nav.velocity + 0.5 * dt * dt * acceleration
    velocity = nav.velocity + dt * acceleration
    return nav._replace(attitude=attitude, position=position, velocity=velocity), middle, force_n
