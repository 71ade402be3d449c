"""Calibration files, clouds as files, calibrated recordings, and the command."""

import tomllib

import numpy as np
import pytest

from pedjax.calibration import clouds, files, fitting
from pedjax.cli.main import main
from pedjax.errors import InputError
from pedjax.readers import write_csv
from pedjax.recording import Recording, Sensor, Stream
from tests.calibration.common import table_one
from tests.calibration.test_fitting import GOOD, cloud, walk


@pytest.fixture(scope="module")
def fit():
    return fitting.fit_cloud(cloud(GOOD))


@pytest.fixture
def at_home(tmp_path, monkeypatch):
    monkeypatch.setenv("PEDJAX_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("pedjax.runtime.configure", lambda *args, **kwargs: None)  # JAX has started


def test_written_and_read(fit, tmp_path):
    first, second = tmp_path / "a.toml", tmp_path / "b.toml"
    for path in (first, second):
        files.write(path, fit, "spin.txt", "foot", "2016-05-31")
    assert first.read_bytes() == second.read_bytes()
    found = files.read(first)
    for name, value in fit.calibration._asdict().items():
        np.testing.assert_array_equal(getattr(found, name), value)
    told = tomllib.loads(first.read_text())
    assert told["source"] == "spin.txt"
    assert told["recorded"] == "2016-05-31"
    assert told["sensor"] == "foot"
    assert told["method"] == "algebraic + refined"
    assert told["field_ut"] == fit.strength
    assert told["diagnostics"]["samples"] == 60
    assert [p.name for p in tmp_path.iterdir() if p.suffix != ".toml"] == []


def test_a_part_that_is_missing_is_the_identity(tmp_path):
    (tmp_path / "a.toml").write_text("hard_iron = [1, 2, 3]")
    found = files.read(tmp_path / "a.toml")
    np.testing.assert_array_equal(found.hard_iron, [1, 2, 3])
    np.testing.assert_array_equal(found.matrix, np.eye(3))
    np.testing.assert_array_equal(found.level_matrix, np.eye(2))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hard_iron = [1, 2", "not valid TOML"),
        ("hard_irn = [1, 2, 3]", "did you mean 'hard_iron'"),
        ("method = 'lsq'", "holds no calibration"),
        ("hard_iron = [1, 2]", "hard_iron has shape (2,) where (3,) is needed"),
        ("hard_iron = ['a', 2, 3]", "hard_iron must hold numbers"),
        ("level_offset = [nan, 0]", "level_offset holds a number that is not finite"),
        ("matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 0]]", "matrix is singular"),
        ("matrix = [[1, 0], [0]]", "matrix must hold numbers"),
        ("matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nlevel_ahead = 'up'", "level_ahead must be x, y or z"),
    ],
)
def test_files_that_are_refused(tmp_path, text, said):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        files.read(path)
    assert said in str(error.value)
    assert "wrong.toml" in str(error.value)
    assert "\n" not in str(error.value)


def test_no_file(tmp_path):
    with pytest.raises(InputError, match="pedjax calibrate"):
        files.read(tmp_path / "none.toml")
    with pytest.raises(InputError, match="check the path"):
        files.read(tmp_path)


def recording(imu, name="walk", others=()):
    streams = [Stream(imu.time, x) for x in (imu.specific_force, imu.angular_rate, imu.magnetic_field)]
    return Recording(name, {key: Sensor(*streams) for key in ("foot", *others)})


def rows(path, *columns):
    path.write_text("\n".join(" ".join(f"{x:.9g}" for x in row) for row in np.column_stack(columns)) + "\n")


def test_clouds_as_files(tmp_path):
    time = np.arange(60) / 50.0
    rows(tmp_path / "three.txt", GOOD)
    (tmp_path / "four.csv").write_text(
        "\n".join(f"{t},{x},{y},{z}" for t, (x, y, z) in zip(time, GOOD, strict=True))
    )
    phone = tmp_path / "day"
    phone.mkdir()
    rows(phone / "magnetometer.txt", time, GOOD, np.zeros((60, 3)))
    rows(phone / "accelerometer.txt", np.arange(240) / 200, np.tile([0, 0, 9.81], (240, 1)))
    (phone / "record.properties").write_text("[Time]\nStartTime = 1464683442\n")
    for name in ("three.txt", "four.csv", "day"):
        path = str(tmp_path / name)
        assert clouds.is_cloud(path)
        found = clouds.read(path)
        np.testing.assert_allclose(found.field, GOOD, rtol=1e-8)
        if name != "three.txt":
            np.testing.assert_allclose(found.time, time)
    assert found.recorded == "2016-05-31"
    np.testing.assert_allclose(found.force, np.tile([0, 0, 9.81], (60, 1)))
    inside = found.between(0.2, 0.5)
    assert len(inside.field) == len(inside.force) == len(inside.quiet) == 16
    with pytest.raises(InputError, match="holds no sample"):
        found.between(5, 6)


@pytest.mark.parametrize("text", ["a b c\n1 2 3\n", "1 2\n3 4\n", "", "\0\1"])
def test_other_files_are_no_clouds(tmp_path, text):
    (tmp_path / "x.txt").write_text(text)
    assert not clouds.is_cloud(str(tmp_path / "x.txt"))
    assert not clouds.is_cloud(str(tmp_path))
    assert not clouds.is_cloud(str(tmp_path / "none.txt"))


def test_a_broken_row_is_named(tmp_path):
    rows(tmp_path / "x.txt", np.arange(400.0), np.ones((400, 3)))
    lines = (tmp_path / "x.txt").read_text().splitlines()
    lines[300] = "1 2 x 4"
    (tmp_path / "x.txt").write_text("\n".join(lines))
    with pytest.raises(InputError, match="line 301"):
        clouds.read(str(tmp_path / "x.txt"))


def command(*args):
    return main(["calibrate", *(str(a) for a in args)])


def test_command_with_a_cloud(at_home, tmp_path, capsys, fit):
    rows(tmp_path / "spin.txt", GOOD)
    assert command(tmp_path / "spin.txt", "--out", tmp_path / "out") == 0
    printed = capsys.readouterr().out
    assert "algebraic + refined (turned through space" in printed
    assert "hard iron (14.3" in printed
    found = files.read(tmp_path / "out" / "calibration.toml")
    np.testing.assert_allclose(found.matrix, fit.calibration.matrix, rtol=1e-6, atol=1e-8)
    assert (tmp_path / "out" / "calibration.png").read_bytes().startswith(b"\x89PNG")
    named = tmp_path / "mine.toml"
    asked = ("--method", "clsef", "--field", 48, "--factor", "upper", "--no-refine", "--no-figures")
    assert command(tmp_path / "spin.txt", "--out", named, *asked) == 0
    told = tomllib.loads(named.read_text())
    assert (told["method"], told["field_ut"], told["reason"]) == ("clsef", 48.0, "as asked")
    assert not named.with_suffix(".png").exists()


def test_command_with_a_walk(at_home, tmp_path, capsys):
    write_csv(recording(walk()), tmp_path / "walk.csv")
    out = tmp_path / "loop"
    assert command(tmp_path / "walk.csv", "--method", "lsq", "--out", out) == 0
    assert "13 stances" in capsys.readouterr().out
    found = files.read(out / "calibration.toml")
    np.testing.assert_allclose(found.level_offset, 0, atol=0.05)
    assert (out / "calibration.png").exists()
    base = tmp_path / "base.toml"
    base.write_text("hard_iron = [5.0, -3.0, 2.0]")
    assert (
        command(tmp_path / "walk.csv", "--method", "lsq", "--base", base, "--out", out, "--no-figures") == 0
    )
    both = files.read(out / "calibration.toml")
    np.testing.assert_array_equal(both.hard_iron, [5.0, -3.0, 2.0])
    assert np.hypot(*both.level_offset) > 3.0
    assert command(tmp_path / "walk.csv", "--method", "lsq", "--no-align", "--out", tmp_path / "none") == 1
    assert "--no-align is for ellipsoids" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--method", "lsq"), "holds no walk"),
        (("--field", "-1"), "must be a positive strength"),
        (("--between", "100", "200"), "holds no sample"),
        (("--between", "0", "5"), "6 samples of the field are too few"),
        (("--base", "base.toml"), "--base is for loops"),
        (("other.txt",), "takes one recording"),
    ],
)
def test_command_refuses(at_home, tmp_path, capsys, args, said):
    rows(tmp_path / "spin.txt", 0.1 * table_one(np.random.default_rng(1), 60, 1.0))
    assert command(tmp_path / "spin.txt", *args, "--out", tmp_path / "out") == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
