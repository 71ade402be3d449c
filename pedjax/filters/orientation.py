"""Attitude and gyroscope bias of a body that never rests: the twin of Munoz Diaz's filter, without angles.

C is propagated as a rotation matrix, its error is a small rotation t in navigation axes, C = exp([t×]) Ĉ, and
g is the error of the bias: nothing is singular, whatever way a phone hangs in a pocket. `ORIENTATION` has
these six states and takes the force as the direction of up. `BOUNDED` has the velocity v beside, from force
less gravity, and leaves it to an aid to say that it stays near zero: a force is then an acceleration that
sums up to nothing much, not an error of the tilt.

    Ĉ ← Ĉ exp([(ω − b) dt ×]),  b ← e^(−dt/τ) b,  v ← v + (C̄ f − g) dt,
    ṫ = −C g,  v̇ = −[C̄ f ×] t,  C̄ the mean of old and new Ĉ.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.detectors.rest import Rest
from pedjax.filters import covariance
from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Filter, Opening, Sample, still_mean
from pedjax.filters.first_bias import BIASES, Prior, first_bias, rest_asked
from pedjax.lanes import align, constant, dot, eye, lane_shape, matmul, matvec
from pedjax.parameters import group, leaf, parameters, setting
from pedjax.rotations import skew

_KIT = "kit choice"
_DEGREE = 0.017453292519943295


@parameters
class Process:
    """Process noise as densities, and how the bias of the gyroscope wanders."""

    gyroscope: Array = leaf(
        1e-2 * _DEGREE, unit="rad/s/sqrt(Hz)", low=1e-7, high=0.1, tune=True,
        source="Munoz Diaz 2017, Table 2: 0.1 deg/s a sample, at 100 Hz",
        meaning="White noise of the gyroscope; raised, force and field turn the attitude more.",
    )  # fmt: skip
    gyroscope_scale: Array = leaf(
        0.0, unit="sqrt(s)", low=0.0, high=0.1, scale="linear", source="0: none",
        meaning="Noise of the gyroscope in parts of its rate, as of a scale that is off; raised, fast turns "
        "leave the attitude less sure.",
    )  # fmt: skip
    gyroscope_bias: Array = leaf(
        1e-7, unit="rad/s^2/sqrt(Hz)", low=1e-10, high=0.1, source=f"{_KIT}: it hardly moves", tune=True,
        meaning="How fast the gyroscope's bias may wander; raised, its estimate follows sooner and is "
        "noisier.",
    )  # fmt: skip
    gyroscope_bias_time: Array = leaf(
        1e6, unit="s", low=1.0, high=1e9, source=f"{_KIT}: random walk; Munoz Diaz 2017: AR(1), not printed",
        meaning="Correlation time of the gyroscope's bias; raised, its estimate decays to zero more slowly.",
    )  # fmt: skip


@parameters
class BoundedProcess(Process):
    """With the noise of the force, which makes the velocity."""

    accelerometer: Array = leaf(
        0.13, unit="m/s^2/sqrt(Hz)", low=1e-5, high=10.0, source=_KIT, tune=True,
        meaning="White noise of the accelerometer; raised, a velocity that is bounded tells less of the "
        "tilt.",
    )  # fmt: skip


@parameters
class Initial:
    """The first attitude and bias, and how sure they are."""

    attitude: Array = leaf(
        2.0 * _DEGREE, unit="rad", low=1e-6, high=1.5, source=_KIT, tune=True,
        meaning="Standard deviation of the first roll and pitch; raised, the first forces correct the tilt "
        "more.",
    )  # fmt: skip
    heading_sigma: Array = leaf(
        0.1 * _DEGREE, unit="rad", low=1e-6, high=3.2, source=f"{_KIT}: yaw is free",
        meaning="Standard deviation of the first yaw; raised, early fields turn the heading more.",
    )  # fmt: skip
    heading: Array = leaf(
        0.0, unit="rad", low=-6.3, high=6.3, scale="linear", source="0: yaw is free",
        meaning="First yaw, of the body's x; raised, the track is turned counter-clockwise by as much.",
    )  # fmt: skip
    gyroscope_bias: Array = leaf(
        1e-2, unit="rad/s", low=1e-8, high=0.35, source=f"{_KIT}: 0.57 deg/s, a unit that is not calibrated",
        tune=True,
        meaning="Standard deviation of the gyroscope's first bias; raised, rest, force and field change it "
        "more.",
    )  # fmt: skip
    levelling_s: float = setting(
        1.0, source="Munoz Diaz 2017: 1 (unit lost) of standing",
        meaning="Length of the stretch at the start, whose mean force gives the first roll and pitch.",
    )  # fmt: skip
    bias: str = setting(
        "zero", choices=BIASES, source="zero: Munoz Diaz 2017, Fig. 8-10",
        meaning="The gyroscope's first bias: zero, as given, or that and the rest with which a recording "
        "begins, which the start then reads ahead.",
    )  # fmt: skip
    prior: Prior = group(Prior, when={"bias": ("given", "rest")})
    rest_s: float = setting(
        10.0, source=_KIT,
        meaning="How much of the start is looked at for rest, if it gives the first bias; longer, a long "
        "rest counts for more.",
    )  # fmt: skip
    sway: Array = leaf(
        0.25 * _DEGREE, unit="rad/s", low=1e-6, high=0.1, source=f"{_KIT}, 0.25 deg/s", tune=True,
        when={"bias": "rest"},
        meaning="How much a standing leg turns in a window of rest; raised, the mean rate at rest counts "
        "less as the first bias.",
    )  # fmt: skip


@parameters
class BoundedInitial(Initial):
    """With the first velocity."""

    velocity: Array = leaf(
        0.5, unit="m/s", low=1e-5, high=10.0, source=_KIT,
        meaning="Standard deviation of the first velocity, zero; raised, the first bounds correct tilt and "
        "velocity more.",
    )  # fmt: skip


@parameters
class OrientationParameters:
    """Parameters of the attitude filters."""

    gravity: Array = leaf(
        9.8, unit="m/s^2", low=9.7, high=9.9, scale="linear", source="Munoz Diaz 2017",
        meaning="Magnitude of gravity; raised, a force must be larger to pass as gravity alone.",
    )  # fmt: skip
    process: Process = group(Process)
    initial: Initial = group(Initial)


@parameters
class BoundedParameters:
    """Parameters of the attitude filter with a velocity."""

    gravity: Array = leaf(
        9.8, unit="m/s^2", low=9.7, high=9.9, scale="linear", source="Munoz Diaz 2017",
        meaning="Magnitude of gravity, taken off the specific force; raised, the predicted velocity sinks.",
    )  # fmt: skip
    process: BoundedProcess = group(BoundedProcess)
    initial: BoundedInitial = group(BoundedInitial)


class Oriented(NamedTuple):
    """`attitude (3, 3, *L)` body to navigation, `gyroscope_bias (3, *L)` rad/s, and `position (3, *L)` m,
    which only steps move."""

    attitude: Array
    gyroscope_bias: Array
    position: Array


class Moving(NamedTuple):
    """With the `velocity (3, *L)` m/s of the sensor about the walker's."""

    attitude: Array
    gyroscope_bias: Array
    position: Array
    velocity: Array


def levelled_start(p: Any, opening: Opening) -> tuple[Array, Array, dict[str, Array]]:
    """First attitude, first bias, and their standard deviations by letter."""
    mean = still_mean(opening, opening.force)
    shape = lane_shape(p, mean[0])
    ones = jnp.ones((3, *shape), mean.dtype)
    force = align(mean, 1, len(shape)) * ones
    attitude = rotations.levelled(force, p.initial.heading + 0 * ones[0])
    rest: Rest | None = opening.rest
    bias, sigma = first_bias(p.initial, rest, ones)
    sure = jnp.stack(
        [x + 0 * ones[0] for x in (p.initial.attitude, p.initial.attitude, p.initial.heading_sigma)]
    )
    return attitude, bias, {"t": sure, "g": sigma}


def _start(p: OrientationParameters, opening: Opening) -> tuple[Oriented, Covariance]:
    attitude, bias, deviations = levelled_start(p, opening)
    return Oriented(attitude, bias, jnp.zeros_like(bias)), covariance.diagonal(deviations)


def _start_moving(p: BoundedParameters, opening: Opening) -> tuple[Moving, Covariance]:
    attitude, bias, deviations = levelled_start(p, opening)
    zero = jnp.zeros_like(bias)
    deviations["v"] = p.initial.velocity + zero
    return Moving(attitude, bias, zero, zero), covariance.diagonal(deviations)


def _turned(p: Any, estimate: Any, sample: Sample) -> tuple[Array, Array, Any, dict[str, Array]]:
    """New attitude, mean of old and new, and F and Q of attitude and bias."""
    dt, C = sample.dt, estimate.attitude
    rate = sample.rate - estimate.gyroscope_bias
    new = matmul(C, rotations.exp(rate * dt))
    middle = 0.5 * (C + new)
    F = {
        "t": {"t": None, "g": -dt * middle},
        "g": {"g": jnp.exp(-dt / p.process.gyroscope_bias_time)},
    }
    one = eye(3, rate[0])
    spread = p.process.gyroscope**2 + p.process.gyroscope_scale**2 * dot(rate, rate)
    return new, middle, F, {"t": spread * dt * one, "g": p.process.gyroscope_bias**2 * dt * one}


def _predict(
    p: OrientationParameters, estimate: Oriented, P: Covariance, sample: Sample
) -> tuple[Oriented, Covariance]:
    new, _, F, Q = _turned(p, estimate, sample)
    bias = F["g"]["g"] * estimate.gyroscope_bias
    return estimate._replace(attitude=new, gyroscope_bias=bias), covariance.predict(P, F, Q)


def _predict_moving(
    p: BoundedParameters, estimate: Moving, P: Covariance, sample: Sample
) -> tuple[Moving, Covariance]:
    new, middle, F, Q = _turned(p, estimate, sample)
    dt = sample.dt
    force = matvec(middle, sample.force)
    up = constant(np.array([0.0, 0.0, 1.0]), force[0])
    F["v"] = {"v": None, "t": -dt * skew(force)}
    Q["v"] = p.process.accelerometer**2 * dt * eye(3, force[0])
    moved = estimate._replace(
        attitude=new,
        gyroscope_bias=F["g"]["g"] * estimate.gyroscope_bias,
        velocity=estimate.velocity + (force - p.gravity * up) * dt,
    )
    return moved, covariance.predict(P, F, Q)


def correct(estimate: Any, correction: dict[str, Array]) -> Any:
    """truth = estimate ⊞ error: C = exp([t×]) Ĉ, all else added; what is not corrected stays."""
    changes = {}
    if "t" in correction:
        changes["attitude"] = matmul(rotations.exp(correction["t"]), estimate.attitude)
    for letter, name in (("g", "gyroscope_bias"), ("p", "position"), ("v", "velocity")):
        if letter in correction:
            changes[name] = getattr(estimate, name) + correction[letter]
    return estimate._replace(**changes)


ORIENTATION = Filter(
    name="orientation",
    parameters=OrientationParameters,
    opening_s=lambda p: p.initial.levelling_s,
    start=_start,
    predict=_predict,
    correct=correct,
    states=(("attitude", "t"), ("gyroscope_bias", "g")),
    rest_s=rest_asked,
)
"""Six states: attitude and gyroscope bias, from the rate alone."""

BOUNDED = Filter(
    name="bounded",
    parameters=BoundedParameters,
    opening_s=lambda p: p.initial.levelling_s,
    start=_start_moving,
    predict=_predict_moving,
    correct=correct,
    states=(("attitude", "t"), ("gyroscope_bias", "g"), ("velocity", "v")),
    rest_s=rest_asked,
)
"""Nine states: with the velocity, which `bounded_velocity` keeps small."""
