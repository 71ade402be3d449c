"""Walks for the tests: noise, recordings, crops."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import filtering, parameters
from pedjax.preparing import prepare
from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth
from pedjax.systems import system
from pedjax.walks import walk
from tests.reference import filter as oracle

ORACLE_NAMES = {
    "position": "p",
    "velocity": "v",
    "attitude": "C",
    "gyroscope_bias": "b_g",
    "accelerometer_bias": "b_a",
}
"""The parts of an estimate, and what the dense filter calls them."""

ERROR_STATES = ("attitude", "gyroscope_bias", "position", "velocity", "accelerometer_bias")
"""The parts of an estimate in the order of the dense filter's error states."""

LEAVES = tuple(parameters.specs(system("iez").defaults()))

STRAIGHT = """
rate_hz = 100.0
standing_s = 2.0
landmarks = [[0.0, 0.0]]
field = { kind = "munich" }
legs = [{ points = [[0, 0], [90, 0]] }]
"""
"""A scenario: straight on in a homogeneous field."""

POCKET = """
rate_hz = 100.0
standing_s = 3.0
sensors = { pocket = "xsens_mtw" }
field = { kind = "none" }
legs = [
    { points = [[0, 0], [35, 0]], gait = "slow" },
    { points = [[35, 0], [60, 0], [60, 20]], radius = 2.0 },
    { kind = "stand", seconds = 6.0 },
    { points = [[60, 20], [60, 60]], gait = "fast" },
    { points = [[60, 60], [60, 100]], gait = "run" },
]
"""
"""A scenario: four gaits, a bend and a stop, for a sensor in a trouser pocket."""


def noisy(walk, seed, force=0.05, rate=0.005, force_bias=0.04, rate_bias=0.003):
    """The walk with white noise and constant biases on its sensors, in m/s^2 and rad/s."""
    rng = np.random.default_rng(seed)
    shape = walk.specific_force.shape
    return walk._replace(
        specific_force=walk.specific_force + rng.normal(0, force, shape) + rng.normal(0, force_bias, 3),
        angular_rate=walk.angular_rate + rng.normal(0, rate, shape) + rng.normal(0, rate_bias, 3),
    )


def recording_of(walk, name, every_s=5.0):
    """A recording of a reference walk with landmarks on the truth every few seconds and dense truth."""
    time = np.cumsum(walk.dt)
    marks = np.arange(len(time) - 1, 0, -round(every_s / walk.dt[0]))[::-1]
    return Recording(
        name,
        {"foot": Sensor(Stream(time, walk.specific_force), Stream(time, walk.angular_rate), up="+z")},
        landmarks=Landmarks(time[marks], walk.position[marks]),
        truth=Truth(time, walk.position),
    )


def crop(recording, seconds, name=None):
    """The first seconds of a recording."""
    stop = next(iter(recording.sensors.values())).gyroscope.time[0] + seconds

    def cut(stream):
        return Stream(stream.time[stream.time < stop], stream.values[stream.time < stop])

    sensors = {
        key: replace(s, accelerometer=cut(s.accelerometer), gyroscope=cut(s.gyroscope))
        for key, s in recording.sensors.items()
    }
    marks, truth = recording.landmarks, recording.truth
    inside, known = marks.time < stop, truth.time < stop
    return replace(
        recording,
        name=name or recording.name,
        sensors=sensors,
        landmarks=Landmarks(marks.time[inside], marks.position[inside]),
        truth=Truth(truth.time[known], truth.position[known]),
    )


def iez(**changes):
    """Parameters of IEZ with changes, `__` for the dot: `gate__width=0.25`."""
    return parameters.replace(system("iez").defaults(), {k.replace("__", "."): v for k, v in changes.items()})


def shoe_sigmas():
    """Thresholds fit for consumer noise: SHOE's sigmas as in the tests' walks."""
    return {
        "stance__shoe__sigma_accelerometer": 0.01,
        "stance__shoe__sigma_gyroscope": 0.005,
        "stance__shoe__threshold": 1500.0,
    }


def oracle_settings(params, force, heading):
    """The dense filter's settings from IEZ's parameters, levelled by the mean `force (3,)` of the opening."""
    return oracle.Settings(
        gravity=params.gravity,
        accelerometer=params.process.accelerometer,
        gyroscope=params.process.gyroscope,
        accelerometer_bias=params.process.accelerometer_bias,
        gyroscope_bias=params.process.gyroscope_bias,
        accelerometer_bias_time=params.process.accelerometer_bias_time,
        gyroscope_bias_time=params.process.gyroscope_bias_time,
        sigma_zupt=params.updates.zero_velocity,
        sigma_zaru=params.updates.zero_angular_rate,
        initial_attitude_std=params.initial.attitude,
        initial_heading_std=params.initial.heading_sigma,
        initial_gyroscope_bias_std=params.initial.gyroscope_bias,
        initial_position_std=params.initial.position,
        initial_velocity_std=params.initial.velocity,
        initial_accelerometer_bias_std=params.initial.accelerometer_bias,
        initial_C=oracle.levelled_attitude(force, heading),
        attitude_method=params.strapdown.attitude_update,
    )


def sigmas(told):
    """Standard deviations `(T, 15)` of a track or an output, in the order of the error states."""
    return np.concatenate([told.sigma[name] for name in ERROR_STATES], axis=-1)


def cropped(walk, start, stop):
    """A walk of a foot, cut to samples `start` to `stop`."""
    return replace(walk, sensors={"foot": walk.imu.crop(start, stop)})


@partial(jax.jit, static_argnames="system")
def scan(system, params, samples, state):
    """`filtering.scan` without a site."""
    return filtering.scan(system, params, None, samples, state)


def same_bits(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y)


def assert_chunks_equal_the_whole(system, params, inputs, cut):
    """A scan up to sample `cut`, and another from there on, give what one over all gives, to the bit."""
    state = system.start(params, None, inputs.opening)
    end, whole = scan(system, params, inputs.samples, state)
    parts = slice(cut), slice(cut, None)
    first, second = (jax.tree.map(lambda x, s=s: x[s], inputs.samples) for s in parts)
    middle, a = scan(system, params, first, state)
    last, b = scan(system, params, second, middle)
    same_bits(end, last)
    same_bits(whole, jax.tree.map(lambda x, y: jnp.concatenate([x, y]), a, b))


def assert_slopes_of_a_landmark_error_equal_differences(found, p, recording, slopes, rel=1e-5):
    """Through the whole filter, from the start on: RMS of horizontal errors at the landmarks by each of the
    parameters in `slopes`, path to value."""
    p = parameters.cast(parameters.replace(p, slopes), float)
    walked = walk(recording)
    inputs = prepare(found, p, walked, float, len(walked))
    at, there = jnp.asarray(walked.index), jnp.asarray(walked.position[:, :2])

    @jax.jit
    @jax.value_and_grad
    def error(values):
        q = parameters.with_leaves(p, values)
        state = found.start(q, None, inputs.opening)
        _, place = filtering.scan(found, q, None, inputs.samples, state, lambda o: o.estimate.position)
        return jnp.sqrt(jnp.mean(jnp.sum((place[at, :2] - there) ** 2, axis=1)))

    values = {name: jnp.asarray(x) for name, x in slopes.items()}
    loss, gradient = error(values)
    assert 0.01 < loss < 20
    for name, x in values.items():
        h = 1e-5 * x
        up, down = (float(error({**values, name: x + s})[0]) for s in (h, -h))
        assert gradient[name] == pytest.approx((up - down) / (2 * float(h)), rel=rel, abs=1e-9), name
        assert gradient[name] != 0.0, name
