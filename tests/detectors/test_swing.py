"""Swings of the thigh against loops, and on made walks with a sensor in the pocket."""

from itertools import pairwise

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pedjax.detectors import swing
from tests import tools
from tests.reference import swing as naive

HZ = 100.0
LIMIT = np.radians(8.0)
found_in = jax.jit(swing.cycles)


@pytest.fixture(scope="module")
def worn(pocket):
    """Force, rate and dt of the sensor in the pocket."""
    sensor = pocket.recording.sensors["pocket"]
    force, rate = sensor.accelerometer.values, sensor.gyroscope.values
    return force, rate, np.full(len(force), 1 / HZ)


@pytest.fixture(scope="module")
def found(worn):
    return found_in(*worn)


def strides(found, limit=LIMIT):
    """The samples that end a stride."""
    return np.flatnonzero(np.asarray(found.swing) > limit)


def test_equals_loops(worn, found):
    ends, angle, right = naive.cycles(*worn[:2], HZ)
    at = ends[:, 0].astype(int)
    assert len(at) > 100
    np.testing.assert_array_equal(np.flatnonzero(found.event), at)
    told = np.stack([found.swing, found.seconds, found.bounce], axis=1)
    np.testing.assert_allclose(told[at], ends[:, 1:], rtol=1e-6, atol=1e-7)
    assert not np.delete(told, at, axis=0).any()
    np.testing.assert_allclose(found.angle, angle, atol=1e-8)
    np.testing.assert_allclose(found.lateral, right, atol=1e-6)


def test_equals_loops_on_noise(rng):
    """Candidates without end, in any attitude."""
    force = rng.normal(0, 2, (3000, 3)) + np.array([3.0, 8.0, -5.0])
    rate = np.cumsum(rng.normal(0, 0.2, (3000, 3)), axis=0) * 0.1
    ends, angle, _ = naive.cycles(force, rate, HZ)
    found = found_in(force, rate, np.full(3000, 0.01))
    np.testing.assert_array_equal(np.flatnonzero(found.event), ends[:, 0])
    np.testing.assert_allclose(np.asarray(found.swing)[np.asarray(found.event) > 0], ends[:, 1], rtol=1e-5)
    np.testing.assert_allclose(found.angle, angle, atol=1e-6)


def test_strides_of_a_made_walk(pocket, found):
    """As many as swings of the right foot, one in each, and none in a stand."""
    swings = pocket.plan.walker.right
    lands, leaves = np.asarray(swings.lands), np.asarray(swings.leaves)
    true = lands < pocket.plan.seconds
    lands, leaves = lands[true], leaves[true]
    ends = strides(found) / HZ
    assert len(ends) == pytest.approx(len(lands), rel=0.02)
    in_each = np.bincount(np.searchsorted(leaves, ends), minlength=len(leaves) + 1)[1:]
    assert np.mean(in_each == 1) > 0.95
    pause = np.argmax(np.diff(lands))
    assert np.diff(lands)[pause] > 6.0
    assert not ((ends > lands[pause] + 2.5) & (ends < leaves[pause + 1])).any()
    seconds = np.asarray(found.seconds)[strides(found)]
    assert np.median(seconds) == pytest.approx(np.median(np.diff(lands)), rel=0.05)


def test_the_swing_is_that_of_the_thigh(pocket, found):
    """From one side to the other, as the true pitch goes; its sharpest turns are above the band."""
    up = pocket.truth["pocket"].motion.attitude[:, 2]
    pitch = np.arctan2(-up[:, 0], up[:, 2])
    ends = strides(found)
    true = [np.ptp(pitch[a:b]) for a, b in pairwise(ends)]
    told = np.asarray(found.swing)[ends[1:]]
    assert 0.9 < np.median(told / true) < 1.0


def test_the_lateral_axis_points_to_the_right(pocket, found):
    motion = pocket.truth["pocket"].motion
    right = np.einsum("tij,tj->ti", motion.attitude, found.lateral)
    speed = np.stack([np.convolve(x, np.full(110, 1 / 110), "same") for x in motion.velocity[:, :2].T])
    walks = (np.hypot(*speed) > 0.5) & (np.arange(len(right)) > 8 * HZ)
    ahead = np.arctan2(right[:, 0], -right[:, 1])
    away = np.angle(np.exp(1j * (ahead - np.arctan2(speed[1], speed[0]))))[walks]
    assert np.mean(np.abs(away) < np.radians(20)) > 0.97
    assert abs(np.median(away)) < np.radians(2)


TURNS = {
    "long_axis_up": Rotation.from_euler("x", 88, degrees=True),
    "upside_down": Rotation.from_euler("xyz", [180, 5, 30], degrees=True),
    "on_its_edge": Rotation.from_euler("yz", [-90, 45], degrees=True),
    "askew": Rotation.from_rotvec([1.0, -0.7, 2.0]),
}


@pytest.mark.parametrize("turn", TURNS)
def test_however_it_lies_in_the_pocket_the_strides_are_the_same(worn, found, turn):
    force, rate, dt = worn
    turned = found_in(TURNS[turn].apply(force), TURNS[turn].apply(rate), dt)
    np.testing.assert_array_equal(turned.event, found.event)
    np.testing.assert_allclose(turned.swing, found.swing, atol=1e-6)
    np.testing.assert_allclose(TURNS[turn].inv().apply(np.array(turned.lateral)), found.lateral, atol=1e-5)


@pytest.mark.parametrize("every", [2, 4])
def test_strides_do_not_depend_on_the_sampling_rate(worn, found, every):
    force, rate, dt = worn
    means = [np.mean(x[: len(x) // every * every].reshape(-1, every, 3), axis=1) for x in (force, rate)]
    fewer = found_in(*means, dt[::every][: len(means[0])] * every)
    assert abs(len(strides(fewer)) - len(strides(found))) <= 1


def test_in_single_precision_the_strides_are_the_same(worn, found):
    single = found_in(*(x.astype(np.float32) for x in worn))
    assert single.swing.dtype == np.float32
    assert len(strides(single)) == len(strides(found))
    assert np.abs(strides(single) - strides(found)).max() <= 1


@pytest.mark.parametrize("rate", [[0.0, 0.0, 0.0], [0.03, 0.03, -0.03]])
def test_a_standing_phone_makes_no_stride(rng, rate):
    """At rest, with a biased gyroscope and noise, and with one turn about up."""
    count = 6000
    up = Rotation.from_rotvec([0.3, 1.2, -0.5]).apply([0.0, 0.0, 9.8])
    turning = np.where((np.arange(count) > 2000) & (np.arange(count) < 2200), np.pi, 0.0)
    measured = rate + turning[:, None] * up / 9.8 + rng.normal(0, 0.01, (count, 3))
    found = found_in(up + rng.normal(0, 0.05, (count, 3)), measured, np.full(count, 1 / HZ))
    assert len(strides(found)) == 0


def test_later_samples_change_no_bit(worn, found):
    for stop in (1001, 2500, 4003):
        part = found_in(*(x[:stop] for x in worn))
        tools.same_bits(jax.tree.map(lambda x, n=stop: x[:n], found), part)


def test_padding_changes_no_bit(worn, found, rng):
    force, rate, dt = (x[:2500] for x in worn)
    garbage = rng.normal(0, 100, (700, 3))
    more = [np.concatenate([x, garbage]) for x in (force, rate)]
    for length, step in ((2500, 0.01), (None, 0.0)):
        padded = found_in(*more, np.concatenate([dt, np.full(700, step)]), length)
        tools.same_bits(*(jax.tree.map(lambda x: x[:2500], each) for each in (padded, found)))
        assert not np.asarray(padded.event)[2500:].any()
