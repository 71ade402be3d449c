"""Recordings ready for a filter: roles, sensors on one clock, points with positions and headings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pedjax.errors import InputError
from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth
from pedjax.system import Need
from pedjax.systems import SYSTEMS
from pedjax.walks import attitudes_of, check_walk, distinct, sensor_names, walk
from tests import tools

FOOT, WAIST = Need("foot"), Need("waist", True)
NEEDS = (FOOT, WAIST)
ROLES = "the system's roles are foot, waist"


@pytest.mark.parametrize(
    ("sensors", "names"),
    [
        (None, ("foot", "waist")),
        ({}, ("foot", "waist")),
        ("left", ("left", "waist")),
        ({"waist": "belt"}, ("foot", "belt")),
        ({"waist": "belt", "foot": "left"}, ("left", "belt")),
    ],
)
def test_who_plays_which_role(sensors, names):
    found = sensor_names(NEEDS, sensors)
    assert list(found.items()) == [("foot", names[0]), ("waist", names[1])]


def test_a_role_that_there_is_not_is_refused():
    with pytest.raises(InputError, match=f"--sensor pocket=belt: {ROLES}"):
        sensor_names(NEEDS, {"foot": "left", "pocket": "belt"})


UP = np.array([0.0, 0.0, 9.8])


def line(time, seed):
    """Readings that change evenly with time."""
    a, b = np.random.default_rng(seed).normal(size=(2, 3))
    return a + b * time[:, None]


def sensor(time, seed, magnetic=False):
    readings = [Stream(time, line(time, seed + i)) for i in range(2 + magnetic)]
    readings[0] = Stream(time, readings[0].values + UP)
    return Sensor(*readings)


FIRST = 2.0 + np.arange(500) / 100.0
OTHER = 1.63 + np.cumsum(np.random.default_rng(0).uniform(0.01, 0.025, 400))
"""At another rate, not evenly, and longer at both ends."""


def two(other=OTHER, magnetic=True):
    return Recording("two", {"foot": sensor(FIRST, 10), "belt": sensor(other, 20, magnetic)})


def test_a_further_sensor_is_brought_onto_the_first_ones_clock():
    assert OTHER[-1] > FIRST[-1]
    found = walk(two(), {"waist": "belt"}, needs=NEEDS)
    assert list(found.sensors) == ["foot", "waist"]
    assert found.imu is found.sensors["foot"]
    assert (len(found), found.rate_hz) == (500, 100.0)
    waist = found.sensors["waist"]
    np.testing.assert_array_equal(waist.time, FIRST)
    np.testing.assert_array_equal(waist.dt, found.imu.dt)
    np.testing.assert_allclose(waist.specific_force, line(FIRST, 20) + UP, atol=1e-12)
    np.testing.assert_allclose(waist.angular_rate, line(FIRST, 21), atol=1e-12)
    np.testing.assert_allclose(waist.magnetic_field, line(FIRST, 22), atol=1e-12)
    np.testing.assert_array_equal(found.imu.specific_force, line(FIRST, 10) + UP)
    assert found.imu.magnetic_field is None
    # whoever plays the first role gives the clock
    turned = walk(two(), {"foot": "belt", "waist": "belt"}, needs=NEEDS)
    np.testing.assert_array_equal(turned.imu.time, OTHER)


def test_a_sensor_without_a_magnetometer_stays_without():
    assert walk(two(magnetic=False), {"waist": "belt"}, needs=NEEDS).sensors["waist"].magnetic_field is None


@pytest.mark.parametrize("side", ["begins late", "ends early"])
@pytest.mark.parametrize("short", [0.4, 0.6])
def test_a_further_sensor_must_cover_the_first(side, short):
    """Up to half a second its last reading stands for what is missing."""
    begin, end = FIRST[0] + short, FIRST[-1] - short
    keep = begin < OTHER if side == "begins late" else end > OTHER
    recording = two(OTHER[keep])
    if short > 0.5:
        with pytest.raises(
            InputError, match=r"two: sensor 'belt' lasts from .* s, the first sensor from 2.00 to"
        ):
            walk(recording, {"waist": "belt"}, needs=NEEDS)
        return
    waist = walk(recording, {"waist": "belt"}, needs=NEEDS).sensors["waist"]
    at, edge = (0, 0) if side == "begins late" else (-1, -1)
    np.testing.assert_array_equal(waist.angular_rate[at], recording.sensors["belt"].gyroscope.values[edge])


def test_a_sensor_that_there_is_not_is_refused():
    with pytest.raises(InputError, match="no sensor 'waist'"):
        walk(two(), needs=NEEDS)


def test_names_are_told_apart():
    assert distinct(["a", "b", "a", "a"]) == ["a", "b", "a__2", "a__3"]
    assert distinct([]) == []


def turned(count, seed=4):
    return Rotation.random(count, np.random.default_rng(seed))


def oriented(position=None, lost=()):
    """A recording whose truth, at 50 Hz, knows the orientation of its sensor."""
    time = FIRST[::2]
    truth = turned(len(time))
    quaternion = truth.as_quat()[:, [3, 0, 1, 2]]
    quaternion[list(lost)] = np.nan
    place = np.zeros((len(time), 3)) if position is None else position
    made = Recording("turned", {"foot": sensor(FIRST, 10)}, truth=Truth(time, place, quaternion))
    return made, truth.as_matrix()


def test_headings_are_scored_where_the_orientation_is_known():
    position = np.random.default_rng(1).normal(size=(250, 3))
    position[7] = np.nan
    recording, truth = oriented(position, lost=(3, 40))
    known = np.setdiff1d(np.arange(250), (3, 40))
    found = walk(recording, truth_hz=None, headings=True)
    np.testing.assert_array_equal(found.index, 2 * known)
    np.testing.assert_array_equal(found.position, position[known])  # unknown places stay so
    np.testing.assert_allclose(found.attitude, truth[known], atol=1e-12)
    assert walk(recording, truth_hz=None).attitude is None
    thinned = walk(recording, headings=True)
    assert len(thinned.index) == pytest.approx(50, abs=1)  # five seconds at 10 Hz
    np.testing.assert_allclose(thinned.attitude, truth[thinned.index // 2], atol=1e-12)


def test_headings_need_a_truth_with_orientation():
    recording, _ = oriented()
    lost, _ = oriented(lost=range(250))
    plain = replace(recording, truth=replace(recording.truth, quaternion=None))
    for each in (lost, plain, replace(recording, truth=None)):
        index, position, attitude = attitudes_of(each, FIRST, None)
        assert (len(index), position.shape, attitude.shape) == (0, (0, 3), (0, 3, 3))
    # landmarks know no heading: the dense truth is taken even where there are some
    marked = replace(recording, landmarks=Landmarks(FIRST[[100, 400]], np.zeros((2, 3))))
    assert len(walk(marked).index) == 2
    assert len(walk(marked, headings=True).index) > 40


def test_what_a_system_cannot_do_without_is_asked_for(demos):
    ma, iez = SYSTEMS["ma2018"], SYSTEMS["iez"]
    bare = walk(Recording("bare", {"foot": sensor(FIRST, 10)}), needs=ma.needs)
    with pytest.raises(
        InputError, match="bare: the system 'ma2018' needs a magnetometer and this sensor has none"
    ):
        check_walk(ma, ma.defaults(), bare)
    check_walk(iez, iez.defaults(), bare)
    made = walk(Recording("gap", {"foot": sensor(FIRST, 10, magnetic=True)}), needs=ma.needs)
    check_walk(ma, ma.defaults(), made)
    field = made.imu.magnetic_field.copy()
    field[100:200] = np.nan
    lost = replace(made, sensors={"foot": replace(made.imu, magnetic_field=field)})
    with pytest.raises(InputError, match=r"no readings for 1.0 s, the first time 1.0 s after the start"):
        check_walk(ma, ma.defaults(), lost)
    check_walk(iez, iez.defaults(), lost)
    with pytest.raises(InputError, match=r"5 s, and stance.shoe.window_s asks for at least 6 s"):
        check_walk(iez, tools.iez(stance__shoe__window_s=3.0), made)
    check_walk(iez, tools.iez(stance__shoe__window_s=2.5), made)
