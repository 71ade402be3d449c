"""Files read through a TOML, what the checks catch through it, sidecars, and writing."""

import numpy as np
import pytest

from pedjax.errors import InputError
from pedjax.readers import read, write_csv
from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth

BASIC = """
[time]
column = "t"
[sensors.foot]
up = "+z"
accelerometer = {columns = ["ax", "ay", "az"], unit = "m/s^2"}
gyroscope = {columns = ["gx", "gy", "gz"], unit = "rad/s"}
"""
NAMES = ["t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz"]


def csv(path, walk, toml, *, force=1.0, rate=1.0, field=1.0, time=None, names=NAMES, delimiter=","):
    values = np.column_stack(
        [walk.time if time is None else time, force * walk.force, rate * walk.rate, field * walk.field]
    )
    rows = [delimiter.join(repr(v) for v in row) for row in values.tolist()]
    path.write_text("\n".join([*([delimiter.join(names)] if names else []), *rows]) + "\n")
    path.with_name(path.name + ".toml").write_text(toml)
    return path


def test_units_axes_and_columns(tmp_path, walk):
    toml = """
clock = "resample"
[format]
kind = "csv"
delimiter = ";"
[time]
column = "t"
unit = "ms"
[sensors.foot]
accelerometer = {columns = ["ax", "ay", "az"], unit = "g", axes = "+y-x+z"}
gyroscope = {columns = ["gx", "gy", "gz"], unit = "deg/s"}
magnetometer = {columns = ["mx", "my", "mz"], unit = "gauss"}
"""
    path = csv(
        tmp_path / "a.csv",
        walk,
        toml,
        force=1 / 9.80665,
        rate=180 / np.pi,
        field=0.01,
        time=1e3 * walk.time,
        delimiter=";",
    )
    recording = read(path)
    foot = recording.sensor()
    np.testing.assert_allclose(foot.accelerometer.values, walk.force[:, [1, 0, 2]] * [1, -1, 1], rtol=1e-12)
    np.testing.assert_allclose(foot.gyroscope.values, walk.rate, rtol=1e-12)
    np.testing.assert_allclose(foot.magnetometer.values, walk.field, rtol=1e-12)
    np.testing.assert_allclose(foot.gyroscope.time, walk.time, atol=1e-12)
    assert recording.clock == "resample"
    assert recording.format == "generic"


def test_numbered_columns_white_space_and_a_rate(tmp_path, walk):
    toml = """
[format]
delimiter = "whitespace"
header = 0
comment = "%"
[time]
rate_hz = 200
[sensors.foot]
gravity_signed = true
accelerometer = {columns = [1, 2, 3]}
gyroscope = {columns = ["4", "5", "6"]}
"""
    path = csv(tmp_path / "a.txt", walk, toml, force=-1.0, names=None, delimiter="  ")
    path.write_text("% a comment\n\n" + path.read_text())
    foot = read(path).sensor()
    np.testing.assert_array_equal(foot.accelerometer.values, walk.force)
    np.testing.assert_allclose(foot.gyroscope.time, walk.time)


def test_npz_with_a_clock_per_stream(tmp_path, walk):
    np.savez(tmp_path / "a.npz", acc=walk.force, ta=walk.time, w=walk.rate, tw=walk.time + 0.002)
    (tmp_path / "layout.toml").write_text("""
[sensors.shank]
accelerometer = {columns = "acc", time = "ta"}
gyroscope = {columns = "w", time = "tw"}
""")
    sensor = read(tmp_path / "a.npz", config=tmp_path / "layout.toml").sensor("shank")
    np.testing.assert_array_equal(sensor.gyroscope.time, walk.time + 0.002)
    np.testing.assert_array_equal(sensor.accelerometer.values, walk.force)


def test_landmarks_frames_and_return(tmp_path, walk):
    toml = (
        'return_to_start = true\nlandmarks_file = "m.csv"\n'
        + BASIC
        + """
[frame]
navigation = "NED"
[[landmarks]]
sample = 100
position = [1.0, 2.0, -3.0]
[[landmarks]]
time = 0.75
position = ["?", nan, -4.0]
"""
    )
    (tmp_path / "m.csv").write_text("time,x,y,z\n0.25,5,6,\n")
    marks = read(csv(tmp_path / "a.csv", walk, toml)).landmarks
    np.testing.assert_allclose(marks.time, [0.0, 0.25, 0.5, 0.75, walk.time[-1]])
    nan = np.nan
    expected = [[0, 0, 0], [6, 5, nan], [2, 1, 3], [nan, nan, 4], [0, 0, 0]]
    np.testing.assert_array_equal(marks.position, expected)


def test_left_handed_landmarks(tmp_path, walk):
    toml = BASIC + '[frame]\nnavigation = "left-handed z-up"\n[[landmarks]]\ntime = 1\nposition = [1, 2]\n'
    marks = read(csv(tmp_path / "a.csv", walk, toml)).landmarks
    np.testing.assert_array_equal(marks.position, [[1, -2, np.nan]])


def test_truth_in_ned(tmp_path, walk):
    quaternion = np.tile([0.0, 0.0, np.sin(0.3), np.cos(0.3)], (300, 1))  # 0.6 rad about down, x y z w
    np.savez(tmp_path / "a.npz", a=walk.force, w=walk.rate, t=walk.time, p=1e3 * walk.force, q=quaternion)
    (tmp_path / "a.npz.toml").write_text("""
[time]
column = "t"
[sensors.foot]
accelerometer = {columns = "a"}
gyroscope = {columns = "w"}
[frame]
navigation = "NED"
[truth]
position = {columns = "p", unit = "mm"}
quaternion = {columns = "q", order = "xyzw"}
""")
    truth = read(tmp_path / "a.npz").truth
    np.testing.assert_allclose(truth.position, walk.force[:, [1, 0, 2]] * [1, 1, -1], rtol=1e-12)
    w, x, y, z = truth.quaternion[0]
    forward = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    np.testing.assert_allclose(forward, [np.sin(0.6), np.cos(0.6), 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"force": 1 / 9.80665}, "looks like g"),
        ({"rate": 180 / np.pi}, "looks like deg/s"),
        ({"force": -1.0}, "points down"),
        ({"field": 0.01}, "looks like gauss"),
    ],
)
def test_wrong_units_and_signs_are_caught(tmp_path, walk, options, message):
    toml = BASIC + 'magnetometer = {columns = ["mx", "my", "mz"]}\n'
    with pytest.raises(InputError, match=message):
        read(csv(tmp_path / "a.csv", walk, toml, **options))


def test_nan_runs_and_backward_time_are_caught(tmp_path, walk):
    force = np.ones((300, 1))
    force[40:60] = np.nan
    with pytest.raises(InputError, match="20 samples that are not numbers, the first at sample 40"):
        read(csv(tmp_path / "a.csv", walk, BASIC, force=force))
    time = walk.time.copy()
    time[120] = 0.1
    with pytest.raises(InputError, match="backwards at sample 120"):
        read(csv(tmp_path / "a.csv", walk, BASIC, time=time))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("columns = [", "colums = [", "key 'colums' is unknown; did you mean 'columns'"),
        ("[time]", "[tim]", "key 'tim' is unknown; did you mean 'time'"),
        ('"az"', '"aq"', "accelerometer. columns, a.csv: there is no column 'aq'; known are: ax"),
        ('"ay", "az"', '"ay"', "2 columns where 3"),
        ("m/s^2", "m/s", "unit 'm/s' is unknown"),
        ('"+z"', '"z"', "up = 'z' is unknown"),
        ('column = "t"', 'column = "time"', "there is no column 'time'"),
        ('column = "t"', "", "give .time. column or rate_hz"),
        ('column = "t"', "column = 3", "'column' is 3 where text is needed"),
        ("gyroscope", "gyro", "key 'gyro' is unknown; did you mean 'gyroscope'"),
        ("[time]", "[time", "not valid TOML"),
        ('unit = "rad/s"', 'axes = "xyz"', "axes = 'xyz' is unknown"),
        ("[time]", 'clock = "stamp"\n[time]', "clock = 'stamp' is unknown; did you mean 'stamps'"),
        ("[time]", "[format]\nkind = 'npz'\n[time]", "does not fit"),
        ("[time]", "landmarks_file = 'no.csv'\n[time]", "no such file"),
        (
            "[time]",
            "[[landmarks]]\ntime = 9.0\nposition = [0, 0]\n[time]",
            "landmark 0 at 9.000 s lies outside",
        ),
        ("[time]", "[[landmarks]]\nsample = 300\nposition = [0, 0]\n[time]", "sample 300 lies outside"),
        ("[time]", "[[landmarks]]\ntime = 1\nposition = [0]\n[time]", "1 numbers"),
        ("[time]", "[[landmarks]]\ntime = 1\nposition = [0, 'x']\n[time]", "coordinate 'x'"),
        ("[time]", "[[landmarks]]\nposition = [0, 0]\n[time]", "either 'time' or 'sample'"),
        ("[time]", "[frame]\nnavigation = 'NWU'\n[time]", "navigation = 'NWU' is unknown"),
        ("[time]", "return_to_start = 1\n[time]", "'return_to_start' is 1 where true or false"),
    ],
)
def test_mistakes_in_the_toml_are_named(tmp_path, walk, old, new, message):
    with pytest.raises(InputError, match=message) as error:
        read(csv(tmp_path / "a.csv", walk, BASIC.replace(old, new, 1)))
    assert "a.csv" in str(error.value) or "no.csv" in str(error.value) or str(error.value).startswith("a:")
    assert "\n" not in str(error.value)


def test_bad_cell_is_named_by_its_line(tmp_path, walk):
    path = csv(tmp_path / "a.csv", walk, BASIC)
    lines = path.read_text().splitlines()
    lines[10] = lines[10].replace(lines[10].split(",")[5], "oops")
    path.write_text("\n".join([*lines[:5], "# a comment", *lines[5:]]))
    with pytest.raises(InputError, match="line 12, column 'gy' holds 'oops'"):
        read(path)


def test_sidecar_adds_landmarks_to_a_known_format(tmp_path, walk):
    names = [f"Gyroscope {a} (rad/s)" for a in "XYZ"] + [f"Accelerometer {a} (m/s^2)" for a in "XYZ"]
    rows = np.column_stack([walk.time, walk.rate, walk.force])
    path = tmp_path / "walk.csv"
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=",".join(["Time (s)", *names]), comments="")
    assert read(path).landmarks is None
    (tmp_path / "walk.csv.toml").write_text('return_to_start = true\nclock = "resample"\n')
    recording = read(path)
    np.testing.assert_array_equal(recording.landmarks.time, walk.time[[0, -1]])
    np.testing.assert_array_equal(recording.landmarks.position, np.zeros((2, 3)))
    assert (recording.format, recording.clock) == ("x-io", "resample")
    (tmp_path / "walk.csv.toml").write_text("return_to_strat = true\n")
    with pytest.raises(InputError, match="did you mean 'return_to_start'"):
        read(path)


def full(walk):
    foot = Sensor(
        Stream(walk.time, walk.force),
        Stream(walk.time, walk.rate),
        Stream(walk.time[::4] + 1 / 3, walk.field[::4]),
        up="+z",
    )
    other = Sensor(Stream(walk.time[5:] / 3, walk.force[5:]), Stream(walk.time[5:] / 3, walk.rate[5:]))
    truth = walk.force[:50].copy()
    truth[7] = np.nan
    return Recording(
        "a walk",
        {"foot": foot, "left thigh": other},
        landmarks=Landmarks(
            np.array([0.1, 1 / 3]), np.array([[0.0, 1 / 7, np.nan], [np.nan, np.nan, 3.0]]), "left thigh"
        ),
        truth=Truth(walk.time[:50], truth, np.tile([1.0, 0, 0, 0], (50, 1)), "foot"),
        truths={"left thigh": Truth(walk.time[:40], walk.force[:40])},
        clock="uniform",
        notes=("a note",),
    )


def same(first, second):
    assert (first.name, first.clock, first.findings) == (second.name, second.clock, second.findings)
    assert list(first.sensors) == list(second.sensors)
    for name, sensor in first.sensors.items():
        other = second.sensor(name)
        assert sensor.up == other.up
        for kind in ("accelerometer", "gyroscope", "magnetometer"):
            mine, theirs = getattr(sensor, kind), getattr(other, kind)
            assert (mine is None) == (theirs is None)
            if mine is not None:
                np.testing.assert_array_equal(mine.time, theirs.time)
                np.testing.assert_array_equal(mine.values, theirs.values)
    assert list(first.truths) == list(second.truths)
    pairs = [(first.landmarks, second.landmarks), (first.truth, second.truth)]
    pairs += [(first.truths[name], second.truths[name]) for name in first.truths]
    for mine, theirs in pairs:
        assert (mine is None) == (theirs is None)
        if mine is None:
            continue
        assert mine.sensor == theirs.sensor
        for part in ("time", "position", "quaternion"):
            np.testing.assert_array_equal(getattr(mine, part, None), getattr(theirs, part, None))


@pytest.mark.parametrize("name", ["out/w.csv", "w.csv.gz"])
def test_written_files_read_back_identically(tmp_path, walk, name):
    recording = full(walk)
    sidecar = write_csv(recording, tmp_path / name)
    assert sidecar == tmp_path / f"{name}.toml"
    same(recording, read(tmp_path / name))
    assert list((tmp_path / name).parent.glob(".*.tmp")) == []


def test_of_several_sensors_one_is_kept(tmp_path, walk):
    write_csv(full(walk), tmp_path / "w.csv")
    assert list(read(tmp_path / "w.csv", sensor="left thigh").sensors) == ["left thigh"]
    with pytest.raises(InputError, match="did you mean 'foot'"):
        read(tmp_path / "w.csv", sensor="foots")


def test_writing_where_nothing_can_be_written(tmp_path, walk):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot write there"):
        write_csv(full(walk), tmp_path / "file" / "w.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_csv(full(walk), tmp_path / "folder.csv")
    assert list(tmp_path.glob(".*.tmp")) == []
