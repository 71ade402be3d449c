"""Designs: on each parameter's own scale, in range, repeatable; sets from files, with every refusal named."""

import csv
import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pedjax import design, parameters
from pedjax.errors import InputError
from pedjax.sweeping import DESIGNS
from pedjax.sweeping.designs import Axis, axes_around, axes_of, lay_out, listed_sets, with_settings
from pedjax.sweeping.engine import parts_of, slice_of
from tests import tools

THRESHOLD, ZUPT = "stance.shoe.threshold", "updates.zero_velocity"
RANGES = {THRESHOLD: [1e6, 1e9], "gravity": [9.79, 9.81]}


@pytest.fixture(scope="module")
def params():
    return tools.iez()


@pytest.mark.parametrize("kind", DESIGNS)
def test_designs_stay_in_range_and_repeat(params, kind):
    values = design(params, RANGES, 50, kind, seed=3)
    again, other = (design(params, RANGES, 50, kind, seed) for seed in (3, 4))
    for path, (low, high) in RANGES.items():
        assert values[path].shape == (49 if kind == "grid" else 50,)
        assert values[path].min() >= low
        assert values[path].max() <= high
        np.testing.assert_array_equal(values[path], again[path])
        assert np.array_equal(values[path], other[path]) == (kind == "grid")
    assert np.median(np.log10(values[THRESHOLD])) == pytest.approx(7.5, abs=0.5)


@pytest.mark.parametrize("kind", ["sobol", "latin"])
def test_every_stretch_of_an_axis_is_visited_alike(params, kind):
    values = design(params, RANGES, 64, kind)
    filled = np.histogram(np.log(values[THRESHOLD]), np.log(np.geomspace(1e6, 1e9, 17)))[0]
    assert filled.tolist() == [4] * 16


def test_a_grid_is_every_combination(params):
    values = design(params, RANGES, 9, "grid")
    pairs = set(zip(np.round(values[THRESHOLD]), values["gravity"].round(9), strict=True))
    assert len(pairs) == 9
    np.testing.assert_allclose(np.unique(values["gravity"].round(9)), [9.79, 9.8, 9.81])
    np.testing.assert_allclose(np.unique(np.log10(values[THRESHOLD]).round(6)), [6, 7.5, 9])


def test_a_grid_has_the_steps_that_each_axis_names(params):
    """Five thresholds, two gravities, and as many zero velocities as the rest of 47 allows."""
    ranges = {THRESHOLD: [1e6, 1e9, 5], "gravity": {"steps": 2}, ZUPT: [0.01, 0.1]}
    values = design(params, ranges, 47, "grid")
    assert [len(np.unique(values[path])) for path in ranges] == [5, 2, 4]
    assert len(values[ZUPT]) == 40


def test_a_grid_of_one_step_is_the_middle(params):
    values = design(params, {THRESHOLD: [1e6, 1e8, 1], "gravity": [9.7, 9.9, 1]}, 1, "grid")
    np.testing.assert_allclose([values[THRESHOLD][0], values["gravity"][0]], [1e7, 9.8])


@pytest.mark.parametrize("kind", DESIGNS)
def test_listed_values_are_the_only_ones(params, kind):
    axes = axes_of(params, {"gravity": [9.79, 9.81]}, {THRESHOLD: [5e8, 1e6, 3e7]})
    values = lay_out(axes, 60, kind)
    found, counts = np.unique(values[THRESHOLD], return_counts=True)
    assert found.tolist() == [1e6, 3e7, 5e8]
    assert counts.min() >= 0.2 * counts.sum()


def test_an_empty_range_is_the_bounds(params):
    spec = parameters.specs(params)[ZUPT]
    values = design(params, {ZUPT: []}, 5, "grid")[ZUPT]
    np.testing.assert_allclose(values[[0, -1]], [spec.low, spec.high])


def test_a_table_may_choose_the_scale(params):
    """Linear where the parameter's own scale is log: the middle is the mean, not the geometric one."""
    table = {"low": 1e6, "high": 3e6, "steps": 3, "scale": "linear"}
    np.testing.assert_allclose(design(params, {THRESHOLD: table}, 1, "grid")[THRESHOLD], [1e6, 2e6, 3e6])
    own = design(params, {THRESHOLD: {**table, "scale": "log"}}, 1, "grid")[THRESHOLD]
    assert own[1] == pytest.approx(math.sqrt(3) * 1e6)


@pytest.mark.parametrize(
    ("ranges", "count", "kind", "message"),
    [
        (RANGES, 8, "sobl", "design 'sobl' is unknown; did you mean 'sobol'"),
        (RANGES, 0, "grid", "at least one parameter and one set"),
        ({}, 8, "grid", "at least one parameter and one set"),
        ({"gravity": [9.9, 9.8]}, 8, "grid", "runs from 9.9 down to 9.8"),
        ({"gravity": [math.nan, 9.8]}, 8, "grid", "runs from nan down to 9.8"),
        ({"gravity": [9.7, 10.5]}, 8, "grid", "gravity = 10.5 m/s.* is outside its bounds, 9.7 to 9.9"),
        ({"gravty": []}, 8, "grid", "did you mean 'gravity'"),
        ({"gate.kind": []}, 8, "grid", "'gate.kind' is a setting"),
        ({"gravity": [9.8]}, 8, "grid", r"must be \[low, high\]"),
        ({"gravity": ["a", 9.8]}, 8, "grid", "must hold numbers"),
        ({"gravity": [9.7, 9.8, 1.5]}, 8, "grid", "1.5 steps must be a whole number"),
        ({"gravity": {"hihg": 9.8}}, 8, "grid", "key 'hihg' is unknown; did you mean 'high'"),
        ({"gravity": {"scale": "cubic"}}, 8, "grid", "must be 'log' or 'linear'"),
        ({"initial.heading": {"scale": "log"}}, 8, "grid", "initial.heading is swept on a log scale"),
    ],
)
def test_wrong_designs_are_refused(params, ranges, count, kind, message):
    with pytest.raises(InputError, match=message):
        design(params, ranges, count, kind)


@pytest.mark.parametrize(
    ("ranges", "values", "message"),
    [
        ({"gravity": []}, {"gravity": [9.8]}, "both hold 'gravity'"),
        ({}, {"gravity": []}, "must be a list of numbers"),
        ({}, {"gravity": "9.8"}, "must be a list of numbers"),
        ({}, {"gravity": [True]}, "must hold numbers"),
        ({}, {"gravity": [9.8, 12.0]}, "outside its bounds"),
    ],
)
def test_wrong_values_are_refused(params, ranges, values, message):
    with pytest.raises(InputError, match=message):
        axes_of(params, ranges, values)


@pytest.mark.parametrize("steps", [math.inf, math.nan])
def test_steps_that_are_not_finite_are_refused(params, steps):
    with pytest.raises(InputError, match="whole number"):
        axes_of(params, {"gravity": [9.7, 9.8, steps]})


def test_values_that_are_no_number_are_refused(params):
    with pytest.raises(InputError, match="nan"):
        axes_of(params, {}, {"gravity": [9.8, math.nan, 9.81]})


scales = st.sampled_from(["log", "linear"])


@given(scales, st.floats(0.0, 1.0), st.floats(0.01, 1.0))
def test_zooming_stays_inside_and_is_centred(scale, place, shrink):
    axis = Axis("a", "m", scale == "log", 0.01, 10.0)
    low, high = axis.forward([axis.low, axis.high])
    centre = float(axis.at(np.array(place)))
    near = axis.zoomed(centre, shrink)
    a, b, middle = near.forward([near.low, near.high, centre])
    assert axis.low <= near.low <= centre * (1 + 1e-12)
    assert centre * (1 - 1e-12) <= near.high <= axis.high
    half = 0.5 * shrink * (high - low)
    assert a == pytest.approx(max(middle - half, low), abs=1e-9)
    assert b == pytest.approx(min(middle + half, high), abs=1e-9)


def test_listed_values_are_not_zoomed():
    axis = Axis("a", "m", False, 1.0, 3.0, points=(1.0, 2.0, 3.0))
    assert axis.zoomed(2.0, 0.1) == axis


def test_settings_come_one_combination_after_the_other():
    settings = {"rule": ["causal", "any"], "on": [True, False]}
    found = with_settings((), {"a": np.array([1.0, 2.0, 3.0])}, settings)
    assert found.count == 12
    assert found.values["a"].tolist() == [1.0, 2.0, 3.0] * 4
    assert found.groups() == [
        ({"rule": "causal", "on": True}, 0, 3),
        ({"rule": "causal", "on": False}, 3, 6),
        ({"rule": "any", "on": True}, 6, 9),
        ({"rule": "any", "on": False}, 9, 12),
    ]
    assert slice_of(found, 7, 9) == ({"rule": "any", "on": True}, {"a": pytest.approx([2.0, 3.0])})


def test_without_settings_all_sets_are_one_group():
    assert with_settings((), {"a": np.ones(5)}, {}).groups() == [({}, 0, 5)]


@given(st.integers(1, 20), st.integers(1, 4), st.integers(1, 25))
def test_parts_cover_all_sets_once_and_cross_no_change_of_settings(count, choices, size):
    found = with_settings((), {"a": np.arange(count)}, {"s": [str(c) for c in range(choices)]})
    parts = parts_of(found, size)
    assert [i for start, stop in parts for i in range(start, stop)] == list(range(count * choices))
    assert max(stop - start for start, stop in parts) <= size
    assert all(len(set(found.settings["s"][start:stop])) == 1 for start, stop in parts)


# sets from a file

SETS = {THRESHOLD: [1e6, 2e7, 3e8], ZUPT: [0.01, 0.02, 0.05]}
RESULTS = {"run": [0, 1, 2], "recording": ["a"] * 3, "armse_m": [0.1, None, 0.3], "healthy": [True] * 3}


def write(path, columns):
    if path.suffix == ".parquet":
        pq.write_table(pa.table(columns), path)
        return path
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([list(columns), *zip(*columns.values(), strict=True)])
    return path


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_listed_sets_are_read_as_they_are(params, tmp_path, kind):
    """In order, whatever results stand beside them."""
    found = listed_sets(write(tmp_path / f"sets.{kind}", RESULTS | SETS), params)
    assert {path: values.tolist() for path, values in found.items()} == SETS
    axes = axes_around(params, found)
    assert [(a.path, a.low, a.high, a.log) for a in axes] == [
        (THRESHOLD, 1e6, 3e8, True),
        (ZUPT, 0.01, 0.05, True),
    ]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"stance.shoe.treshold": [1e6]}, "did you mean 'stance.shoe.threshold'"),
        ({"gravity": [9.8, 12.0]}, "gravity = 12 m/s.* is outside its bounds"),
        ({"gravity": ["9.8", "fast"]}, "column 'gravity' must hold numbers"),
        ({"gravity": [9.8, None]}, "column 'gravity' must hold numbers"),
        ({"gravity": [9.8, math.nan]}, "gravity = nan"),
        ({"gate.kind": ["fixed"]}, "column 'gate.kind' is a setting"),
        ({"gravity": []}, "holds no parameter set"),
        ({"run": [1]}, "holds no parameter set"),
    ],
)
def test_wrong_files_of_sets_are_refused(params, tmp_path, kind, columns, message):
    with pytest.raises(InputError, match=message):
        listed_sets(write(tmp_path / f"sets.{kind}", columns), params)


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "holds no parameter set"), (f"gravity,{ZUPT}\n9.8,0.1\n9.8\n", "a row has fewer values")],
)
def test_broken_csv_is_refused(params, tmp_path, text, message):
    (tmp_path / "sets.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        listed_sets(tmp_path / "sets.csv", params)


@pytest.mark.parametrize("name", ["nowhere.csv", "nowhere.parquet"])
def test_a_missing_file_is_said(params, tmp_path, name):
    with pytest.raises(InputError, match=f"{name}: cannot be read"):
        listed_sets(tmp_path / name, params)


def test_what_is_not_parquet_is_said(params, tmp_path):
    (tmp_path / "sets.parquet").write_text("gravity\n9.8\n")
    with pytest.raises(InputError, match="cannot be read"):
        listed_sets(tmp_path / "sets.parquet", params)


def test_the_table_of_a_sweep_lists_its_sets(params, tmp_path):
    listed_sets(write(tmp_path / "sets.parquet", RESULTS | {"fingerprint": ["ab12"] * 3} | SETS), params)


def test_a_blank_last_line_is_no_set(params, tmp_path):
    (tmp_path / "sets.csv").write_text("gravity\n9.8\n\n")
    assert listed_sets(tmp_path / "sets.csv", params)["gravity"].tolist() == [9.8]
