"""Each known format from a tiny file written here: values, units, axes, clocks, landmarks, damage."""

import gzip

import numpy as np
import pytest
from scipy.io import savemat

from pedjax.errors import InputError
from pedjax.readers import FORMATS, read

G = 9.80665
DOWN = np.array([1.0, -1.0, -1.0])


def table(path, header, columns, delimiter=","):
    rows = [delimiter.join(repr(float(v)) for v in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([*header, *rows]) + "\n")
    return path


def test_formats_are_described():
    assert all(known.about for known in FORMATS.values())


# --- PyShoe


def pyshoe(path, walk, **more):
    imu = np.hstack([walk.force * DOWN, walk.rate * DOWN])
    savemat(path, {"imu": imu, "ts": (walk.time + 5.0)[None], **more})
    return path


def test_pyshoe_dense_truth_is_mirrored(tmp_path, walk):
    gt = np.random.default_rng(1).normal(size=(300, 3))
    recording = read(pyshoe(tmp_path / "a.mat", walk, gt=gt))
    foot = recording.sensor()
    np.testing.assert_array_equal(foot.accelerometer.values, walk.force * DOWN)
    np.testing.assert_array_equal(foot.gyroscope.values, walk.rate * DOWN)
    np.testing.assert_allclose(foot.gyroscope.time, walk.time, atol=1e-12)
    np.testing.assert_array_equal(recording.truth.position, gt * [1, -1, 1])
    assert recording.landmarks is None
    assert recording.format == "pyshoe"


@pytest.mark.parametrize("turn", [False, True])
def test_pyshoe_hallway_landmarks_count_samples_from_zero(tmp_path, walk, turn):
    gt = np.arange(12.0).reshape(4, 3)
    index = np.array([[0, 100, 200, 299]])
    more = {"gt": gt.T if turn else gt, "gt_idx": index.T if turn else index}
    marks = read(pyshoe(tmp_path / "h.mat", walk, **more)).landmarks
    np.testing.assert_allclose(marks.time, walk.time[index[0]], atol=1e-12)
    np.testing.assert_array_equal(marks.position, gt * [1, -1, 1])


def test_pyshoe_index_up_to_n_counts_from_one(tmp_path, walk):
    marks = read(pyshoe(tmp_path / "h.mat", walk, gt=np.zeros((2, 3)), gt_idx=[[1, 300]])).landmarks
    np.testing.assert_allclose(marks.time, walk.time[[0, 299]], atol=1e-12)


def test_pyshoe_stairs_know_only_height(tmp_path, walk):
    recording = read(pyshoe(tmp_path / "s.mat", walk, gt=[[0.0, 3.2, 0.0]], gt_idx=[[0, 150, 299]]))
    assert np.isnan(recording.landmarks.position[:, :2]).all()
    np.testing.assert_array_equal(recording.landmarks.position[:, 2], [0.0, 3.2, 0.0])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"gt": np.zeros((7, 3))}, "gt_idx"),
        ({"gt": np.zeros((2, 3)), "gt_idx": [[0, 301]]}, "from 0 to 299"),
        ({"gt": np.zeros((2, 3)), "gt_idx": [[0, 1, 2]]}, "3 entries"),
        ({"gt": np.zeros((2, 3)), "gt_idx": [[0.5, 1]]}, "whole numbers"),
        ({"ts": np.zeros((1, 4))}, "stamps"),
        ({"imu": np.zeros((300, 5))}, r"\(N, 6\)"),
    ],
)
def test_pyshoe_shapes_that_do_not_fit(tmp_path, walk, more, message):
    with pytest.raises(InputError, match=message):
        read(pyshoe(tmp_path / "a.mat", walk, **more))


def test_pyshoe_upside_down_is_noted(tmp_path, walk):
    savemat(tmp_path / "u.mat", {"imu": np.hstack([walk.force, walk.rate]), "ts": walk.time})
    assert any("upside down" in line for line in read(tmp_path / "u.mat").findings)


# --- MicroStrain


def microstrain(path, walk, time=None):
    names = [f"n-1.2:scaled{kind}{axis}" for kind in ("Accel", "Gyro", "Mag") for axis in "XYZ"]
    columns = [
        walk.time if time is None else time,
        walk.force * DOWN / G,
        walk.rate * DOWN,
        walk.field * DOWN / 100,
    ]
    return table(path, [",".join(["Time", *names])], columns)


def points(folder, stem, numbers=(0, 2), strides=2):
    position = np.array([[0.1 * n, -0.2 * n] for n in numbers])
    savemat(
        folder / f"{stem}.mat",
        {"GCP_meters": position, "GCP_stride_numbers": [list(numbers)], "numberOfStrides": [[strides]]},
    )
    return position


def test_microstrain_units_and_landmarks_at_row_s(tmp_path, walk):
    path = microstrain(tmp_path / "w.csv", walk)
    position = points(tmp_path, "w")
    (tmp_path / "stride_index").mkdir()
    (tmp_path / "stride_index" / "w_strideIndex_x.csv").write_text(
        "strideIndex,timestamp,gcpX,gcpY\n10,0.05,0,0\n100,0.5,0,0\n200,1.0,0,0\n"
    )
    recording = read(path)
    foot = recording.sensor()
    np.testing.assert_allclose(foot.accelerometer.values, walk.force * DOWN, rtol=1e-12)
    np.testing.assert_allclose(foot.magnetometer.values, walk.field * DOWN, rtol=1e-12)
    np.testing.assert_allclose(recording.landmarks.time, [0.05, 1.0])  # strides 0 and 2: rows 0 and 2
    np.testing.assert_array_equal(recording.landmarks.position[:, :2], position)
    assert np.isnan(recording.landmarks.position[:, 2]).all()


def test_microstrain_list_without_stamps_counts_rows(tmp_path, walk):
    path = microstrain(tmp_path / "w.csv", walk)
    points(tmp_path, "w")
    (tmp_path / "w_strideIndex.csv").write_text("# strideIndex (0-based)\n10\n100\n200\n")
    np.testing.assert_allclose(read(path).landmarks.time, walk.time[[10, 200]])
    (tmp_path / "w_strideIndex.csv").write_text("# strideIndex (0-based)\n10\n100\n900\n")
    with pytest.raises(InputError, match="sample 900 lies outside"):
        read(path)


def test_microstrain_at_250_hz_the_list_is_on_200_hz(tmp_path, walk):
    names = [f"n:est{kind}{axis}" for kind in ("CompensatedAccel", "AngularRate") for axis in "XYZ"]
    header = ",".join(["Time", *(part for name in names for part in (name, name + ":valid"))])
    time = np.arange(300) / 250.0
    ones = np.ones(300)
    cells = [part for value in np.hstack([walk.force, walk.rate]).T * 1.0 for part in (value, ones)]
    cells[4] = -cells[4]  # z down
    cells[1] = np.where(np.arange(300) == 7, 0.0, 1.0)
    path = table(tmp_path / "e.csv", [header], [time, *cells])
    points(tmp_path, "e")
    (tmp_path / "e_strideIndex.csv").write_text("strideIndex\n0\n100\n200\n")
    recording = read(path)
    np.testing.assert_allclose(recording.landmarks.time, [0.0, 1.0])
    assert len(recording.sensor().gyroscope.time) == 299
    assert any("1 rows that are not valid" in line for line in recording.findings)
    assert recording.sensor().magnetometer is None


def test_microstrain_missing_or_unfit_landmarks_are_noted(tmp_path, walk):
    path = microstrain(tmp_path / "w.csv", walk)
    assert "without landmarks" in read(path).findings[0]
    points(tmp_path, "w")
    assert "strideIndex" in read(path).findings[0]
    (tmp_path / "w_strideIndex.csv").write_text("strideIndex\n10\n100\n")
    assert "2 rows" in read(path).findings[0]
    assert read(path).landmarks is None


def test_microstrain_late_stamps_become_even(tmp_path, walk):
    late = np.sort(walk.time + np.random.default_rng(3).uniform(0, 4e-3, 300))
    assert read(microstrain(tmp_path / "w.csv", walk, time=late)).clock == "uniform"


def test_microstrain_gravity_signed_is_caught(tmp_path, walk):
    flipped = type(walk)(walk.time, -walk.force, walk.rate, walk.field)
    with pytest.raises(InputError, match="points down"):
        read(microstrain(tmp_path / "w.csv", flipped))


# --- OpenShoe


def openshoe(path, walk, cut=True):
    lines = ["", "Inertial data.", "", "Header:      a_x [g]: ..."]
    counter = 19_000_000
    for i in range(300):
        counter = (counter + 78720) % 19_689_141
        f, w = walk.force[i] / G, walk.rate[i]
        m = ["+nan"] * 3 if i % 30 == 3 else [f"{v:+.8f}" for v in walk.field[i] / 100]
        numbers = " ".join(f"{v:+.17g}" for v in (*f, *w))
        lines.append(f"   0xcb {numbers} {counter} 0x15fd {i} 1.5 1.5 1.5 250.0 {' '.join(m)} ")
    text = "\r\n".join(lines) + "\r\n"
    path.write_text(text[:-60] if cut else text, newline="")
    return path


def test_openshoe(tmp_path, walk):
    recording = read(openshoe(tmp_path / "data_inert.txt", walk))
    foot = recording.sensor()
    assert len(foot.gyroscope.time) == 299
    np.testing.assert_allclose(np.diff(foot.gyroscope.time), 78720 / 19_660_800)
    np.testing.assert_allclose(foot.accelerometer.values, walk.force[:299], rtol=1e-12)
    np.testing.assert_array_equal(foot.gyroscope.values, walk.rate[:299])
    assert len(foot.magnetometer.time) == 289
    np.testing.assert_allclose(foot.magnetometer.values[0], walk.field[0], atol=1e-5)
    np.testing.assert_array_equal(recording.landmarks.position, np.zeros((2, 3)))
    np.testing.assert_array_equal(recording.landmarks.time, foot.gyroscope.time[[0, -1]])
    assert any("cut off" in line for line in recording.findings)


def test_openshoe_whole_file_keeps_its_last_row(tmp_path, walk):
    recording = read(openshoe(tmp_path / "data_inert.txt", walk, cut=False))
    assert len(recording.sensor().gyroscope.time) == 300


def test_openshoe_broken_row_in_the_middle(tmp_path, walk):
    path = openshoe(tmp_path / "data_inert.txt", walk)
    lines = path.read_text().splitlines(keepends=True)
    lines[50] = "   0xcb +0.1 +0.2\n"
    path.write_text("".join(lines))
    with pytest.raises(InputError, match=r"data_inert.txt: line 51 has 3 columns where the header has 17"):
        read(path)


# --- x-io


def xio(path, walk, magnetometer=None):
    names = [f"Gyroscope {a} (deg/s)" for a in "XYZ"] + [f"Accelerometer {a} (g)" for a in "XYZ"]
    columns = [walk.time, np.rad2deg(walk.rate), walk.force / G]
    if magnetometer:
        names += [f"Magnetometer {a} ({magnetometer})" for a in "XYZ"]
        columns.append(walk.field)
    return table(path, [",".join(["Time (s)", *names])], columns)


def test_xio(tmp_path, walk):
    recording = read(xio(tmp_path / "walk.csv", walk, "uT"))
    foot = recording.sensor()
    np.testing.assert_allclose(foot.accelerometer.values, walk.force, rtol=1e-12)
    np.testing.assert_allclose(foot.gyroscope.values, walk.rate, rtol=1e-12)
    np.testing.assert_array_equal(foot.magnetometer.values, walk.field)
    assert recording.landmarks is None


def test_xio_magnetometer_without_a_unit_is_dropped(tmp_path, walk):
    recording = read(xio(tmp_path / "walk.csv", walk, "a.u."))
    assert recording.sensor().magnetometer is None
    assert "a.u." in recording.findings[0]


def test_xio_missing_column(tmp_path, walk):
    path = xio(tmp_path / "walk.csv", walk)
    path.write_text(path.read_text().replace("Accelerometer Z", "Altitude"))
    with pytest.raises(InputError, match="no column 'Accelerometer Z"):
        read(path)


def test_single_sensor_takes_the_asked_name(tmp_path, walk):
    assert set(read(xio(tmp_path / "walk.csv", walk), sensor="shank").sensors) == {"shank"}


# --- gaitmap


def gaitmap(path, walk, index, sides=("left_sensor", "right_sensor"), field=None):
    axes = [f"{kind}_{a}" for kind in ("acc", "gyr") for a in "xyz"]
    values = np.hstack([walk.force, np.rad2deg(walk.rate)])
    columns, top, below = [index], ["sensor"], ["axis"]
    for number, side in enumerate(sides):
        columns.append(values * (1 + 1e-3 * number))
        top += [side] * 6
        below += axes
    if field is not None:
        columns.append(field)
        below += ["mag_x", "mag_y", "mag_z"]
    header = [",".join(top), ",".join(below)] if len(sides) > 1 else [",".join(below)]
    return table(path, header, columns)


def test_gaitmap_two_feet(tmp_path, walk):
    path = gaitmap(tmp_path / "imu.csv", walk, np.arange(300))
    recording = read(path)
    assert list(recording.sensors) == ["foot", "foot_right"]
    np.testing.assert_allclose(recording.sensor().gyroscope.values, walk.rate, rtol=1e-12)
    np.testing.assert_allclose(recording.sensor().accelerometer.time, np.arange(300) / 204.8)
    other = read(path, sensor="right_sensor")
    assert list(other.sensors) == ["foot", "foot_left"]
    np.testing.assert_allclose(other.sensor().accelerometer.values, 1.001 * walk.force, rtol=1e-12)
    with pytest.raises(InputError, match="did you mean 'right_sensor'"):
        read(path, sensor="right_sensr")


def test_gaitmap_index_in_seconds(tmp_path, walk):
    recording = read(gaitmap(tmp_path / "imu.csv", walk, walk.time))
    np.testing.assert_array_equal(recording.sensor().gyroscope.time, walk.time)


def test_gaitmap_one_foot_with_a_field_in_no_unit(tmp_path, walk):
    field = np.full((300, 3), 0.5)
    path = gaitmap(tmp_path / "walk_400Hz.csv", walk, np.arange(300), sides=("foot",), field=field)
    recording = read(path)
    assert list(recording.sensors) == ["foot"]
    assert recording.sensor().magnetometer is None
    assert any("magnetometer dropped" in line for line in recording.findings)
    assert recording.sensor().gyroscope.rate == pytest.approx(400.0)


# --- phones


def archive(path, walk, **more):
    later = walk.time + 0.1
    arrays = {"accel_time": walk.time, "accel": walk.force, "gyro_time": later, "gyro": walk.rate}
    np.savez(path, **arrays, **more)
    return path


def test_phone_archive(tmp_path, walk):
    more = {
        "mag_raw_time": walk.time,
        "mag_raw": walk.field + 400,
        "mag_android_time": walk.time,
        "mag_android": walk.field,
        "truth_time": np.array([0.0, 1.0]),
        "truth_position_mm": np.array([[1000.0, 2000.0, -500.0], [np.nan, np.nan, np.nan]]),
        "truth_quaternion_wxyz": np.array([[1.0, 0, 0, 0], [np.nan] * 4]),
    }
    recording = read(archive(tmp_path / "p.npz", walk, **more))
    pocket = recording.sensor("pocket")
    np.testing.assert_array_equal(pocket.magnetometer.values, walk.field)
    np.testing.assert_array_equal(pocket.gyroscope.time, walk.time + 0.1)
    np.testing.assert_allclose(recording.truth.position[0], [1.0, 2.0, -0.5])
    assert recording.truth.quaternion.shape == (2, 4)
    assert set(read(tmp_path / "p.npz", sensor="foot").sensors) == {"foot"}


def phone_log(path, walk, extra=()):
    start = 1574655840014
    lines = ["#\tstartTime:1", f"{start - 100}\tTYPE_WAYPOINT\t20.5\t5.25"]
    for i in range(300):
        stamp = start + 20 * i
        for kind, values in (
            ("ACCELEROMETER", walk.force),
            ("GYROSCOPE", walk.rate),
            ("MAGNETIC_FIELD", walk.field),
        ):
            cells = "\t".join(repr(float(v)) for v in values[i])
            lines.append(f"{stamp}\tTYPE_{kind}\t{cells}\t3")
        lines.append(f"{stamp}\tTYPE_ROTATION_VECTOR\t0\t0\t1\t3")
    lines += [f"{start + 3000}\tTYPE_WAYPOINT\t22.0\t5.0", *extra]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_phone_log(tmp_path, walk):
    recording = read(phone_log(tmp_path / "t.txt", walk))
    hand = recording.sensor("hand")
    np.testing.assert_array_equal(hand.accelerometer.values, walk.force)
    np.testing.assert_allclose(hand.gyroscope.time, 0.02 * np.arange(300))
    np.testing.assert_allclose(recording.landmarks.time, [0.0, 3.0])  # the first was 0.1 s early
    np.testing.assert_array_equal(recording.landmarks.position[:, :2], [[20.5, 5.25], [22.0, 5.0]])


@pytest.mark.parametrize(
    "line",
    [
        "1574655840999\tTYPE_GYROSCOPE\t0.1\t0.2",
        "1574655840999\tTYPE_GYROSCOPE\t0.1\t0.2\tx\t3",
        "1574655840999\tTYPE_GYROSCOPE\t0.1\t0.2\t0.31574655841000\tTYPE_GYROSCOPE\t1\t2\t3",
        "half a li",
    ],
)
def test_phone_log_names_the_corrupt_line(tmp_path, walk, line):
    with pytest.raises(InputError, match=r"t.txt: line 1204"):
        read(phone_log(tmp_path / "t.txt", walk, extra=[line]))


# --- others


def test_broad(tmp_path, walk):
    truth = {"opt_pos": np.full((300, 3), 1.0), "opt_quat": np.tile([1.0, 0, 0, 0], (300, 1))}
    truth["opt_pos"][:9] = np.nan
    arrays = {"imu_acc": walk.force, "imu_gyr": walk.rate, "imu_mag": walk.field, "sampling_rate": 200.0}
    savemat(tmp_path / "b.mat", {**arrays, **truth})
    recording = read(tmp_path / "b.mat")
    np.testing.assert_array_equal(recording.sensor("hand").gyroscope.values, walk.rate)
    np.testing.assert_allclose(recording.sensor("hand").gyroscope.time, walk.time)
    assert np.isnan(recording.truth.position[:9]).all()


def test_static_archive(tmp_path):
    still = {"gyro_deg_s": np.full((50, 3), 0.5), "accel_g": np.tile([0.0, 0, -1.0], (50, 1))}
    np.savez(tmp_path / "i.npz", **still, sample_rate_hz=100.0)
    sensor = read(tmp_path / "i.npz").sensor("static")
    np.testing.assert_allclose(sensor.gyroscope.values, np.deg2rad(0.5))
    np.testing.assert_allclose(sensor.accelerometer.values[:, 2], -G)


@pytest.mark.parametrize("ending", [".csv.gz", ".csv"])
def test_gzip_is_transparent(tmp_path, walk, ending):
    plain = xio(tmp_path / "plain.csv", walk)
    packed = tmp_path / f"packed{ending}"  # by content, whatever the name
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    np.testing.assert_array_equal(
        read(packed).sensor().gyroscope.values, read(plain).sensor().gyroscope.values
    )


# --- what is no recording


def message(path, **options):
    with pytest.raises(InputError) as error:
        read(path, **options)
    text = str(error.value)
    assert "\n" not in text
    assert path.name in text or path.stem in text
    return text


def test_missing_folder_and_empty(tmp_path):
    assert "no such file" in message(tmp_path / "no.csv")
    assert "folder" in message(tmp_path)
    for content in (b"", b"\n \n", gzip.compress(b"")):
        (tmp_path / "e.csv").write_bytes(content)
        assert "empty" in message(tmp_path / "e.csv")


def test_damaged_files(tmp_path, walk):
    whole = gzip.compress(xio(tmp_path / "plain.csv", walk).read_bytes())
    (tmp_path / "d.csv.gz").write_bytes(whole[: len(whole) // 2])
    assert "gzip" in message(tmp_path / "d.csv.gz")
    (tmp_path / "n.csv.gz").write_bytes(b"Time (s),x\n1,2\n")
    assert "no gzip" in message(tmp_path / "n.csv.gz")
    mat = pyshoe(tmp_path / "a.mat", walk).read_bytes()
    (tmp_path / "half.mat").write_bytes(mat[:3000])
    assert "MATLAB" in message(tmp_path / "half.mat")
    (tmp_path / "text.mat").write_text("not a matlab file at all")
    assert "MATLAB" in message(tmp_path / "text.mat")
    npz = archive(tmp_path / "a.npz", walk).read_bytes()
    (tmp_path / "half.npz").write_bytes(npz[:3000])
    assert "npz" in message(tmp_path / "half.npz")
    np.savez(tmp_path / "o.npz", accel=np.array([{}]), accel_time=0, gyro=0, gyro_time=0)
    assert "npz" in message(tmp_path / "o.npz")


def test_damaged_rows(tmp_path, walk):
    path = xio(tmp_path / "walk.csv", walk)
    whole = path.read_text()
    path.write_text(whole[:-100])
    assert "line 300 has" in message(path) or "line 301 has" in message(path)
    lines = whole.splitlines()
    cells = lines[41].split(",")
    lines[41] = ",".join([*cells[:5], "1.2.3", *cells[6:]])
    path.write_text("\n".join(lines))
    assert "line 42, column 'Accelerometer Y (g)' holds '1.2.3'" in message(path)
    lines[41] = ",".join([*cells[:5], "", *cells[6:]])
    path.write_text("\n".join(lines))
    assert "is empty" in message(path)
    path.write_text(lines[0])
    assert "no rows" in message(path)


def test_known_but_no_walk(tmp_path):
    savemat(
        tmp_path / "eight.mat", {"m": np.zeros((3, 3)), "quat": np.zeros((3, 4)), "dPos": np.zeros((2, 3))}
    )
    assert "no accelerometer" in message(tmp_path / "eight.mat")
    points(tmp_path, "w")
    assert "w.csv" in message(tmp_path / "w.mat")
    (tmp_path / "v73.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform" + bytes(500))
    assert "-v7" in message(tmp_path / "v73.mat")
    (tmp_path / "magnetometer.txt").write_text("0.1 1 2 3\n0.2 1 2 3\n")
    assert "calibration" in message(tmp_path / "magnetometer.txt")
    (tmp_path / "mocap.csv").write_text(",L_TOE,L_TOE,L_TOE\n,x,y,z\n0,1,2,3\n")
    assert "markers" in message(tmp_path / "mocap.csv")
    (tmp_path / "events.csv").write_text("s_id,foot,start,end\n0,left,1,2\n")
    assert "strides" in message(tmp_path / "events.csv")
    (tmp_path / "x_strideIndex.csv").write_text("strideIndex\n3\n")
    assert "strides" in message(tmp_path / "x_strideIndex.csv")
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    assert "neither text" in message(tmp_path / "picture.png")
    np.savez(tmp_path / "other.npz", a=1)
    assert "arrays: a" in message(tmp_path / "other.npz")
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    assert "other.csv.toml" in message(tmp_path / "other.csv")


@pytest.mark.parametrize("compressed", [False, True])
def test_damaged_tags_of_a_mat_are_refused_before_scipy_reads_them(tmp_path, walk, compressed):
    path = tmp_path / "a.mat"
    savemat(path, {"ts": walk.time, "imu": np.hstack([walk.force, walk.rate])}, do_compression=compressed)
    whole = path.read_bytes()
    assert read(path).duration > 1.0
    for at in range(128, 200):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :])
        try:
            read(path)
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017 (most of the bytes matter, not all)
