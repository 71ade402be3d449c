"""Every real recording that is a walk reads; a few figures of each format are pinned."""

import numpy as np
import pytest

from pedjax.errors import InputError
from pedjax.readers import read, write_csv
from pedjax.recording import inertial

WALKS = [
    "footmounted_gx5/vicon/*.mat.gz",
    "footmounted_gx5/own/*.csv.gz",
    "footmounted_gx5/own_corner_gcp/*.csv.gz",
    "openshoe_loops/*.txt.gz",
    "xio_gait_tracking/*.csv.gz",
    "gaitmap_example/imu_sample*.csv.gz",
    "pocket_mocap/*.npz",
    "broad/*.mat",
    "ms_indoor_location_site1_F4/traces/*.txt.gz",
    "adis16405_static/*.npz",
]
NO_WALKS = [
    "footmounted_gx5/own/*.mat",
    "footmounted_gx5/stride_index/*.csv",
    "gaitmap_example/mocap_sample.csv.gz",
    "gaitmap_example/stride_*.csv",
    "ipad_1d_magslam/*.mat",
    "magcal_pointclouds/*/*.txt",
    "magcal_pointclouds/*/*.mat",
    "ms_indoor_location_site1_F4/*.png",
    "README.md",
]


@pytest.mark.parametrize("pattern", WALKS)
def test_every_walk_reads(data, pattern):
    files = sorted(data.glob(pattern))
    if not files:
        pytest.skip(f"no {pattern} in PEDJAX_DATA")
    for file in files:
        recording = read(file)
        assert recording.duration > 5.0
        if "gx5" in pattern or "openshoe" in pattern:
            assert recording.landmarks is not None or recording.truth is not None, file.name


@pytest.mark.parametrize("pattern", NO_WALKS)
def test_every_other_file_is_refused_in_one_sentence(data, pattern):
    for file in sorted(data.glob(pattern)):
        with pytest.raises(InputError) as error:
            read(file)
        assert file.name in str(error.value)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "marks", "first", "last"),
    [
        ("own/SensorConnectData_31", 34, 2.13499522, 42.73885727),
        ("own/SensorConnectData_42", 103, 1.505, 114.9956),
        ("own_corner_gcp/SensorConnectData_17", 5, 1.185, 32.9988),
    ],
)
def test_strides_have_the_times_of_their_list(data, name, marks, first, last):
    found = read(data / f"footmounted_gx5/{name}.csv.gz").landmarks
    assert len(found.time) == marks
    np.testing.assert_allclose(found.time[[0, -1]], [first, last], atol=2e-3)
    np.testing.assert_array_equal(found.position[0, :2], [0.0, 0.0])


def test_feet_rest_at_stride_landmarks(data):
    # the rule "row s is stride s": at the landmarks the foot turns far slower than on average
    recording = read(data / "footmounted_gx5/own/SensorConnectData_44.csv.gz")
    samples = inertial(recording)
    speed = np.linalg.norm(samples.angular_rate, axis=1)
    at = np.searchsorted(samples.time, recording.landmarks.time).clip(0, len(speed) - 1)
    assert np.median(speed[at]) < 0.4 * np.median(speed)


def test_late_stamps_of_experiment_40(data):
    recording = read(data / "footmounted_gx5/own/SensorConnectData_40.csv.gz")
    assert recording.clock == "uniform"
    np.testing.assert_allclose(inertial(recording).dt, 1 / 200, rtol=1e-3)


def test_openshoe_runs_on_the_sensor_clock(data):
    sensor = read(data / "openshoe_loops/Measurement_100521_2_data_inert.txt.gz").sensor()
    np.testing.assert_allclose(np.diff(sensor.gyroscope.time), 4.0039e-3, rtol=2e-3)
    assert 40 < np.median(np.linalg.norm(sensor.magnetometer.values, axis=1)) < 60


def test_xio_repeats_are_dropped(data):
    recording = read(data / "xio_gait_tracking/short_walk.csv.gz")
    assert (inertial(recording).dt > 2e-3).all()


def test_real_walk_written_and_read_back(data, tmp_path):
    recording = read(data / "pocket_mocap/subject_a_clean_front_pocket.npz")
    write_csv(recording, tmp_path / "p.csv")
    again = read(tmp_path / "p.csv")
    assert again.findings == recording.findings
    np.testing.assert_array_equal(again.truth.quaternion, recording.truth.quaternion)
    for kind in ("accelerometer", "gyroscope", "magnetometer"):
        mine, theirs = getattr(recording.sensor("pocket"), kind), getattr(again.sensor("pocket"), kind)
        np.testing.assert_array_equal(mine.time, theirs.time)
        np.testing.assert_array_equal(mine.values, theirs.values)
