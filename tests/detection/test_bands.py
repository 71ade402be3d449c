"""Bands, areas and their differences against drawing walks one by one and integrating by hand."""

import numpy as np
import pytest

from pedjax.detection import roc
from pedjax.detection.bands import Labelled, areas, banded, compare, detection_at, difference, draw
from tests.reference import evaluation as oracle


@pytest.fixture(params=["distinct", "ties", "missing"])
def walks(request, rng):
    labels = [rng.random(n) < 0.4 for n in (30, 50, 20, 41, 35)]
    statistics = [rng.normal(size=len(y)) + (0.8 + 0.3 * k) * ~y for k, y in enumerate(labels)]
    if request.param == "ties":
        statistics = [np.round(t) for t in statistics]
    if request.param == "missing":
        statistics[1][:4], statistics[2][:3] = np.nan, np.inf
    return statistics, labels


def _again(statistics, labels, times):
    """The statistic and labels of a draw, walk by walk as often as it was drawn."""
    order = np.repeat(np.arange(len(times)), times.astype(int))
    return np.concatenate([statistics[k] for k in order]), np.concatenate([labels[k] for k in order])


def _partial(curve, upto):
    """By stepping along the curve in very small steps, then McClish's scale."""
    alarm, found = np.append(0.0, curve.p_false_alarm), np.append(0.0, curve.p_detection)
    fine = (np.arange(20000) + 0.5) * upto / 20000
    area = np.mean([_height(alarm, found, x) for x in fine]) * upto
    return 0.5 * (1 + (area - upto**2 / 2) / (upto - upto**2 / 2))


def _height(alarm, found, x):
    before = np.flatnonzero(alarm <= x)[-1]
    if before == len(alarm) - 1:
        return found[before]
    part = (x - alarm[before]) / (alarm[before + 1] - alarm[before])
    return found[before] + part * (found[before + 1] - found[before])


def test_every_draw_equals_the_curve_of_its_walks(walks):
    statistics, labels = walks
    draws = draw(5, 40, seed=3)
    assert (draws.sum(axis=1) == 5).all()
    found = banded(statistics, labels, draws, upto=0.2)
    heights = []
    for times, auc, partial in zip(draws, *found.drawn, strict=True):
        again = _again(statistics, labels, times)
        assert auc == pytest.approx(oracle.roc(*again)["auc"], abs=1e-12)
        curve = roc(*again)
        if partial == found.drawn[1, 0]:
            assert partial == pytest.approx(_partial(curve, 0.2), abs=1e-4)
        alarm, detected = np.append(0.0, curve.p_false_alarm), np.append(0.0, curve.p_detection)
        heights.append([_height(alarm, detected, x + 1e-12) for x in found.band.p_false_alarm])
    low, high = np.percentile(heights, [2.5, 97.5], axis=0)
    np.testing.assert_allclose(found.band.low, low, atol=1e-9)
    np.testing.assert_allclose(found.band.high, high, atol=1e-9)
    assert found.auc.value == roc(np.concatenate(statistics), np.concatenate(labels)).auc
    np.testing.assert_allclose(found.auc[1:], np.percentile(found.drawn[0], [2.5, 97.5]))


def test_areas_by_chance_and_at_best():
    chance = np.linspace(0, 1, 50)[None]
    np.testing.assert_allclose(areas(chance, chance, 0.13), [[0.5], [0.5]], atol=1e-12)
    best = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 1.0]])
    np.testing.assert_allclose(areas(*best, 0.13), [[1.0], [1.0]], atol=1e-12)


def test_detection_is_read_at_the_top_of_a_rise():
    alarm, found = np.array([[0.0, 0.2, 0.2, 1.0]]), np.array([[0.0, 0.1, 0.7, 1.0]])
    read = detection_at(alarm, found, np.array([0.0, 0.1, 0.2, 0.6, 1.0]))
    np.testing.assert_allclose(read, [[0.0, 0.05, 0.7, 0.85, 1.0]])


def test_thinned_curves_have_the_same_areas(rng):
    labels = [rng.random(4000) < 0.3 for _ in range(4)]
    statistics = [rng.normal(size=4000) + 1.5 * ~y for y in labels]
    draws = draw(4, 50)
    thin, whole = (banded(statistics, labels, draws, most=most) for most in (1000, 10**6))
    assert len(thin.band.threshold) <= 1000 < len(whole.band.threshold)
    np.testing.assert_allclose(thin.drawn, whole.drawn, atol=3e-4)


def test_differences_are_paired(walks):
    statistics, labels = walks
    draws = draw(5, 200)
    one = banded(statistics, labels, draws)
    same = banded([3 * t + 1 for t in statistics], labels, draws)
    assert difference(one, same)[0] == (0.0, 0.0, 0.0)
    noise = [t + 0.05 * np.sin(37 * np.arange(len(t))) for t in statistics]
    other = banded(noise, labels, draws)
    apart = difference(one, other)[0]
    assert apart.high - apart.low < 0.5 * (one.auc.high - one.auc.low)
    np.testing.assert_allclose(apart[1:], np.percentile(one.drawn[0] - other.drawn[0], [2.5, 97.5]))


def test_one_walk_has_no_interval(walks):
    statistics, labels = walks
    found = banded(statistics[:1], labels[:1], draw(1, 10))
    assert np.isfinite(found.auc.value)
    assert np.isnan([*found.auc[1:], *found.partial[1:], *found.band.low]).all()
    assert np.isnan(difference(found, found)[0].low)


def test_draws_without_both_labels_count_for_nothing(rng):
    labels = [np.arange(9) < 4, np.arange(9) > 5, np.zeros(9, bool), np.zeros(9, bool)]
    statistics = [rng.normal(size=9) for _ in labels]
    draws = draw(4, 300)
    found = banded(statistics, labels, draws)
    assert (np.isnan(found.drawn[0]) == (draws[:, :2].sum(axis=1) == 0)).all()
    assert np.isfinite(found.auc).all()
    found = banded(statistics[1:], labels[1:], draw(3, 300))
    assert np.isnan(found.auc.low)  # one walk alone has them


def test_parts_without_both_labels_are_left_out(walks):
    statistics, labels = walks
    whole = [np.full(len(y), True) for y in labels]
    given = Labelled({"a": statistics}, labels, {"all": whole, "yes": labels, "half": [
        np.arange(len(y)) % 2 == 0 for y in labels
    ]})  # fmt: skip
    found = compare(given, draws=50)
    assert list(found) == ["all", "half"]
    assert (
        found["half"]["a"].roc.auc
        == roc(np.concatenate([t[::2] for t in statistics]), np.concatenate([y[::2] for y in labels])).auc
    )
