"""A calibration file is a few parameters more, for every command that runs a magnetic system."""

import json

import numpy as np
import pytest

import pedjax
from pedjax import parameters
from pedjax.calibration import Calibration, files, fitting
from pedjax.filters.compass import calibrated_by
from tests.cli.calling import call, refused

LOOP = "calibration-loop:1"


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    path = tmp_path_factory.mktemp("calibration") / "loop.toml"
    fit = fitting.fit_loop(LOOP, fitting.walk_loop(pedjax.inertial(pedjax.read(LOOP))))
    files.write(path, fit, LOOP)
    return path


def test_a_calibrated_walk_is_better_and_its_config_keeps_the_numbers(calibration, tmp_path):
    errors = {}
    for name, args in (("raw", ()), ("calibrated", ("--calibration", calibration))):
        out = tmp_path / name
        assert call("run", LOOP, "--config", "ma2018_published", *args, "--out", out, "--no-figures") == 0
        (entry,) = json.loads((out / "metrics.json").read_text())["recordings"]
        errors[name] = entry["landmarks"]["rms_2d_m"]
    assert errors["calibrated"] < 0.3 * errors["raw"]
    again = tmp_path / "again"
    assert (
        call("run", "--config", tmp_path / "calibrated" / "config.toml", "--out", again, "--no-figures") == 0
    )
    (entry,) = json.loads((again / "metrics.json").read_text())["recordings"]
    assert entry["landmarks"]["rms_2d_m"] == errors["calibrated"]


def test_a_system_without_a_magnetometer_refuses_it(calibration, tmp_path, capsys):
    said = refused(capsys, "run", LOOP, "--calibration", calibration, "--out", tmp_path)
    assert "'iez' does not use a magnetometer" in said
    assert "ma2018" in said


def test_every_number_of_a_calibration_has_its_parameter(rng):
    made = Calibration(*(rng.normal(size=shape) for shape in ((3,), (3, 3), (2,), (2, 2))))
    known = pedjax.system("ma2018").defaults()
    found = calibrated_by(known, made)
    assert found["compass.body.hard_y"] == made.hard_iron[1]
    assert found["compass.body.zx"] == made.matrix[2, 0]
    assert found["compass.level.offset_y"] == made.level_offset[1]
    assert found.pop("compass.level.ahead") == "x"
    assert len(found) == 17
    for path in found:
        assert np.isfinite(parameters.get(known, path))
    assert calibrated_by(pedjax.system("iez").defaults(), made) == {}
