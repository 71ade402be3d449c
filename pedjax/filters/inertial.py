"""The inertial filter: strapdown navigation with the 15-state error covariance, and no measurement by itself.

Published defaults are OpenShoe's and PyShoe's (both use the same). PyShoe has no bias states; OpenShoe's
start as wide as an uncalibrated unit's, which costs a tenth of the accuracy on calibrated ones, so the
initial bias errors here are a calibrated unit's. Each parameter names its source.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.calibration.attitude import METHODS, Align
from pedjax.errors import InputError
from pedjax.filters import covariance, measurements, strapdown
from pedjax.filters.covariance import Covariance, ProcessNoise
from pedjax.filters.filter import Filter, Opening, Sample, still_mean
from pedjax.filters.first_bias import BIASES, Prior, first_bias, rest_asked
from pedjax.filters.strapdown import Navigation
from pedjax.lanes import align, lane_shape
from pedjax.parameters import group, leaf, parameters, setting

_OPENSHOE = "OpenShoe"
_KIT = "kit choice"
_SHEET = "kit choice: initial bias error of a calibrated unit (OpenShoe, uncalibrated: 0.3 m/s^2, 0.3 deg/s)"
_DEGREE = 0.017453292519943295
_PER_ROOT_HZ = 200.0**-0.5  # OpenShoe's per-sample deviations, at the 200 Hz of PyShoe's published runs


@parameters
class Process:
    """Process noise as densities, and the correlation times of the biases."""

    accelerometer: Array = leaf(
        0.5 * _PER_ROOT_HZ, unit="m/s^2/sqrt(Hz)", low=1e-5, high=10.0, source=f"{_OPENSHOE}: 0.5 a sample",
        tune=True,
        meaning="White noise of the accelerometer; raised, the predicted velocity is trusted less and "
        "stances correct it more.",
    )  # fmt: skip
    gyroscope: Array = leaf(
        0.5 * _DEGREE * _PER_ROOT_HZ, unit="rad/s/sqrt(Hz)", low=1e-7, high=0.1,
        source=f"{_OPENSHOE}: 0.5 deg/s a sample", tune=True,
        meaning="White noise of the gyroscope; raised, the predicted attitude is trusted less and "
        "measurements turn it more.",
    )  # fmt: skip
    accelerometer_bias: Array = leaf(
        1e-7 / _PER_ROOT_HZ, unit="m/s^3/sqrt(Hz)", low=1e-9, high=1.0, source=f"{_OPENSHOE}: 1e-7 a sample",
        meaning="How fast the accelerometer's bias may wander; raised, its estimate follows sooner and "
        "is noisier.",
    )  # fmt: skip
    gyroscope_bias: Array = leaf(
        1e-7 / _PER_ROOT_HZ * _DEGREE, unit="rad/s^2/sqrt(Hz)", low=1e-10, high=0.1,
        source=f"{_OPENSHOE}: 1e-7 deg/s a sample",
        meaning="How fast the gyroscope's bias may wander; raised, its estimate follows sooner and is "
        "noisier.",
    )  # fmt: skip
    accelerometer_bias_time: Array = leaf(
        1e6, unit="s", low=1.0, high=1e9, source="kit choice: random walk",
        meaning="Correlation time of the accelerometer's bias; raised, its estimate decays to zero more "
        "slowly.",
    )  # fmt: skip
    gyroscope_bias_time: Array = leaf(
        1e6, unit="s", low=1.0, high=1e9, source="kit choice: random walk",
        meaning="Correlation time of the gyroscope's bias; raised, its estimate decays to zero more slowly.",
    )  # fmt: skip


@parameters
class Initial:
    """Standard deviations of the first state, how it is levelled, and whether a standing start measures the
    gyroscope's first bias."""

    attitude: Array = leaf(
        0.1 * _DEGREE, unit="rad", low=1e-6, high=1.0, source=_OPENSHOE, tune=True,
        meaning="Standard deviation of the first roll and pitch; raised, the first stances correct the "
        "tilt more.",
    )  # fmt: skip
    heading_sigma: Array = leaf(
        0.1 * _DEGREE, unit="rad", low=1e-6, high=3.2, source=_OPENSHOE,
        meaning="Standard deviation of the first yaw where the compass does not give it; raised, early "
        "headings turn the track more.",
    )  # fmt: skip
    gyroscope_bias: Array = leaf(
        7e-4, unit="rad/s", low=1e-8, high=0.1, source=f"{_SHEET}, 0.04 deg/s", tune=True,
        meaning="Standard deviation of the gyroscope's first bias, zero until rest measures it; raised, "
        "rest and early measurements change it more.",
    )  # fmt: skip
    accelerometer_bias: Array = leaf(
        0.02, unit="m/s^2", low=1e-6, high=3.0, source=f"{_SHEET}, 2 mg", tune=True,
        meaning="Standard deviation of the accelerometer's first bias, zero; raised, early stances "
        "change it more.",
    )  # fmt: skip
    position: Array = leaf(
        1e-5, unit="m", low=1e-9, high=10.0, source=_OPENSHOE,
        meaning="Standard deviation of the first position; raised, its reported sigma grows; without "
        "position aids nothing else does.",
    )  # fmt: skip
    velocity: Array = leaf(
        1e-5, unit="m/s", low=1e-9, high=10.0, source=_OPENSHOE,
        meaning="Standard deviation of the first velocity, zero; raised, the first stances correct "
        "velocity and position more.",
    )  # fmt: skip
    heading: Array = leaf(
        0.0, unit="rad", low=-6.3, high=6.3, scale="linear", source="0: yaw is free",
        meaning="First yaw where the compass does not give it; raised, the track is turned "
        "counter-clockwise by as much.",
    )  # fmt: skip
    levelling_s: float = setting(
        0.1, source="PyShoe: the first 20 samples at 200 Hz",
        meaning="Length of the still stretch at the start, whose mean force gives the first roll and pitch.",
    )  # fmt: skip
    alignment: str = setting(
        "levelling", choices=METHODS, source="levelling: PyShoe; agda: Wang 2018",
        meaning="How the first attitude is found: tilt by levelling and yaw as given or by the first field, "
        "or both from force and field of the standing start.",
    )  # fmt: skip
    align: Align = group(Align, when={"alignment": METHODS[1:]})
    bias: str = setting(
        "zero", choices=BIASES, source=_KIT,
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
        meaning="How much a standing foot turns in a window of rest; raised, the mean rate at rest counts "
        "less as the first bias.",
    )  # fmt: skip


@parameters
class Strapdown:
    """How rate and force are integrated."""

    attitude_update: str = setting(
        "exponential", choices=strapdown.ATTITUDE_UPDATES, source=_KIT,
        meaning="How a sample's rotation is put on the attitude: exactly, by a Padé approximation, or to "
        "first order.",
    )  # fmt: skip
    force_attitude: str = setting(
        "mean", choices=strapdown.FORCE_ATTITUDES, source="mean: Fischer; new: PyShoe",
        meaning="Which attitude turns the force: the mean of old and new, or the new, for a force half a "
        "sample late.",
    )  # fmt: skip


@parameters
class InertialParameters:
    """Parameters of the inertial filter."""

    gravity: Array = leaf(
        9.8029, unit="m/s^2", low=9.7, high=9.9, scale="linear", source="PyShoe",
        meaning="Magnitude of gravity, taken off the specific force; raised, the predicted height sinks "
        "between stances.",
    )  # fmt: skip
    strapdown: Strapdown = group(Strapdown)
    process: Process = group(Process)
    initial: Initial = group(Initial)


def start(p: InertialParameters, opening: Opening) -> tuple[Navigation, Covariance]:
    """Levelled by the first samples, heading given, at rest at the origin; the gyroscope's bias zero, or as
    the standing start measures it."""
    if p.initial.alignment != "levelling" and opening.field is None:
        raise InputError(
            f"initial.alignment = {p.initial.alignment} goes by the magnetic field, which this system does "
            "not read; take levelling, or a system that does (wang with compass.update = none has zero "
            "velocities alone)"
        )
    mean = still_mean(opening, opening.force)
    shape = lane_shape(p, mean[0])
    like = jnp.zeros(shape, mean.dtype)
    ones = jnp.ones((3, *shape), mean.dtype)
    force = align(mean, 1, len(shape)) * ones
    nav = strapdown.still_at_origin(rotations.levelled(force, p.initial.heading + like))
    tilt_and_heading = jnp.stack(
        [x + like for x in (p.initial.attitude, p.initial.attitude, p.initial.heading_sigma)]
    )
    bias, bias_sigma = first_bias(p.initial, opening.rest, ones)
    nav = nav._replace(gyroscope_bias=bias)
    deviations = {
        "t": tilt_and_heading,
        "g": bias_sigma,
        "p": p.initial.position * ones,
        "v": p.initial.velocity * ones,
        "a": p.initial.accelerometer_bias * ones,
    }
    return nav, covariance.diagonal(deviations)


def predict(
    p: InertialParameters, nav: Navigation, P: Covariance, sample: Sample
) -> tuple[Navigation, Covariance]:
    """Mechanise the estimate, and propagate its covariance, over one sample."""
    dt = sample.dt
    force, rate = sample.force - nav.accelerometer_bias, sample.rate - nav.gyroscope_bias
    how = p.strapdown
    nav, middle, force_n = strapdown.mechanise(
        nav, force, rate, dt, p.gravity, how.attitude_update, how.force_attitude
    )
    noise = ProcessNoise(
        p.process.gyroscope,
        p.process.accelerometer,
        p.process.gyroscope_bias,
        p.process.accelerometer_bias,
        p.process.gyroscope_bias_time,
        p.process.accelerometer_bias_time,
    )
    F = covariance.inertial_transition(middle, force_n, dt, noise)
    P = covariance.predict(P, F, covariance.inertial_noise(noise, dt, force_n[0]))
    nav = nav._replace(  # a bias that decays in the model decays in the estimate
        gyroscope_bias=jnp.exp(-dt / noise.gyroscope_bias_time) * nav.gyroscope_bias,
        accelerometer_bias=jnp.exp(-dt / noise.accelerometer_bias_time) * nav.accelerometer_bias,
    )
    return nav, P


INERTIAL = Filter(
    name="inertial",
    parameters=InertialParameters,
    opening_s=lambda p: p.initial.levelling_s,
    start=start,
    predict=predict,
    correct=measurements.correct,
    states=(
        ("attitude", "t"),
        ("gyroscope_bias", "g"),
        ("position", "p"),
        ("velocity", "v"),
        ("accelerometer_bias", "a"),
    ),
    rest_s=rest_asked,
)
