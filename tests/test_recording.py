"""What a recording refuses, what it remarks on, and how its streams come onto one clock."""

from dataclasses import replace

import numpy as np
import pytest

import pedjax
from pedjax.errors import InputError
from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth, inertial

RATE = 100.0


@pytest.fixture
def signals():
    """Two seconds still, four seconds of strides: time, force, rate, field."""
    rng = np.random.default_rng(3)
    time = np.arange(600) / RATE
    stride = np.clip(np.sin(2 * np.pi * (time - 2.0)), 0, None)[:, None] * (time > 2.0)[:, None]
    force = np.array([0.3, -0.2, 9.79]) + 12 * stride * [1.0, 0.2, 0.8] + rng.normal(0, 0.02, (600, 3))
    rate = 5 * stride * [0.1, 1.0, 0.2] + rng.normal(0, 0.005, (600, 3))
    field = np.array([20.0, 5.0, -40.0]) + 5 * stride + rng.normal(0, 0.3, (600, 3))
    return time, force, rate, field


def make(signals, *, force=1.0, rate=1.0, field=None, up=None, time=None, **rest):
    t, f, w, m = signals
    t = t if time is None else time
    magnetometer = None if field is None else Stream(t, field * m)
    sensor = Sensor(Stream(t, force * f), Stream(t, rate * w), magnetometer, up)
    return Recording("walk", {"foot": sensor}, **rest)


def finding(recording, text):
    return [line for line in recording.findings if text in line]


def test_a_good_recording_has_nothing_to_say(signals):
    assert make(signals, field=1.0, up="+z").findings == ()
    assert make(signals, notes=("from the reader",)).findings == ("from the reader",)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force": 1 / 9.80665}, "looks like g: set the accelerometer's unit to g"),
        ({"rate": 180 / np.pi}, "looks like deg/s: set its unit to deg/s"),
        ({"field": 0.01}, "looks like gauss"),
        ({"field": 10.0}, "looks like milligauss"),
        ({"force": -1.0, "up": "+z"}, "gravity-signed or flipped: reverse its sign"),
        ({"up": "-z"}, "points down"),
        ({"force": 1e-3}, "where 9.81 is expected"),
        ({"force": 100.0}, "where 9.81 is expected"),
    ],
)
def test_wrong_units_and_signs_are_named(signals, change, message):
    if change.get("field") == 10.0:
        t, f, w, m = signals
        signals = t, f, w, m * np.sign(np.cos(0.5 * np.arange(600)))[:, None]
    with pytest.raises(InputError, match=message) as error:
        make(signals, **change)
    assert str(error.value).startswith("walk: sensor 'foot': ")
    assert "\n" not in str(error.value)


def test_flipped_accelerometer_passes_where_up_is_not_known(signals):
    assert make(signals, force=-1.0).findings == ()


def test_samples_that_are_not_numbers(signals):
    for which, kind in ((1, "accelerometer"), (2, "gyroscope")):
        broken = [x.copy() for x in signals]
        broken[which][37, 1] = np.nan
        broken[which][90, 0] = np.inf
        with pytest.raises(
            InputError, match=rf"{kind} has 2 samples that are not numbers, the first at sample 37 \(0.370"
        ):
            make(broken)
    time = signals[0].copy()
    time[5] = np.nan
    with pytest.raises(InputError, match="time stamp 5 is not a number"):
        make(signals, time=time)


def test_time_backwards_or_standing(signals):
    time = signals[0].copy()
    time[100] -= 0.05
    with pytest.raises(InputError, match="time goes backwards at sample 100"):
        make(signals, time=time)
    with pytest.raises(InputError, match="all time stamps of the accelerometer are equal"):
        make(signals, time=np.ones(600))


def test_duplicate_stamps_are_found_and_dropped(signals):
    time = signals[0].copy()
    time[50] = time[49]
    recording = make(signals, time=time)
    assert finding(recording, "1 duplicate time stamps of the accelerometer")
    imu = inertial(recording)
    assert len(imu.time) == 599
    assert (np.diff(imu.time) > 0).all()
    assert (imu.dt > 0).all()


def test_jitter_and_gaps_are_found(signals, rng):
    time = signals[0] + rng.uniform(0, 0.009, 600)
    lines = finding(make(signals, time=time), "jitter by")
    assert len(lines) == 2
    assert "'uniform' or 'resample'" in lines[0]
    assert "arrival times" not in finding(make(signals, time=time, clock="uniform"), "jitter")[0]
    gap = np.where(signals[0] > 3.0, signals[0] + 0.5, signals[0])
    assert finding(make(signals, time=gap), "has a gap of 0.51 s at 3.00 s")


def test_scale_error_and_weak_field_are_remarked(signals):
    assert finding(make(signals, force=1.03), "scale or bias error")
    assert finding(make(signals, field=2.4), "strong hard iron")
    assert finding(make(signals, rate=0.01), "is its unit right?")


@pytest.mark.parametrize(("count", "message"), [(0, "no sensor"), (19, "at least 20 are needed")])
def test_too_little(signals, count, message):
    cut = [x[:count] for x in signals]
    with pytest.raises(InputError, match=message):
        make(cut) if count else Recording("walk", {})


def test_streams_that_hardly_overlap(signals):
    t, f, w, _ = signals
    with pytest.raises(InputError, match="hardly overlap; bring them to one time base"):
        Recording("walk", {"foot": Sensor(Stream(t, f), Stream(t + 5.95, w))})


def test_shapes(signals):
    t, f, w, _ = signals
    with pytest.raises(InputError, match=r"needed are \(T,\) and \(T, 3\)"):
        Recording("walk", {"foot": Sensor(Stream(t, f[:, :2]), Stream(t, w))})


@pytest.mark.parametrize(
    ("time", "position", "message"),
    [
        ([1.0, 9.0], [[0, 0, 0], [1, 1, 1]], "landmark 1 at 9.000 s lies outside the recording"),
        ([-1.0], [[0, 0, 0]], "landmark 0 at -1.000 s lies outside"),
        ([1.0], [[np.nan] * 3], "landmark 0 has no known coordinate"),
        ([1.0], [[1.0, np.nan, 0.0]], "only one of x and y"),
        ([np.nan], [[0, 0, 0]], "landmark 0 has no time"),
        ([], np.zeros((0, 3)), "the list of landmarks is empty"),
        ([1.0], [[0.0, 0.0]], r"\(K, 3\)"),
    ],
)
def test_landmarks_that_cannot_be(signals, time, position, message):
    with pytest.raises(InputError, match=message):
        make(signals, landmarks=Landmarks(np.array(time, float), np.array(position, float)))


def test_landmark_with_height_only_is_welcome(signals):
    make(signals, landmarks=Landmarks(np.array([1.0]), np.array([[np.nan, np.nan, 2.0]])))


@pytest.mark.parametrize(
    ("truth", "message"),
    [
        (Truth(np.arange(3.0), np.zeros((2, 3))), "truth has time"),
        (Truth(np.arange(3.0), np.full((3, 3), np.nan)), "no valid position"),
        (Truth(np.array([0.0, 2.0, 1.0]), np.zeros((3, 3))), "the truth goes backwards in time"),
        (Truth(np.arange(3.0), np.zeros((3, 3)), np.zeros((3, 3))), "scalar first"),
    ],
)
def test_truth_that_cannot_be(signals, truth, message):
    with pytest.raises(InputError, match=message):
        make(signals, truth=truth)


def two_sensors(signals, **parts):
    recording = make(signals)
    sensor = recording.sensor()
    return replace(recording, sensors={"foot": sensor, "waist": sensor}, **parts)


def path(signals, sensor=None):
    return Truth(signals[0], np.zeros((len(signals[0]), 3)), sensor=sensor)


def test_each_sensor_has_its_own_truth(signals):
    waist, foot = path(signals), path(signals, "foot")
    recording = two_sensors(signals, truth=foot, truths={"waist": waist})
    assert recording.truth_of("waist").sensor == "waist"
    assert recording.truth_of() is recording.truth_of("foot") is recording.truth_of("head") is foot
    renamed = recording.renamed({"waist": "belt", "foot": "toe"})
    assert list(renamed.sensors) == ["toe", "belt"]
    assert (renamed.truth.sensor, renamed.truth_of("belt").sensor) == ("toe", "belt")
    with pytest.raises(InputError, match="two of its sensors would have one name"):
        recording.renamed({"waist": "foot"})


@pytest.mark.parametrize(
    ("own", "name", "sensor", "message"),
    [
        ("foot", "wasit", None, "a truth of 'wasit', which is no sensor; did you mean 'waist'"),
        ("foot", "waist", "foot", "sensor 'waist' says it is that of 'foot'"),
        ("waist", "waist", None, "two truths of sensor 'waist'"),
    ],
)
def test_truths_that_cannot_be(signals, own, name, sensor, message):
    with pytest.raises(InputError, match=message):
        two_sensors(signals, truth=path(signals, own), truths={name: path(signals, sensor)})


def test_a_further_truth_is_checked_as_the_first_is(signals):
    truth = Truth(np.arange(3.0), np.zeros((2, 3)))
    with pytest.raises(InputError, match="truth of sensor 'waist' has time"):
        two_sensors(signals, truths={"waist": truth})


def test_clocks(signals, rng):
    t, f, w, m = signals
    late = np.sort(t + np.clip(rng.exponential(0.002, 600), 0, 0.009))
    sensor = Sensor(Stream(late, f), Stream(late, w), Stream(t[::4], m[::4]))
    recording = Recording("walk", {"foot": sensor})
    stamps, uniform, even = (inertial(recording, clock=c) for c in ("stamps", "uniform", "resample"))
    np.testing.assert_array_equal(stamps.time, late)
    np.testing.assert_allclose(np.diff(uniform.time), (late[-1] - late[0]) / 599, rtol=1e-9)
    np.testing.assert_array_equal(uniform.angular_rate, w)
    assert np.ptp(np.diff(even.time)) < 1e-9
    np.testing.assert_allclose(even.specific_force[:, 2], np.interp(even.time, late, f[:, 2]))
    np.testing.assert_allclose(stamps.magnetic_field[:, 0], np.interp(late, t[::4], m[::4, 0]))
    assert stamps.dt[0] == stamps.dt[1]
    with pytest.raises(InputError, match="did you mean 'stamps'"):
        inertial(recording, clock="stamp")


def test_different_clocks_are_interpolated_without_extrapolation(signals):
    t, f, w, _ = signals
    sensor = Sensor(Stream(t[20:], f[20:]), Stream(t[:550] + 0.003, w[:550]))
    imu = inertial(Recording("walk", {"foot": sensor}))
    assert imu.time[0] >= t[20]
    assert imu.time[-1] <= t[-1]
    np.testing.assert_allclose(imu.specific_force[:, 0], np.interp(imu.time, t, f[:, 0]))


def test_a_field_is_not_held_beyond_its_stream(signals):
    t, f, w, m = signals
    sensor = Sensor(Stream(t, f), Stream(t, w), Stream(t[100:400], m[100:400]))
    recording = Recording("walk", {"foot": sensor})
    imu = inertial(recording)
    known = (t[100] - t <= 0.5) & (t - t[399] <= 0.5)
    np.testing.assert_array_equal(np.isfinite(imu.magnetic_field).all(axis=1), known)
    kept = np.r_[0:200, 400:600]  # a hole
    hole = replace(recording, sensors={"foot": replace(sensor, magnetometer=Stream(t[kept], m[kept]))})
    lost = (t - t[199] > 0.5) & (t[400] - t > 0.5)
    np.testing.assert_array_equal(np.isnan(inertial(hole).magnetic_field).any(axis=1), lost)
    with pytest.raises(
        InputError, match=r"walk: the magnetometer has no readings for 2.0 s, the first time 0.0 s after"
    ):
        pedjax.run(recording, "ma2018")


def test_sensor_by_name_and_crop(signals):
    recording = make(signals, field=1.0)
    with pytest.raises(InputError, match="no sensor 'fooot'; did you mean 'foot'"):
        recording.sensor("fooot")
    imu = inertial(recording).crop(10, 40)
    assert len(imu.time) == len(imu.dt) == len(imu.magnetic_field) == 30
    assert recording.duration == pytest.approx(5.99)


def test_replacing_a_part_checks_again(signals):
    recording = make(signals)
    with pytest.raises(InputError, match="outside the recording"):
        replace(recording, landmarks=Landmarks(np.array([99.0]), np.zeros((1, 3))))


def test_cropping_a_jittering_recording_changes_nothing_before_the_cut(signals, rng):
    t, f, w, _ = signals
    late = np.sort(t + np.clip(rng.exponential(0.002, 600), 0, 0.009))
    whole = inertial(Recording("walk", {"foot": Sensor(Stream(late, f), Stream(late, w))}))
    part = inertial(
        Recording("walk", {"foot": Sensor(Stream(late[:300], f[:300]), Stream(late[:300], w[:300]))})
    )
    np.testing.assert_array_equal(part.dt, whole.dt[:300])


def test_an_even_clock_keeps_samples_whose_stamps_are_equal(signals):
    t, f, w, _ = signals
    coarse = np.repeat(t[::2], 2)
    recording = Recording("walk", {"foot": Sensor(Stream(coarse, f), Stream(coarse, w))})
    assert len(inertial(recording, clock="uniform").time) == len(t)
    assert len(inertial(recording, clock="stamps").time) == len(t) // 2


def test_lists_become_arrays_and_words_are_refused():
    assert Stream([0, 1], [[1, 2, 3], [4, 5, 6]]).values.dtype == float
    with pytest.raises(InputError, match="not a number"):
        Stream([0, 1], [["a", 2, 3], [4, 5, 6]])


def test_a_rate_no_foot_is_sampled_at_is_refused(signals):
    t, f, w, _ = signals
    slow = Stream(1e3 * t, f)
    with pytest.raises(InputError, match="ms for s"):
        Recording("walk", {"foot": Sensor(slow, Stream(slow.time, w))})


def test_landmarks_are_kept_in_time_order():
    marks = Landmarks(np.array([3.0, 1.0]), np.array([[3.0, 0, 0], [1.0, 0, 0]]))
    np.testing.assert_array_equal(marks.position[:, 0], [1.0, 3.0])
