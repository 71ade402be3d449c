"""Measurement rows of the 15-state filter, and how a correction enters the state."""

from __future__ import annotations

from jax import Array

from pedjax import rotations
from pedjax.filters.covariance import Rows
from pedjax.filters.strapdown import Navigation
from pedjax.lanes import eye, matmul


def zero_velocity(nav: Navigation, sigma: Array) -> Rows:
    """ZUPT: the velocity is zero with standard deviation `sigma (*L)` m/s; z = 0 − v̂, H = I on v."""
    return Rows(-nav.velocity, sigma * sigma * eye(3, nav.velocity[0]), {"v": None})


def zero_angular_rate(nav: Navigation, measured_rate: Array, sigma: Array) -> Rows:
    """ZARU: what the gyroscope reads is its bias, `sigma (*L)` rad/s; z = ω − b̂, H = I on g.

    (Ma's Eq. 36, meant as heading and velocity rows, prints exactly this one and the ZUPT.)
    """
    innovation = measured_rate - nav.gyroscope_bias
    return Rows(innovation, sigma * sigma * eye(3, innovation[0]), {"g": None})


def correct(nav: Navigation, correction: dict[str, Array]) -> Navigation:
    """truth = estimate ⊞ error: C = exp([t×]) Ĉ, all else added."""
    return Navigation(
        attitude=matmul(rotations.exp(correction["t"]), nav.attitude),
        gyroscope_bias=nav.gyroscope_bias + correction["g"],
        position=nav.position + correction["p"],
        velocity=nav.velocity + correction["v"],
        accelerometer_bias=nav.accelerometer_bias + correction["a"],
    )
