"""One recording through one system: the track, its warnings, and what is refused."""

import os
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

import pedjax
from pedjax import InputError, parameters, rotations
from pedjax.recording import Recording, Sensor, Stream, inertial
from pedjax.system import Status
from tests import tools
from tests.reference.evaluation import distance_walked


@pytest.fixture(scope="module")
def track(demos):
    return pedjax.run(demos[0])


def test_shapes_and_starting_point(track, demos):
    count = len(inertial(demos[0]).time)
    shapes = {
        "time": (count,), "position": (count, 3), "velocity": (count, 3), "attitude": (count, 3, 3),
        "euler": (count, 3), "gyroscope_bias": (count, 3), "accelerometer_bias": (count, 3),
        "weight": (count,), "log_ratio": (count,), "status": (count,),
    }  # fmt: skip
    gate = {name: getattr(track.gates["stance"], name) for name in ("weight", "log_ratio")}
    own = {name: getattr(track, name) for name in ("time", "euler", "status")}
    told = {**own, **track.estimate, **gate, **{f"sigma of {k}": x for k, x in track.sigma.items()}}
    shapes |= {f"sigma of {name}": (count, 3) for name in tools.ERROR_STATES}
    assert told.keys() == shapes.keys()
    assert track.position is told["position"]
    assert track.attitude is told["attitude"]
    for name, shape in shapes.items():
        value = told[name]
        assert isinstance(value, np.ndarray), name
        assert value.shape == shape, name
        assert np.isfinite(value).all(), name
    assert np.abs(track.position[0]).max() < 1e-3
    assert (track.name, track.system, track.healthy, track.warnings) == (demos[0].name, "iez", True, ())


def test_euler_angles_are_those_of_the_attitude(track):
    c = np.moveaxis(track.attitude, 0, -1)
    np.testing.assert_allclose(np.asarray(jax.jit(rotations.to_euler)(c)).T, track.euler, atol=1e-12)
    np.testing.assert_allclose(
        track.attitude @ np.swapaxes(track.attitude, 1, 2),
        np.broadcast_to(np.eye(3), track.attitude.shape),
        atol=1e-10,
    )


def test_distance_does_not_count_the_jitter_of_samples(track):
    tenths = [*track.position[::20], track.position[-1]]
    assert track.distance == pytest.approx(distance_walked(tenths), rel=1e-12)
    jitter = np.random.default_rng(0).normal(0, 2e-3, track.position.shape)
    shaken = replace(track, estimate={**track.estimate, "position": track.position + jitter})
    every = np.linalg.norm(np.diff(shaken.position[:, :2], axis=0), axis=1).sum()
    assert shaken.distance < 1.02 * track.distance < 1.3 * track.distance < every
    still = replace(track, estimate={**track.estimate, "position": np.zeros_like(track.position)})
    assert still.distance == 0.0


def test_precision_follows_jax(demos):
    with jax.enable_x64(False):
        assert pedjax.run(demos[2]).position.dtype == np.float32
    assert pedjax.run(demos[2]).position.dtype == np.float64


def test_a_foot_never_still_is_not_healthy(demos):
    track = pedjax.run(demos[2], params=tools.iez(stance__shoe__threshold=1e3))
    assert not track.healthy
    assert "no stance at all" in track.warnings[0]


def test_a_foot_always_still_is_remarked(demos):
    track = pedjax.run(demos[2], params=tools.iez(stance__shoe__threshold=1e12))
    assert any("still almost all the time" in note for note in track.warnings)


def test_a_long_time_without_stance_is_remarked(demos):
    sensor = demos[1].sensor()
    shaken = sensor.gyroscope.values.copy()
    during = (sensor.gyroscope.time > 6.0) & (sensor.gyroscope.time < 12.0)
    shaken[during] += np.random.default_rng(0).normal(0, 4, (during.sum(), 3))
    recording = replace(
        demos[1], sensors={"foot": replace(sensor, gyroscope=Stream(sensor.gyroscope.time, shaken))}
    )
    (note,) = pedjax.run(recording).warnings
    assert "s without stance from" in note


def test_leaving_the_numbers_is_noticed(demos):
    sensor = demos[2].sensor()
    force = sensor.accelerometer.values.copy()
    at = len(force) // 2
    force[at] = 1e300
    recording = replace(
        demos[2], sensors={"foot": replace(sensor, accelerometer=Stream(sensor.accelerometer.time, force))}
    )
    track = pedjax.run(recording)
    assert not track.healthy
    assert track.warnings[0].startswith("the filter left the numbers")
    assert track.warnings[0].endswith(f"at {sensor.accelerometer.time[at]:.2f} s")
    assert (track.status[:at] == Status.HEALTHY).all()
    assert (track.status[at:] == Status.DIVERGED).all()
    assert np.isfinite(track.position[:at]).all()


def test_too_short_for_the_window(demos):
    with pytest.raises(
        InputError, match=r"1800 samples at 200 Hz are 9 s, and stance\.shoe\.window_s asks for at least 10 s"
    ):
        pedjax.run(demos[2], params=tools.iez(stance__shoe__window_s=5.0))


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"system": "izs"}, "system 'izs' is unknown; did you mean 'iez'"),
        ({"sensor": "hip"}, "no sensor 'hip'"),
        ({"clock": "sundial"}, "clock 'sundial' is unknown"),
    ],
)
def test_unknown_names_are_refused(demos, how, message):
    with pytest.raises(InputError, match=message):
        pedjax.run(demos[2], **how)


def test_heading_turns_the_track_and_nothing_else(demos, track):
    turned = pedjax.run(demos[0], params=tools.iez(initial__heading=1.0))
    expected = np.array([[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]])
    np.testing.assert_allclose(turned.position, track.position @ expected.T, atol=1e-9)


def test_time_offset_changes_nothing(demos, track):
    def later(stream):
        return Stream(stream.time + 64.0, stream.values)

    s = demos[0].sensor()
    moved = Recording("later", {"foot": Sensor(later(s.accelerometer), later(s.gyroscope), up=s.up)})
    np.testing.assert_allclose(pedjax.run(moved).position, track.position, atol=1e-9)


def test_a_mounting_turned_upside_down_walks_the_same(demos, track):
    """The foot's axes are free: a sensor turned about its own axis gives the same path."""
    s = demos[0].sensor()
    flip = np.diag([1.0, -1.0, -1.0])
    turned = Recording(
        "flipped",
        {"foot": Sensor(*(Stream(x.time, x.values @ flip) for x in (s.accelerometer, s.gyroscope)))},
    )
    np.testing.assert_allclose(pedjax.run(turned).position, track.position, atol=1e-8)


def test_out_of_range_parameters_cannot_be_made():
    with pytest.raises(InputError, match="outside its bounds"):
        tools.iez(updates__zero_velocity=100.0)


def test_defaults_are_the_published_ones(demos, track):
    again = pedjax.run(demos[0], params=parameters.replace(tools.iez(), {"stance.shoe.threshold": 8.5e7}))
    np.testing.assert_array_equal(again.position, track.position)


@pytest.mark.slow
def test_real_walks_stay_near_their_landmarks():
    folder = os.environ.get("PEDJAX_DATA")
    if not folder:
        pytest.skip("PEDJAX_DATA does not name the folder of real recordings")
    files = sorted(Path(folder).glob("footmounted_gx5/vicon/*.mat.gz"))[:6]
    if not files:
        pytest.skip("no footmounted_gx5/vicon in PEDJAX_DATA")
    for file in files:
        recording = pedjax.read(str(file))
        track = pedjax.run(recording)
        score = pedjax.evaluate(track, recording)
        print(f"{recording.name}: {score.rms_2d_m:.3f} m RMS over {track.distance:.0f} m")
        assert track.healthy
        assert score.rms_2d_m < 0.05 * track.distance
