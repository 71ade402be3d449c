"""Sweeps: designs on each parameter's own scale, and losses equal to single runs."""

from dataclasses import replace

import numpy as np
import pytest

import pedjax
from pedjax import design, parameters, sweep
from pedjax.errors import InputError
from pedjax.sweeping import DESIGNS
from tests import tools

RANGES = {"stance.shoe.threshold": [1e6, 1e9], "gravity": [9.79, 9.81]}


@pytest.fixture(scope="module")
def walks(demos):
    return demos[:3]


@pytest.mark.parametrize("kind", DESIGNS)
def test_designs_stay_in_range_and_repeat(kind):
    params = tools.iez()
    values = design(params, RANGES, 50, kind, seed=3)
    count = 49 if kind == "grid" else 50
    for path, (low, high) in RANGES.items():
        assert values[path].shape == (count,)
        assert values[path].min() >= low * (1 - 1e-12)
        assert values[path].max() <= high * (1 + 1e-12)
        np.testing.assert_array_equal(values[path], design(params, RANGES, 50, kind, seed=3)[path])
    middle = np.median(np.log10(values["stance.shoe.threshold"]))
    assert middle == pytest.approx(7.5, abs=0.5)
    other = design(params, RANGES, 50, kind, seed=4)
    assert np.array_equal(other["gravity"], values["gravity"]) == (kind == "grid")


def test_a_grid_is_every_combination():
    values = design(tools.iez(), RANGES, 9, "grid")
    pairs = set(zip(np.round(values["stance.shoe.threshold"]), values["gravity"].round(9), strict=True))
    assert len(pairs) == 9
    np.testing.assert_allclose(np.unique(values["gravity"].round(9)), [9.79, 9.8, 9.81])
    np.testing.assert_allclose(np.unique(np.log10(values["stance.shoe.threshold"]).round(6)), [6, 7.5, 9])


def test_empty_range_is_the_bounds():
    spec = parameters.specs(tools.iez())["updates.zero_velocity"]
    values = design(tools.iez(), {"updates.zero_velocity": []}, 5, "grid")["updates.zero_velocity"]
    np.testing.assert_allclose(values[[0, -1]], [spec.low, spec.high])


@pytest.mark.parametrize(
    ("ranges", "count", "kind", "message"),
    [
        (RANGES, 8, "spiral", "design 'spiral' is unknown"),
        (RANGES, 0, "grid", "at least one parameter and one set"),
        ({}, 8, "grid", "at least one parameter and one set"),
        ({"gravity": [9.9, 9.8]}, 8, "grid", "runs from 9.9 down to 9.8"),
    ],
)
def test_wrong_designs_are_refused(ranges, count, kind, message):
    with pytest.raises(InputError, match=message):
        design(tools.iez(), ranges, count, kind)


def test_losses_equal_single_runs_in_blocks(walks, monkeypatch):
    """Five sets in blocks of two or so: the last block is not full."""
    monkeypatch.setattr("pedjax.sweeping.engine._LANES", 6)
    values = {
        "stance.shoe.threshold": np.array([1e6, 1e7, 8.5e7, 5e8, 2e9]),
        "updates.zero_velocity": np.array([0.003, 0.01, 0.03, 0.1, 0.01]),
    }
    calls = []
    found = sweep(walks, values, progress=lambda *a: calls.append(a))
    assert found.loss.shape == (5, 3)
    assert calls[-1] == (5, 5)
    assert len(calls) > 1
    assert found.names == tuple(r.name for r in walks)
    for s in range(5):
        params = parameters.replace(tools.iez(), {k: v[s] for k, v in values.items()})
        for r, recording in enumerate(walks):
            score = pedjax.evaluate(pedjax.run(recording, params=params), recording, "yaw_translation")
            assert found.loss[s, r] == pytest.approx(score.pyshoe_armse_m, abs=1e-9)
    assert found.best == int(np.argmin(found.loss.mean(axis=1)))
    np.testing.assert_allclose(found.mean, found.loss.mean(axis=1))


def test_wrong_sweeps_are_refused(walks):
    with pytest.raises(InputError, match="equally many values"):
        sweep(walks, {"gravity": np.ones(2), "updates.zero_velocity": np.ones(3)})
    with pytest.raises(InputError, match="is unknown"):
        sweep(walks, {"gravity": np.ones(2)}, loss="nonsense")
    with pytest.raises(InputError, match="at least two landmarks"):
        sweep([replace(walks[0], landmarks=None, truth=None)], {"gravity": np.full(2, 9.8)})
