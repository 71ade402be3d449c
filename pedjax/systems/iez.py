"""IEZ: inertial navigation with a 15-state error-state EKF and zero-velocity updates (INS-EKF-ZUPT).

Published defaults: stance detector of PyShoe, filter noises of OpenShoe and PyShoe (both use the same).
PyShoe has no bias states; OpenShoe's start as wide as an uncalibrated unit's, which costs a tenth of the
accuracy on calibrated ones, so the initial bias errors here are a calibrated unit's. Each parameter below
names its source.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax import rotations
from pedjax.detectors import stance
from pedjax.filters import covariance, measurements, strapdown
from pedjax.filters.covariance import Covariance, ProcessNoise
from pedjax.filters.strapdown import Navigation
from pedjax.gates import gate
from pedjax.lanes import align, lane_shape
from pedjax.parameters import group, leaf, parameters, setting
from pedjax.system import Inputs, Output, Signals, System

_OPENSHOE = "OpenShoe"
_KIT = "kit choice"
_SHEET = "kit choice: initial bias error of a calibrated unit (OpenShoe, uncalibrated: 0.3 m/s^2, 0.3 deg/s)"
_FAR = 10.0  # log units beyond which a statistic says nothing more: bounds a missing window's influence
_DEGREE = 0.017453292519943295
_PER_ROOT_HZ = 200.0**-0.5  # OpenShoe's per-sample deviations, at the 200 Hz of PyShoe's published runs


@parameters
class Gate:
    """How the stance statistic becomes a weight, and how far its stance is believed.

    `fixed` is the published test against one threshold. `adaptive` is causal and follows the gait: the log
    threshold moves by `follow` times the recent level of the log statistic (a first-order average over
    `follow_time`), so that a runner's foot, never as still as a stroller's, is found still too; and the
    standard deviation of the zero velocity grows as (1 + statistic/(threshold e^floor))^growth, since a foot
    that turns also moves. follow = 0 and growth = 0 is `fixed`.

    With either, `hysteresis` multiplies the threshold while the foot is held still already.
    """

    kind: str = setting("fixed", choices=("fixed", "adaptive"), source="fixed: published")
    width: Array = leaf(0.0, unit="1", low=0.0, high=5.0, scale="linear", source="0: the published hard test")
    straight_through: bool = setting(False, source=_KIT)
    hysteresis: Array = leaf(1.0, unit="1", low=1.0, high=100.0, source="1: published")
    follow: Array = leaf(0.0, unit="1", low=-0.5, high=1.5, scale="linear", source="0: published")
    follow_time: Array = leaf(0.6, unit="s", low=0.05, high=30.0, source=_KIT)
    growth: Array = leaf(0.0, unit="1", low=-0.5, high=3.0, scale="linear", source="0: published")
    floor: Array = leaf(0.0, unit="1", low=-10.0, high=10.0, scale="linear", source=_KIT)


@parameters
class Process:
    """Process noise as densities, and the correlation times of the biases."""

    accelerometer: Array = leaf(
        0.5 * _PER_ROOT_HZ, unit="m/s^2/sqrt(Hz)", low=1e-5, high=10.0, source=f"{_OPENSHOE}: 0.5 a sample"
    )
    gyroscope: Array = leaf(
        0.5 * _DEGREE * _PER_ROOT_HZ, unit="rad/s/sqrt(Hz)", low=1e-7, high=0.1,
        source=f"{_OPENSHOE}: 0.5 deg/s a sample",
    )  # fmt: skip
    accelerometer_bias: Array = leaf(
        1e-7 / _PER_ROOT_HZ, unit="m/s^3/sqrt(Hz)", low=1e-9, high=1.0, source=f"{_OPENSHOE}: 1e-7 a sample"
    )
    gyroscope_bias: Array = leaf(
        1e-7 / _PER_ROOT_HZ * _DEGREE, unit="rad/s^2/sqrt(Hz)", low=1e-10, high=0.1,
        source=f"{_OPENSHOE}: 1e-7 deg/s a sample",
    )  # fmt: skip
    accelerometer_bias_time: Array = leaf(1e6, unit="s", low=1.0, high=1e9, source="kit choice: random walk")
    gyroscope_bias_time: Array = leaf(1e6, unit="s", low=1.0, high=1e9, source="kit choice: random walk")


@parameters
class Initial:
    """Standard deviations of the first state, and how it is levelled."""

    attitude: Array = leaf(0.1 * _DEGREE, unit="rad", low=1e-6, high=1.0, source=_OPENSHOE)
    heading_sigma: Array = leaf(0.1 * _DEGREE, unit="rad", low=1e-6, high=3.2, source=_OPENSHOE)
    gyroscope_bias: Array = leaf(7e-4, unit="rad/s", low=1e-8, high=0.1, source=f"{_SHEET}, 0.04 deg/s")
    accelerometer_bias: Array = leaf(0.02, unit="m/s^2", low=1e-6, high=3.0, source=f"{_SHEET}, 2 mg")
    position: Array = leaf(1e-5, unit="m", low=1e-9, high=10.0, source=_OPENSHOE)
    velocity: Array = leaf(1e-5, unit="m/s", low=1e-9, high=10.0, source=_OPENSHOE)
    heading: Array = leaf(0.0, unit="rad", low=-6.3, high=6.3, scale="linear", source="0: yaw is free")
    levelling_s: float = setting(0.1, source="PyShoe: the first 20 samples at 200 Hz")


@parameters
class Updates:
    """Measurement noises, and which rows are on."""

    zero_velocity: Array = leaf(0.01, unit="m/s", low=1e-5, high=10.0, source=_OPENSHOE)
    zero_angular_rate: Array = leaf(0.05, unit="rad/s", low=1e-5, high=10.0, source=_KIT)
    zaru: bool = setting(False, source="not part of IEZ")
    attitude_update: str = setting("exponential", choices=strapdown.ATTITUDE_UPDATES, source=_KIT)
    force_attitude: str = setting(
        "mean", choices=strapdown.FORCE_ATTITUDES, source="mean: Fischer; new: PyShoe"
    )


@parameters
class IezParameters:
    """All parameters of IEZ."""

    gravity: Array = leaf(9.8029, unit="m/s^2", low=9.7, high=9.9, scale="linear", source="PyShoe")
    stance: stance.StanceParameters = group(stance.StanceParameters)
    gate: Gate = group(Gate)
    updates: Updates = group(Updates)
    process: Process = group(Process)
    initial: Initial = group(Initial)


class Sample(NamedTuple):
    """One sample: `dt` s, `force (3,)` m/s^2, `rate (3,)` rad/s, and the stance evidence `(windows, m)`."""

    dt: Array
    force: Array
    rate: Array
    evidence: Array


class State(NamedTuple):
    """Estimate, covariance, recent level of the log statistic, last weight, and whether all was finite."""

    navigation: Navigation
    P: Covariance
    level: Array
    still: Array
    healthy: Array


def prepare(p: IezParameters, signals: Signals, rate_hz: float, length: ArrayLike | None = None) -> Inputs:
    """Stance evidence of every sample, and the mean force of the first samples for levelling."""
    force, rate = signals.force, signals.rate
    found = stance.evidence(p.stance, force, rate, rate_hz, length)
    first = max(round(p.initial.levelling_s * rate_hz), 1)
    return Inputs(Sample(signals.dt, force, rate, found), jnp.mean(force[:first], axis=0))


def start(p: IezParameters, opening: Array) -> State:
    """Levelled by the first samples, heading given, at rest at the origin."""
    shape = lane_shape(p, opening[0])
    like = jnp.zeros(shape, opening.dtype)
    ones = jnp.ones((3, *shape), opening.dtype)
    force = align(opening, 1, len(shape)) * ones
    nav = strapdown.still_at_origin(rotations.levelled(force, p.initial.heading + like))
    tilt_and_heading = jnp.stack(
        [x + like for x in (p.initial.attitude, p.initial.attitude, p.initial.heading_sigma)]
    )
    deviations = {
        "t": tilt_and_heading,
        "g": p.initial.gyroscope_bias * ones,
        "p": p.initial.position * ones,
        "v": p.initial.velocity * ones,
        "a": p.initial.accelerometer_bias * ones,
    }
    return State(nav, covariance.diagonal(deviations), like, like, jnp.ones(shape, bool))


def step(p: IezParameters, state: State, sample: Sample) -> tuple[State, Output]:
    """Mechanise, predict, and update with zero velocity as far as the gate opens."""
    nav, lanes = state.navigation, state.level.ndim
    dt, force, rate = align(sample.dt, 0, lanes), align(sample.force, 1, lanes), align(sample.rate, 1, lanes)
    evidence = align(sample.evidence, 2, lanes)

    corrected_force, corrected_rate = force - nav.accelerometer_bias, rate - nav.gyroscope_bias
    nav, middle, force_n = strapdown.mechanise(
        nav,
        corrected_force,
        corrected_rate,
        dt,
        p.gravity,
        p.updates.attitude_update,
        p.updates.force_attitude,
    )
    noise = ProcessNoise(
        p.process.gyroscope,
        p.process.accelerometer,
        p.process.gyroscope_bias,
        p.process.accelerometer_bias,
        p.process.gyroscope_bias_time,
        p.process.accelerometer_bias_time,
    )
    P = covariance.predict(state.P, middle, force_n, dt, noise)
    nav = nav._replace(  # a bias that decays in the model decays in the estimate
        gyroscope_bias=jnp.exp(-dt / noise.gyroscope_bias_time) * nav.gyroscope_bias,
        accelerometer_bias=jnp.exp(-dt / noise.accelerometer_bias_time) * nav.accelerometer_bias,
    )

    published = stance.log_ratio(p.stance, evidence, p.gravity)
    log_ratio = published - state.still * jnp.log(p.gate.hysteresis)
    level, sigma = state.level, p.updates.zero_velocity
    if p.gate.kind == "adaptive":
        bounded = jnp.clip(published, -_FAR, _FAR)
        level = level + dt / (dt + p.gate.follow_time) * (bounded - level)
        log_ratio = log_ratio - p.gate.follow * level
        sigma = sigma * jnp.exp(p.gate.growth * jnp.logaddexp(bounded - p.gate.floor, 0.0))
    weight = gate(log_ratio, p.gate.width, p.gate.straight_through)
    P, correction = covariance.update(P, measurements.zero_velocity(nav, sigma), weight)
    nav = measurements.correct(nav, correction)
    if p.updates.zaru:
        rows = measurements.zero_angular_rate(nav, rate, p.updates.zero_angular_rate)
        P, correction = covariance.update(P, rows, weight)
        nav = measurements.correct(nav, correction)

    healthy = state.healthy & jnp.isfinite(jnp.sum(nav.velocity, 0)) & covariance.is_positive(P)
    state = State(nav, P, level, weight, healthy)
    return state, Output(nav, weight, log_ratio, covariance.variances(P), healthy)


def defaults() -> IezParameters:
    """The published parameters."""
    return IezParameters()


ADAPTIVE = ("gate.follow", "gate.follow_time", "gate.growth", "gate.floor")
"""The coefficients of the adaptive gate: without it they have no effect."""


def tunable(p: IezParameters) -> tuple[str, ...]:
    """Thresholds of the detector that is on, the noises that matter most, and the adaptive gate's numbers."""
    thresholds = {"eps": ("stance.eps.energy", "stance.eps.rate_energy")}
    return (
        *thresholds.get(p.stance.detector, (f"stance.{p.stance.detector}.threshold",)),
        "updates.zero_velocity",
        "process.accelerometer",
        "process.gyroscope",
        "initial.accelerometer_bias",
        "initial.gyroscope_bias",
        "initial.attitude",
        *(ADAPTIVE if p.gate.kind == "adaptive" else ()),
    )


IEZ = System("iez", "INS-EKF-ZUPT", defaults, tunable, prepare, start, step)
