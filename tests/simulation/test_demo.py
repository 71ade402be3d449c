"""The demo walk: reproducible, consistent with its own truth, and walkable."""

import numpy as np
import pytest

import pedjax
from pedjax.recording import inertial
from tests.reference import filter as oracle


@pytest.fixture(scope="module")
def demo():
    return pedjax.demo_walk(2)


def test_same_seed_same_walk(demo):
    again, other = pedjax.demo_walk(2), pedjax.demo_walk(3)
    for a, b in ((demo.sensor().accelerometer, again.sensor().accelerometer), (demo.truth, again.truth)):
        np.testing.assert_array_equal(a.time, b.time)
    np.testing.assert_array_equal(demo.sensor().gyroscope.values, again.sensor().gyroscope.values)
    assert len(other.truth.time) != len(demo.truth.time)


def test_it_does_not_depend_on_the_precision_in_force(demo):
    import jax

    with jax.enable_x64(False):
        single = pedjax.demo_walk(2)
    np.testing.assert_array_equal(single.sensor().accelerometer.values, demo.sensor().accelerometer.values)


def test_landmarks_lie_on_the_truth(demo):
    at = np.searchsorted(demo.truth.time, demo.landmarks.time)
    np.testing.assert_array_equal(demo.truth.position[at], demo.landmarks.position)
    assert demo.findings == ()
    assert 40 < demo.duration < 120
    np.testing.assert_array_equal(demo.truth.position[0], 0.0)


def test_sensors_follow_the_truth(demo):
    """Integrated without a filter for a few strides, the sensors give the truth up to noise and bias."""
    imu = inertial(demo).crop(0, 900)
    at_rest = imu.specific_force[:300].mean(axis=0)
    bias = imu.angular_rate[:300].mean(axis=0)
    c, v, p = oracle.levelled_attitude(at_rest, 0.0), np.zeros(3), np.zeros(3)
    positions = []
    for dt, force, rate in zip(imu.dt, imu.specific_force, imu.angular_rate, strict=True):
        after = oracle.next_attitude(c, rate - bias, dt, "exponential")
        a = 0.5 * (c + after) @ force - [0, 0, np.linalg.norm(at_rest)]
        p, v, c = p + v * dt + 0.5 * a * dt**2, v + a * dt, after
        positions.append(p)
    truth = demo.truth.position[:900]
    assert np.linalg.norm(truth[-1]) > 1.5
    assert np.linalg.norm(positions[-1] - truth[-1]) < 0.1 * np.linalg.norm(truth[-1]) + 0.3


@pytest.mark.parametrize("seed", range(4))
def test_published_parameters_walk_it(seed):
    recording = pedjax.demo_walk(seed)
    track = pedjax.run(recording)
    score = pedjax.evaluate(track, recording)
    assert track.healthy
    assert score.rms_2d_m < 0.03 * track.distance
    true = recording.truth.position[:, :2]
    walked = np.linalg.norm(np.diff(true[::20], axis=0), axis=1).sum()
    assert track.distance == pytest.approx(walked, rel=0.1)


def test_rate_and_laps():
    slow, twice = pedjax.demo_walk(0, rate=100.0, laps=1), pedjax.demo_walk(0, laps=2)
    assert slow.sensor().gyroscope.rate == pytest.approx(100.0)
    assert twice.duration > 1.5 * slow.duration
