"""Biases and tracks of Munoz Diaz 2017: lanes, what is measured, and short runs."""

from types import SimpleNamespace

import numpy as np
import pytest

import pedjax
from experiments.munoz_diaz import biases, lanes, scenes, trajectory
from experiments.munoz_diaz.emulated import BIAS, emulated, mtw
from experiments.munoz_diaz.scenes import Ready, Scene
from pedjax.errors import InputError
from pedjax.systems import system

SHORT = {"length": 12.0, "rounds": 1}
SEEDS = (3, 4)


@pytest.mark.parametrize("how", ["published", "state, deviation"])
def test_a_lane_is_a_run(how):
    variant = biases.HOMOGENEOUS[how]
    chosen, tree = system(variant.system), variant.tree()
    recordings = [emulated(seed, "munich", **SHORT).recording for seed in SEEDS]
    told = lanes.run(chosen, tree, lanes.inputs(chosen, tree, recordings, least=4))
    for lane, recording in enumerate(recordings):
        alone = pedjax.run(recording, chosen, tree)
        some = slice(lanes.EVERY - 1, None, lanes.EVERY)
        assert np.array_equal(told.time, alone.time[some])
        for ours, theirs in (
            (told.bias, alone.estimate["gyroscope_bias"]),
            (told.sigma, alone.sigma["gyroscope_bias"]),
            (told.attitude, alone.attitude),
            (told.position, alone.position),
        ):
            assert np.abs(ours[..., lane] - theirs[some]).max() < 1e-9
        whole = len(told.time) * lanes.EVERY
        for name, gate in alone.gates.items():
            seconds = gate.weight[:whole].reshape(-1, lanes.EVERY).mean(axis=1)
            assert told.weight[name][:, lane] == pytest.approx(seconds)
    assert (told.status == 0).all()


def test_recordings_of_different_lengths_have_no_lanes():
    chosen, tree = system("munoz_diaz"), biases.PUBLISHED.tree()
    with pytest.raises(InputError, match="one length"):
        lanes.inputs(chosen, tree, [emulated(1, **SHORT).recording, mtw(1, **SHORT).recording])


def told_of(bias, sigma):
    """Every second, of one run; deg/s along z."""
    rest = np.zeros((len(bias), 3, 1))
    b, s = rest.copy(), rest.copy() + 1.0
    b[:, 2, 0], s[:, 2, 0] = np.radians(bias), np.radians(sigma)
    return SimpleNamespace(time=60.0 * np.arange(len(bias)), bias=b, sigma=s)


def test_what_is_measured_of_a_bias():
    told = told_of([0.0, -0.09, -0.05, -0.085, -0.1], [0.1, 0.05, 0.03, 0.015, 0.01])
    z = scenes.measured(told)
    assert z.sure == [3.0]
    assert z.reach == [1.0]
    assert z.settle == [3.0]
    assert z.end == pytest.approx(-0.1)
    assert z.nees == pytest.approx(np.mean([0.2**2, (0.05 / 0.03) ** 2, 1.0, 0.0]))
    assert np.isinf(scenes.measured(told_of([-0.1, 0.0], [1.0, 1.0])).settle).all()
    assert np.degrees(BIAS[2]) == pytest.approx(-0.1)


@pytest.mark.slow
def test_a_reading_where_posts_change_is_none():
    size = {"length": 100.0, "rounds": 2}
    ready = Ready(Scene("street", **size), SEEDS)
    weight = {s: ready.run(biases.TWIN, skips=s).weight["field"] for s in (False, True)}
    lost = emulated(SEEDS[0], "street", **size).crossing.sum()
    assert lost > 3
    assert lanes.EVERY * (weight[False] - weight[True]).sum(axis=0) == pytest.approx(lost, abs=1)


@pytest.fixture(scope="module")
def short_tracks():
    names = ("gravity only", "state, no iron", "state, raw, hard iron while walking")
    return trajectory.everything(range(3, 5), names, length=30.0, rounds=2)


@pytest.mark.slow
def test_tracks_go_the_way_that_was_walked(short_tracks):
    assert np.abs(short_tracks["state, no iron", "0.039"].yaw[-1]).max() < 5
    each = short_tracks["gravity only", "0.039"]
    k = trajectory.first_round(each.place, 2)
    assert np.linalg.norm(each.place[k, :2]) < 3
    assert np.linalg.norm(each.told.position[k, :2], axis=0).max() < 20


@pytest.mark.slow
def test_hard_iron_is_told_while_walking(short_tracks):
    iron = short_tracks["state, raw, hard iron while walking", "0.57"].told.more["hard_iron"]
    assert np.linalg.norm(iron[-1]) > 10
