"""Bands, areas and their differences against drawing walks one by one and integrating by hand, and how often
they hold the truth of made-up sets."""

import numpy as np
import pytest
from scipy.special import expit, logit, ndtr, ndtri

from pedjax.detection import roc
from pedjax.detection.bands import (
    Labelled,
    areas,
    banded,
    compare,
    detection_at,
    difference,
    draw,
    rate,
)
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
    for times, auc, partial in zip([np.ones(5), *draws], *found.drawn, strict=True):
        again = _again(statistics, labels, times)
        assert auc == pytest.approx(oracle.roc(*again)["auc"], abs=1e-12)
        curve = roc(*again)
        if partial in found.drawn[1, :2]:  # stepping takes its time
            assert partial == pytest.approx(_partial(curve, 0.2), abs=1e-4)
        alarm, detected = np.append(0.0, curve.p_false_alarm), np.append(0.0, curve.p_detection)
        heights.append([_height(alarm, detected, x + 1e-12) for x in found.band.p_false_alarm])
    assert found.auc.value == roc(np.concatenate(statistics), np.concatenate(labels)).auc
    positive, negative = sum(y.sum() for y in labels), sum((~y).sum() for y in labels)
    half = 0.5 / np.sqrt(positive * negative)
    np.testing.assert_allclose(found.auc[1:], _by_t(found.drawn[0], half), rtol=1e-9)
    half = 0.5 / min(positive, negative)
    np.testing.assert_allclose(found.partial[1:], _by_t(found.drawn[1], half), rtol=1e-9)
    low, high = np.transpose([_by_t(height, 0.5 / positive) for height in np.transpose(heights)])
    low[found.band.p_false_alarm == 1] = 1
    low = [min(low[: k + 1].max(), y) for k, y in enumerate(found.band.p_detection)]
    np.testing.assert_allclose(found.band.low, low, atol=1e-9)
    np.testing.assert_allclose(found.band.high, [high[k:].min() for k in range(len(high))], atol=1e-9)


T_OF_FOUR = 2.7764451052
"""Two-sided 95 % point of Student's t with four degrees of freedom, from tables."""


def _by_t(drawn, half):
    """Low and high of five walks from values of every walk once and of each draw: the logit of each
    probability with half a window on either side."""
    value = logit((drawn + half) / (1 + 2 * half))
    spread = max(
        np.sqrt(np.mean((value[1:] - value[0]) ** 2) * 5 / 4),
        half / (drawn[0] + half) + half / (1 - drawn[0] + half),
    )
    ends = expit(value[0] + np.array([-1, 1]) * T_OF_FOUR * spread)
    return (ends * (1 + 2 * half) - half).clip(0, 1)


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
    labels = [rng.random(4000) < 0.3 for _ in range(5)]
    statistics = [rng.normal(size=4000) + 1.5 * ~y for y in labels]
    draws = draw(5, 50)
    thin, whole = (banded(statistics, labels, draws, most=most) for most in (1000, 10**6))
    assert len(thin.band.threshold) <= 1000 < len(whole.band.threshold)
    np.testing.assert_allclose(thin.drawn, whole.drawn, atol=3e-4)
    np.testing.assert_allclose(thin.auc, whole.auc, atol=3e-5)


def test_thinning_shifts_no_interval_off_its_estimate(rng):
    """At 30 points the drawn areas all lie below the exact one, by far more than they spread."""
    labels = [np.arange(2000) < 600 for _ in range(6)]
    quantile = ndtri((np.arange(600) + 0.5) / 600), ndtri((np.arange(1400) + 0.5) / 1400) + 3
    statistics = [np.concatenate(quantile) + 1e-3 * rng.normal() for _ in labels]
    draws = draw(6, 100)
    thin, whole = (banded(statistics, labels, draws, most=most) for most in (30, 10**6))
    assert thin.drawn[0].max() < thin.auc.low < thin.auc.value < thin.auc.high
    np.testing.assert_allclose(thin.auc, whole.auc, atol=2e-4)
    assert (thin.band.low <= thin.band.p_detection).all()
    assert (thin.band.p_detection <= thin.band.high).all()


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
    drawn = one.drawn[0] - other.drawn[0]
    reach = T_OF_FOUR * np.sqrt(np.mean((drawn[1:] - drawn[0]) ** 2) * 5 / 4)
    np.testing.assert_allclose(apart[1:], [apart.value - reach, apart.value + reach], atol=1e-9)


@pytest.mark.parametrize("count", [1, 4])
def test_fewer_than_five_walks_have_no_interval(walks, count):
    statistics, labels = walks
    found = banded(statistics[:count], labels[:count], draw(count, 10))
    assert np.isfinite(found.auc.value)
    assert found.walks == count
    assert np.isnan([*found.auc[1:], *found.partial[1:], *found.band.low, *found.band.high]).all()
    assert str(found.auc).endswith(" [?]")
    assert np.isnan([end for each in difference(found, found) for end in each[1:]]).all()


def test_without_a_single_error_an_interval_goes_down_from_one():
    """To 1 - 3 / N for N windows of many walks, as if these were drawn one by one, and further for few."""
    lows = []
    for walks in (5, 12, 400):
        labels = [np.arange(30) < 10] * walks
        statistics = [np.where(y, 0.0, 1.0) + 0.01 * np.arange(30) for y in labels]
        found = banded(statistics, labels, draw(walks, 20))
        assert found.auc.value == found.auc.high == found.partial.value == found.partial.high == 1
        assert found.partial.low < found.auc.low < 1
        lows.append(10 * walks * (1 - found.partial.low))
        band = found.band
        assert (band.low <= band.p_detection).all()
        assert (band.p_detection <= band.high).all()
        assert band.low[-1] == band.high[-1] == 1
        assert 0.5 < band.low[-2] < 1
        assert difference(found, found)[0] == (0.0, 0.0, 0.0)
    assert 6 < lows[0] < 7
    assert 3.5 < lows[1] < 4.5
    assert lows[2] == pytest.approx(3, abs=0.1)


def test_a_rate_has_the_same_interval():
    """Of five walks with as many windows each it is a mean, whose spread over draws is known."""
    hits, count = np.array([6.0, 7.0, 5.0, 8.0, 4.0]), np.full(5, 10.0)
    draws = draw(5, 20000)
    value, low, high = rate(hits, count, draws)
    assert value == 0.6
    spread = np.std(hits / count, ddof=1) / np.sqrt(5)
    ends = expit(logit(0.6) + np.array([-1, 1]) * T_OF_FOUR * spread / 0.24)
    np.testing.assert_allclose([low, high], ends, atol=0.01)
    assert np.isnan(rate(hits[:4], count[:4], draws[:, :4])[1:]).all()
    assert np.isnan(rate(0 * hits, 0 * count, draws)).all()


def test_draws_without_both_labels_count_for_nothing(rng):
    labels = [np.arange(9) < 4, *[np.arange(9) > 5] * 4, *[np.zeros(9, bool)] * 9]
    statistics = [rng.normal(size=9) for _ in labels]
    draws = draw(14, 300)
    found = banded(statistics, labels, draws)
    without = draws[:, :5].sum(axis=1) == 0
    assert without.any()
    assert (np.isnan(found.drawn[0, 1:]) == without).all()
    assert found.walks == 5
    assert np.isfinite(found.auc).all()
    found = banded(statistics[1:], labels[1:], draw(13, 300))
    assert found.walks == 4
    assert np.isnan(found.auc.low)  # windows of one label alone make no walk


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


SETS, DRAWS, UPTO = 200, 200, 0.1
AT = np.array([0.02, 0.05, 0.1, 0.3])
"""Probabilities of false alarm at which bands are looked at."""

APART = 2.2, 1.8
"""Mean statistic of the windows not looked for, of two detectors; it is 0 of those looked for."""

WALK = 0.5
"""Standard deviation of what the windows of a walk have in common; their own is 1."""


def _made_up(rng, count):
    """Statistics of two detectors that go together, `(2, windows)` a walk, and labels. What a walk's windows
    have in common is in part common to both labels."""
    statistics, labels = [], []
    for _ in range(count):
        positive, negative = rng.integers(10, 60, 2)
        label = np.arange(positive + negative) < positive
        both, own, window = (_paired(rng, n) for n in (1, 2, len(label)))
        common = WALK * (np.sqrt(0.3) * both + np.sqrt(0.7) * own[:, label.astype(int)])
        statistics.append(window + common + np.array(APART)[:, None] * ~label)
        labels.append(label)
    return statistics, labels


def _paired(rng, count):
    """Standard normal `(2, count)`, whose rows correlate by 0.7."""
    first, other = rng.normal(size=(2, count))
    return np.stack([first, 0.7 * first + np.sqrt(1 - 0.7**2) * other])


def _truth(apart):
    """Area and partial area."""
    mean = np.mean(_detection(apart, (np.arange(20000) + 0.5) * UPTO / 20000))
    partial = (mean - UPTO / 2) / (1 - UPTO / 2)
    return np.array([ndtr(apart / np.sqrt(2 + 2 * WALK**2)), (1 + partial) / 2])


def _detection(apart, alarm):
    """At probabilities of false alarm; over all walks both labels are normal with the same deviation."""
    return ndtr(apart / np.sqrt(1 + WALK**2) + ndtri(alarm))


@pytest.mark.parametrize(("count", "seed"), [(5, 40503), (8, 40803), (12, 41203)])
def test_intervals_hold_their_estimate_always_and_the_truth_as_often_as_said(count, seed):
    rng = np.random.default_rng(seed)
    best, second = map(_truth, APART)
    truth = [*best, *(best - second)]
    held = []
    for _ in range(SETS):
        statistics, labels = _made_up(rng, count)
        draws = draw(count, DRAWS, int(rng.integers(2**32)))
        one, other = (banded([t[k] for t in statistics], labels, draws, upto=UPTO, most=150) for k in (0, 1))
        intervals = [one.auc, one.partial, *difference(one, other)]
        for value, low, high in intervals:
            assert low <= value <= high
        band = one.band
        assert (band.low <= band.p_detection).all()
        assert (band.p_detection <= band.high).all()
        inside = [x.low <= y <= x.high for x, y in zip(intervals, truth, strict=True)]
        alarm = band.p_false_alarm[np.searchsorted(band.p_false_alarm, AT)]  # a point at or after each
        top = np.searchsorted(band.p_false_alarm, alarm, "right") - 1
        detected = _detection(APART[0], alarm)
        held.append([*inside, *((band.low[top] <= detected) & (detected <= band.high[top]))])
    share = np.mean(held, axis=0)
    names = ("area", "partial", "less", "partial less", *(f"detection at {x}" for x in AT))
    told = {name: float(x) for name, x in zip(names, share, strict=True)}
    assert ((share >= 0.9) & (share <= 0.99)).all(), told
