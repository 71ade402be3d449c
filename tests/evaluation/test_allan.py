"""Allan deviations against the published test set, allantools, and closed forms; refusals; the command."""

import argparse
import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest

import pedjax
from pedjax.cli.allan import add_parser, allan
from pedjax.errors import InputError
from pedjax.evaluation.allan import (
    allan_curve,
    degrees_of_freedom,
    even_rate,
    local_slopes,
    log_sizes,
)
from pedjax.plots.allan import allan_figure
from pedjax.recording import Recording, Sensor, Stream


def nbs14():
    """The 1000 points of NIST Special Publication 1065, 12.4 (Park-Miller generator)."""
    numbers = [1234567890]
    for _ in range(999):
        numbers.append(16807 * numbers[-1] % 2147483647)
    return np.array(numbers) / 2147483647


@pytest.mark.parametrize(
    ("overlapping", "printed"),
    [(True, ["0.2922319", "0.09159953", "0.03241343"]), (False, ["0.2922319", "0.09965736", "0.03897804"])],
)
def test_published_set(overlapping, printed):
    found = allan_curve(nbs14(), 1.0, [1, 10, 100], overlapping).deviation[:, 0]
    assert [f"{x:.{len(p) - 2}f}" for x, p in zip(found, printed, strict=True)] == printed


@pytest.mark.parametrize("overlapping", [True, False])
def test_equals_allantools(rng, overlapping):
    tools = pytest.importorskip("allantools")
    values = rng.normal(size=(3000, 2)) + np.cumsum(rng.normal(size=(3000, 2)), axis=0) * 0.05 + [9.8, -3.0]
    curve = allan_curve(values, 50.0, [1, 2, 3, 7, 20, 100, 600], overlapping)
    other = tools.oadev if overlapping else tools.adev
    for c in range(2):
        tau, expected, _, _ = other(values[:, c], rate=50.0, data_type="freq", taus=curve.tau)
        np.testing.assert_allclose(curve.tau, tau, rtol=1e-12)
        np.testing.assert_allclose(curve.deviation[:, c], expected, rtol=1e-10)


@pytest.mark.parametrize(("slope", "alpha"), [(-1.0, 2), (-0.5, 0), (0.0, -1), (0.5, -2)])
def test_degrees_of_freedom_equal_allantools(slope, alpha):
    tools = pytest.importorskip("allantools")
    sizes = np.array([2, 10, 100])
    expected = [tools.edf_simple(1001, m, alpha) for m in sizes]
    np.testing.assert_allclose(degrees_of_freedom(1001, sizes, np.full(3, slope)), expected, rtol=1e-12)


def test_log_sizes_are_some_of_all(rng):
    values = rng.normal(size=400)
    every, some = allan_curve(values, 10.0, np.arange(1, 201)), allan_curve(values, 10.0)
    assert every.size[-1] == 200
    assert some.clusters[-1] == 9
    np.testing.assert_array_equal(every.deviation[some.size - 1], some.deviation)
    np.testing.assert_allclose(some.tau, some.size / 10.0)


def test_channels_and_offsets_do_not_matter(rng):
    values = rng.normal(size=(500, 3))
    together = allan_curve(values + np.array([0.0, 1e3, -1e3]), 100.0)
    for c in range(3):
        alone = allan_curve(values[:, c], 100.0)
        np.testing.assert_allclose(together.deviation[:, c], alone.deviation[:, 0], rtol=1e-9)


def test_blocks_do_not_matter(rng):
    from pedjax.evaluation.allan import _mean_square

    theta = rng.normal(size=(1000, 2)).cumsum(axis=0)
    for m in (1, 30, 499):
        np.testing.assert_allclose(_mean_square(theta, m, 64), _mean_square(theta, m), rtol=1e-12)


def test_white_noise_falls_as_the_root_and_a_ramp_rises(rng):
    tau, n = 0.01, 200_000
    curve = allan_curve(np.stack([rng.normal(size=n), np.arange(n) * tau * 0.3], axis=1), 1 / tau)
    near = curve.tau < 1.0
    np.testing.assert_allclose(curve.deviation[near, 0], np.sqrt(tau / curve.tau[near]), rtol=0.05)
    np.testing.assert_allclose(curve.deviation[:, 1], 0.3 * curve.tau / np.sqrt(2), rtol=1e-6)
    slopes = local_slopes(curve.tau, curve.deviation)
    np.testing.assert_allclose(slopes[near, 0], -0.5, atol=0.05)
    np.testing.assert_allclose(slopes[:, 1], 1.0, atol=1e-6)


def test_band_holds_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(8)
    curve = allan_curve(rng.normal(size=(900, 2000)), 1.0, [1, 10, 100])
    low, high = curve.band(0.683)
    truth = 1 / np.sqrt(curve.tau)[:, None]
    np.testing.assert_allclose(((low < truth) & (truth < high)).mean(axis=1), 0.683, atol=0.06)
    wide = curve.band(0.95)
    assert (wide[0] < low).all()
    assert (wide[1] > high).all()


def test_points_can_be_chosen(rng):
    curve = allan_curve(rng.normal(size=(300, 2)), 1.0, [1, 2, 4, 8])
    some = curve.at(curve.tau > 2)
    assert some.size.tolist() == [4, 8]
    assert some.deviation.shape == some.edf.shape == (2, 2)
    assert some.samples == 300


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda v: allan_curve(np.where(np.arange(100) == 7, np.nan, v), 1.0), "the first is sample 7"),
        (lambda v: allan_curve(v[:17], 1.0), "needs at least 18 samples, here are 17"),
        (lambda v: allan_curve(v, 1.0, [60]), "asked for 60 to 60"),
        (lambda v: allan_curve(v, 1.0, [0]), "asked for 0 to 0"),
        (lambda v: allan_curve(v, 1.0, []), "asked for none"),
        (lambda v: allan_curve(v, 0.0), "must be positive"),
    ],
)
def test_refusals(rng, change, said):
    with pytest.raises(InputError, match=said):
        change(rng.normal(size=100))


def test_shapes_must_fit(rng):
    with pytest.raises(ValueError, match="must be"):
        allan_curve(rng.normal(size=(4, 4, 4)), 1.0)


def test_fewest_samples():
    assert log_sizes(18).tolist() == [1, 2]


def test_clock_must_be_even(rng):
    even = np.arange(1000) / 100.0
    assert even_rate(even) == pytest.approx(100.0)
    assert even_rate(even + rng.uniform(-2e-3, 2e-3, 1000)) == pytest.approx(100.0, rel=1e-3)
    with pytest.raises(InputError, match=r"here: .* 1 steps differ .* first at 4\.990 s \(20 ms\)"):
        even_rate(np.delete(even, 500), "here")
    with pytest.raises(InputError, match="even clock"):
        even_rate(np.sort(np.append(even, even[10])))
    with pytest.raises(InputError, match="increase"):
        even_rate(np.array([1.0]))


# -------------------------------------------------------------------------------------- the command


def at_rest(seconds=300.0, rate=50.0, bump=None):
    rng = np.random.default_rng(3)
    time = np.arange(int(seconds * rate)) / rate
    gyroscope = rng.normal(size=(len(time), 3)) * 1e-3 * np.sqrt(rate)
    force = rng.normal(size=(len(time), 3)) * 2e-3 * np.sqrt(rate) + [0, 0, 9.81]
    if bump is not None:
        gyroscope[(time > bump) & (time < bump + 3)] *= 30
    return Recording("rest", {"box": Sensor(Stream(time, force), Stream(time, gyroscope))})


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Run the command on a recording that is already there."""

    def run(recording, *more):
        monkeypatch.setattr("pedjax.cli.allan.read_all", lambda names, config: [recording])
        shared = argparse.ArgumentParser(add_help=False)
        shared.add_argument("recordings", nargs="*")
        for name in ("--sensor", "--format", "--out"):
            shared.add_argument(name)
        shared.add_argument("--no-figures", action="store_true")
        parser = argparse.ArgumentParser()
        add_parser(parser.add_subparsers(), shared)
        assert allan(parser.parse_args(["allan", "rest.csv", *more, "--out", str(tmp_path)])) == 0
        return tmp_path

    return run


def test_command_writes_what_it_says(call, capsys):
    out = call(at_rest())
    told = json.loads((out / "noise.json").read_text())
    assert told["pedjax_version"] == pedjax.__version__
    assert told["warnings"] == []
    for axis in "xyz":
        white = told["axes"][axis]["parameters"]["white"]
        assert white["value"] == pytest.approx(1e-3, rel=0.05)
        assert white["data_sheet"]["value"] == pytest.approx(np.rad2deg(1e-3) * 60, rel=0.05)
        assert white["data_sheet"]["unit"] == "deg/sqrt(h)"
    with open(out / "allan.csv") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        low, middle, high = (float(row[f"{k}_x_rad_per_s"]) for k in ("low", "deviation", "high"))
        assert low < middle < high
    assert (out / "allan.png").stat().st_size > 10_000
    said = capsys.readouterr().out
    assert "deg/sqrt(h)" in said
    assert "look at" not in said


def test_command_on_accelerometer_within_a_stretch(call, capsys):
    out = call(at_rest(), "--stream", "accelerometer", "--rest", "10", "200", "--no-figures")
    told = json.loads((out / "noise.json").read_text())
    assert told["samples"] == 9501
    assert told["axes"]["z"]["parameters"]["white"]["data_sheet"]["value"] == pytest.approx(0.12, rel=0.05)
    assert "m/s/sqrt(h)" in capsys.readouterr().out
    assert not (out / "allan.png").exists()


def test_command_warns_of_motion(call, capsys):
    out = call(at_rest(bump=100.0), "--no-figures")
    assert "the gyroscope shows motion in" in capsys.readouterr().out
    assert "first at 100 s" in json.loads((out / "noise.json").read_text())["warnings"][0]
    call(at_rest(bump=100.0), "--rest", "0", "99", "--no-figures")
    assert "shows motion" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--rest", "900", "901"], "holds no sample"),
        (["--stream", "magnetometer"], "has none"),
        (["--sensor", "foot"], "no sensor 'foot'"),
        (["other.csv"], "one recording, 2 were named"),
        (["--rest", "0", "0.2"], "needs at least 18 samples"),
    ],
)
def test_command_refuses(call, more, said):
    with pytest.raises(InputError, match=said):
        call(at_rest(20.0), *more)


def test_figure_has_a_panel_a_channel(rng):
    from pedjax.evaluation.noise import identify

    curve = allan_curve(rng.normal(size=(4000, 2)), 10.0)
    figure = allan_figure(curve, identify(curve, ("white",)), "xy", "mg", 2.0)
    assert [ax.get_title() for ax in figure.axes] == ["x", "y"]
    assert figure.axes[0].get_ylabel() == "Allan deviation (mg)"


# -------------------------------------------------------------------------------- a real sensor at rest


@pytest.fixture(scope="module")
def adis():
    """The Allan curves of both streams of a real ADIS16405 at rest for 2 h 47 min, in SI units."""
    folder = os.environ.get("PEDJAX_DATA")
    if not folder:
        pytest.skip("PEDJAX_DATA does not name a folder with recordings")
    file = Path(folder) / "adis16405_static" / "imu1.npz"
    if not file.exists():
        pytest.skip(f"{file.name} is not in the folder that PEDJAX_DATA names")
    from pedjax.readers import read

    sensor = read(file).sensors["static"]
    sizes = log_sizes(len(sensor.gyroscope.time), per_decade=7)
    return {
        kind: allan_curve(getattr(sensor, kind).values, even_rate(getattr(sensor, kind).time), sizes)
        for kind in ("gyroscope", "accelerometer")
    }


def test_real_gyroscope_against_its_data_sheet(adis):
    """2 deg/sqrt(h) and 0.007 deg/s typical: this unit has 2.3 to 2.5 deg/sqrt(h), 15 to 25 % more, and a
    minimum from 0.005 deg/s, still falling, to 0.0085, up to 20 % more."""
    from pedjax.evaluation.noise import identify, read_off

    read = read_off(adis["gyroscope"], "direct")
    white = np.rad2deg(read.white) * 60
    assert ((white > 2.0) & (white < 1.3 * 2.0)).all(), white
    lowest = np.rad2deg(read.instability)
    assert ((lowest > 0.6 * 0.007) & (lowest < 1.3 * 0.007)).all(), lowest
    for noise, n in zip(identify(adis["gyroscope"], shortest=0.1), white, strict=True):
        assert np.rad2deg(noise.values["white"]) * 60 == pytest.approx(n, rel=0.05)
        assert noise.misfit < 0.05
        assert noise.support["flicker"] + noise.support["random_walk"] > 0.95


def test_real_accelerometer_against_its_data_sheet(adis):
    """0.2 m/s/sqrt(h) and 0.2 mg typical: this unit has 0.21 to 0.27 m/s/sqrt(h) and a lowest point of 0.22
    to 0.30 mg, on a floor that shakes once a second, which the fit tells as its misfit."""
    from pedjax.evaluation.noise import identify, read_off

    curve = adis["accelerometer"]
    read = read_off(curve, "direct")
    white, lowest = 60 * read.white, 1e3 * read.instability / 9.80665
    assert ((white > 0.2) & (white < 1.5 * 0.2)).all(), white
    assert ((lowest > 0.2) & (lowest < 1.6 * 0.2)).all(), lowest
    assert all(0.03 < noise.misfit < 0.2 for noise in identify(curve))
