"""The emulated walks of Munoz Diaz 2017: exact motion, fields and noises."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.munoz_diaz import emulated as walks
from experiments.munoz_diaz.emulated import BIAS, FIELD_NOISE, GYRO_NOISE, RATE, emulated
from pedjax.errors import InputError

SHORT = {"length": 30.0, "rounds": 1}
STREET = {"length": 100.0, "rounds": 3}  # tiles do not overlap


def seen(made):
    return np.einsum("tji,tj->ti", made.exact.attitude, made.field)


def streams(made):
    sensor = made.recording.sensors["pocket"]
    return sensor.accelerometer.values, sensor.gyroscope.values, sensor.magnetometer.values


@pytest.fixture(scope="module")
def short():
    return emulated(1, "munich", **SHORT)


@pytest.fixture(scope="module")
def street():
    return {back: emulated(1, "street", back=back, **STREET) for back in ("same", "other")}


def test_rates_carry_each_attitude_to_the_next(short):
    exact = short.exact
    step = Rotation.from_rotvec(exact.rate[1:] / RATE).as_matrix()
    assert np.abs(exact.attitude[:-1] @ step - exact.attitude[1:]).max() < 1e-12


def test_the_force_is_how_the_path_bends(short):
    exact = short.exact
    force = np.einsum("tij,tj->ti", exact.attitude, exact.force) - [0.0, 0.0, 9.8029]
    bent = np.diff(exact.position, 2, axis=0) * RATE**2
    off = np.abs(bent - force[1:-1]).max(axis=1)
    assert np.quantile(off, 0.995) < 0.1  # the hip stops short where a stride is longer than a leg


def test_recording_is_the_truth_with_bias_and_noise_of_table_2(short):
    force, rate, field = streams(short)
    wrong = rate - short.exact.rate
    assert wrong.mean(axis=0) == pytest.approx(BIAS, abs=4 * GYRO_NOISE / np.sqrt(len(wrong)))
    assert wrong.std(axis=0) == pytest.approx(GYRO_NOISE * np.ones(3), rel=0.05)
    assert (field - seen(short)).std(axis=0) == pytest.approx(FIELD_NOISE * np.ones(3), rel=0.05)
    assert np.abs((field - seen(short)).mean(axis=0)).max() < 4 * FIELD_NOISE / np.sqrt(len(field))
    assert np.abs(force - short.exact.force).max() < 0.25


def test_truth_is_that_of_the_pocket_at_20_hz(short):
    truth, exact = short.recording.truth, short.exact
    assert truth.sensor == "pocket"
    assert np.diff(truth.time) == pytest.approx(0.05)
    there = Rotation.from_quat(truth.quaternion, scalar_first=True).as_matrix()
    assert np.abs(there - exact.attitude[:: walks.TRUTH_EVERY]).max() < 1e-12
    assert truth.position[-1] == pytest.approx(exact.position[:: walks.TRUTH_EVERY][-1] - exact.position[0])


def test_seeds_differ_in_noise_only_and_fields_share_it(short):
    other = emulated(2, "munich", **SHORT)
    assert other.exact is short.exact  # made once
    assert np.array_equal(other.field, short.field)
    assert np.array_equal(other.bias, short.bias)
    assert not np.allclose(streams(other)[1], streams(short)[1])
    pole = emulated(1, "north_pole", **SHORT)
    for ours, theirs in zip(streams(short)[:2], streams(pole)[:2], strict=True):
        assert np.array_equal(ours, theirs)
    assert streams(pole)[2] - seen(pole) == pytest.approx(streams(short)[2] - seen(short))
    again = emulated(1, "munich", **SHORT)
    for ours, theirs in zip(streams(short), streams(again), strict=True):
        assert np.array_equal(ours, theirs)


def test_a_walk_north_is_the_walk_east_turned(short):
    north = emulated(1, "munich", "north", **SHORT)
    assert np.ptp(north.exact.position[:, 1]) == pytest.approx(np.ptp(short.exact.position[:, 0]))
    assert np.array_equal(north.exact.rate, short.exact.rate)
    before, after = (np.radians(90) + yaw(short)), yaw(north)
    assert np.abs(np.angle(np.exp(1j * (after - before)))).max() < 1e-9


def yaw(made):
    return np.arctan2(made.exact.attitude[:, 1, 0], made.exact.attitude[:, 0, 0])


def strongest(made, low, high, leg):
    """Largest change of strength between two places along the street on a leg, µT."""
    x = made.exact.position[:, 0]
    ends = leg_ends(made)
    some = np.zeros(len(x), bool)
    some[ends[leg] : ends[leg + 1]] = True
    off = np.linalg.norm(made.field, axis=1) - 25.0
    return np.abs(off[some & (x > low) & (x < high)]).max()


def leg_ends(made):
    """Samples at which the legs begin, by turns at either end of the street."""
    x = made.exact.position[:, 0]
    half = np.flatnonzero(np.diff(np.sign(x - 50.0)) != 0)
    assert len(half) == 6
    return [0, *((a + b) // 2 for a, b in pairwise(half)), len(x) - 1]


def test_the_way_back_on_the_same_line_meets_the_same_car(street):
    car = [strongest(street["same"], 40, 53, leg) for leg in range(6)]
    assert min(car) > 2.4  # 3 m beside it; the pocket is 0.15 m to the right of the line
    assert max(car) < 3.2
    assert car[0] == pytest.approx(car[2], abs=0.1)
    assert car[1] == pytest.approx(car[3], abs=0.1)


def test_on_other_lines_a_tile_is_strong_on_its_own_leg_only(street):
    made = street["other"]
    for leg, share, what in walks.MET:
        middle = 14.0 + 16.0 * round((100.0 * share - 14.0) / 16.0)
        found = [strongest(made, middle - 6, middle + 6, k) for k in range(6)]
        assert found[leg] > 2
        if what == "lights":
            assert sorted(found)[-2] < 1.5
        else:
            assert sorted(found)[-2] < 1.1


@pytest.mark.parametrize("back", ["same", "other"])
def test_the_nearest_post_is_nearest_and_the_field_jumps_only_where_it_changes(street, back):
    made = street[back]
    posts = walks.street(back, **STREET).cylinders
    place, radius = np.asarray(posts.place), np.asarray(posts.radius)
    away = np.linalg.norm(made.exact.position[:, None, :2] - place, axis=2) - radius
    mine = np.take_along_axis(away, made.nearest[:, None], axis=1)[:, 0]
    assert np.abs(mine - away.min(axis=1)).max() < 1e-9
    assert (away > 0).all()
    assert made.crossing.sum() == (np.diff(made.nearest) != 0).sum() > 10
    moved = np.linalg.norm(np.diff(made.field, axis=0), axis=1)
    step = np.linalg.norm(np.diff(made.exact.position[:, :2], axis=0), axis=1)
    slope = 2 * 25.0 * radius[made.nearest] ** 2 / np.linalg.norm(
        made.exact.position[:, :2] - place[made.nearest], axis=1
    ) ** 3  # fmt: skip
    smooth = ~made.crossing[1:]
    assert (moved[smooth] <= 1.1 * (slope[1:] * step)[smooth] + 1e-9).all()
    assert moved[~smooth].max() > 0.3


def test_homogeneous_fields_have_no_nearest_post(short):
    assert (short.nearest == -1).all()
    assert not short.crossing.any()


def test_the_thigh_swings_as_a_thigh():
    s = walks.swing(walks.walk("east", "same", 100.0, 3))
    assert s.amplitude == pytest.approx(22, abs=3)
    assert s.frequency == pytest.approx(0.95, abs=0.1)


def test_bias_and_iron_of_the_second_walk():
    made = {iron: walks.mtw(3, iron, length=60.0, rounds=1) for iron in ("none", "calibrated", "raw")}
    plain = made["none"]
    wander = np.degrees(plain.bias - walks.MTW_BIAS)
    assert 0 < np.abs(wander).max() < 0.03
    assert np.abs(np.diff(wander, axis=0)).max() < 1e-3
    clean, noisy = seen(plain), {iron: streams(m)[2] for iron, m in made.items()}
    noise = noisy["none"] - clean
    hard, soft = walks.IRON["raw"]
    assert np.abs(noisy["raw"] - noise - clean @ soft.T - hard).max() < 1e-9
    rest = np.linalg.norm(noisy["calibrated"] - noise, axis=1) - 48.0
    assert 0.1 < np.abs(rest).max() < 1.5
    assert np.ptp(np.linalg.norm(noisy["raw"], axis=1)) > 10


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"field": "munch"}, "unknown"),
        ({"field": "street", "along": "north"}, "street runs east"),
        ({"back": "other", "rounds": 4}, "fewer rounds"),
    ],
)
def test_what_cannot_be_walked_is_refused(given, why):
    with pytest.raises(InputError, match=why):
        emulated(0, **given)
