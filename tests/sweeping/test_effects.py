"""Variance shares against functions whose Sobol' indices are known on paper."""

import numpy as np
import pytest
from scipy.stats import qmc

from pedjax.errors import InputError
from pedjax.sweeping.designs import Axis
from pedjax.sweeping.effects import coded, effects

A, B = 7.0, 0.1
VARIANCE = A**2 / 8 + B * np.pi**4 / 5 + B**2 * np.pi**8 / 18 + 0.5
ISHIGAMI_MAIN = np.array([0.5 * (1 + B * np.pi**4 / 5) ** 2, A**2 / 8, 0.0]) / VARIANCE
ISHIGAMI_PAIR = 8 * B**2 * np.pi**8 / 225 / VARIANCE


def points(count, dimensions, kind="sobol", seed=0):
    if kind == "sobol":
        return qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random_base2(int(np.log2(count)))
    if kind == "latin":
        return qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(count)
    return np.random.default_rng(seed).random((count, dimensions))


def ishigami(unit):
    x = np.pi * (2 * unit - 1)
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


def shares(unit, score, scale="linear", **kwargs):
    axes = [Axis(f"p{k}", "m", False, 0.0, 1.0) for k in range(unit.shape[1])]
    return effects({axis.path: unit[:, k] for k, axis in enumerate(axes)}, score, axes, scale=scale, **kwargs)


@pytest.mark.parametrize(
    ("kind", "count"), [("sobol", 128), ("random", 300), ("latin", 300), ("sobol", 8192)]
)
def test_ishigami(kind, count):
    unit = points(count, 3, kind)
    found = shares(unit, ishigami(unit))
    assert found.q2 > 0.999
    assert found.even
    np.testing.assert_allclose(found.main, ISHIGAMI_MAIN, atol=2e-3)
    np.testing.assert_allclose(found.pair[0, 2], ISHIGAMI_PAIR, atol=2e-3)
    np.testing.assert_allclose(found.total, ISHIGAMI_MAIN + ISHIGAMI_PAIR * np.array([1, 0, 1]), atol=3e-3)
    assert found.order == [0, 1, 2]


def test_ishigami_among_twenty_parameters():
    """Pairs of high degree are still found where there are 190 of them."""
    unit = points(1000, 20, "random")
    found = shares(unit, ishigami(unit))
    np.testing.assert_allclose(found.main[:3], ISHIGAMI_MAIN, atol=5e-3)
    np.testing.assert_allclose(found.pair[0, 2], ISHIGAMI_PAIR, atol=5e-3)
    assert found.total[3:].max() < 1e-3


def test_line_and_product_on_their_own_scales():
    """y = a + 2 b + 3 a c over (-1, 1)³ has variances 1/3, 4/3 and, for the pair, 1; c is on a log scale."""
    unit = points(64, 3)
    a, b, c = (2 * unit - 1).T
    axes = [Axis("a", "m", False, -1, 1), Axis("b", "m", False, -1, 1), Axis("c", "s", True, 1e-3, 1e3)]
    found = effects({"a": a, "b": b, "c": 10.0 ** (3 * c)}, 10 ** (a + 2 * b + 3 * a * c), axes)
    np.testing.assert_allclose(found.main, np.array([1, 4, 0]) / 8, atol=1e-6)
    np.testing.assert_allclose(found.pair[0, 2], 3 / 8, atol=1e-6)
    assert found.degree <= 3


def test_noise_is_unexplained():
    """Half the variance is noise: neither shared out to parameters nor counted as predicted."""
    unit = points(4096, 4)
    signal = np.sqrt(12) * (unit[:, 0] - 0.5)
    found = shares(unit, signal + np.random.default_rng(3).standard_normal(4096))
    assert found.q2 == pytest.approx(0.5, abs=0.03)
    assert found.unexplained == pytest.approx(0.5, abs=0.03)
    assert found.total[1:].max() < 0.01
    upper = found.main.sum() + np.triu(found.pair).sum() + found.unexplained
    assert upper == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("count", "dimensions"), [(32, 3), (128, 20)])
def test_pure_noise_is_not_explained(count, dimensions):
    unit = points(count, dimensions)
    found = shares(unit, np.random.default_rng(8).standard_normal(count))
    assert found.total.max() < 0.2
    assert "too few" in found.note


def test_three_at_once_are_unexplained():
    unit = points(2048, 3)
    found = shares(unit, np.prod(2 * unit - 1, axis=1))
    assert found.unexplained > 0.95
    assert found.total.max() < 0.05


def test_grid_gives_the_shares_over_the_grid():
    steps = np.linspace(-1, 1, 5)
    x = np.stack([axis.ravel() for axis in np.meshgrid(steps, steps, steps)], axis=1)
    axes = [Axis(f"p{k}", "m", False, -1, 1) for k in range(3)]
    score = x[:, 0] + 2 * x[:, 1] + 3 * x[:, 0] * x[:, 2]
    found = effects({f"p{k}": x[:, k] for k in range(3)}, score, axes, scale="linear")
    v = np.mean(steps**2)
    truth = np.array([v, 4 * v, 0, 9 * v**2]) / (5 * v + 9 * v**2)
    np.testing.assert_allclose([*found.main, found.pair[0, 2]], truth, atol=1e-6)


def test_settings_are_categories():
    """y = a + 2 [rule is soft] + a [switch on]: every share on paper, uneven levels none."""
    n = 600
    a = points(1024, 1)[:n, 0]
    rule = np.array(["hard", "soft", "none"], object)[np.arange(n) % 3]
    switch = np.arange(n) // 3 % 2 == 0
    score = a + 2 * (rule == "soft") + (a - 0.5) * switch
    axes = [Axis("a", "m", False, 0, 1)]
    settings = {"rule": ["hard", "soft", "none"], "switch": [True, False]}
    found = effects({"a": a, "rule": rule, "switch": switch}, score, axes, settings, scale="linear")
    parts = np.array([1.5**2 / 12, 4 * 2 / 9, 0.0, 0.25 / 12])
    truth = parts / parts.sum()
    np.testing.assert_allclose([*found.main, found.pair[0, 2]], truth, atol=5e-3)


def test_diverged_runs_are_counted_and_left_out():
    unit = points(512, 3)
    score = ishigami(unit)
    lost = np.random.default_rng(1).random(512) < 0.2
    score[lost] = np.where(np.arange(lost.sum()) % 2, np.nan, np.inf)
    found = shares(unit, score)
    assert (found.runs, found.diverged, found.used) == (512, lost.sum(), 512 - lost.sum())
    np.testing.assert_allclose(found.main, ISHIGAMI_MAIN, atol=5e-3)


def test_a_lost_half_leaves_shares_over_the_other():
    """Above one half every run diverged; over what is left the first parameter spans half as much."""
    unit = points(1024, 2)
    found = shares(unit, np.where(unit[:, 0] > 0.5, np.nan, 2 * unit[:, 0] + unit[:, 1]))
    np.testing.assert_allclose(found.main, [0.5, 0.5], atol=0.01)


def test_parameters_that_vary_together_are_said_to():
    z = np.random.default_rng(0).standard_normal((500, 2))
    a, b = z[:, 0], 0.9 * z[:, 0] + 0.4 * z[:, 1]
    axes = [Axis("a", "m", False, a.min(), a.max()), Axis("b", "m", False, b.min(), b.max())]
    found = effects({"a": a, "b": b}, a + b, axes, scale="linear")
    assert not found.even
    assert "independently" in found.note
    assert found.main.sum() + found.pair[0, 1] == pytest.approx(1.0, abs=0.01)


def test_repeated_runs_do_not_vouch_for_themselves():
    """Twenty runs of noise, each fifty times: a run left out must not be predicted by its own copy."""
    unit = points(16, 2)
    noise = np.random.default_rng(5).standard_normal(16)
    found = shares(np.tile(unit, (50, 1)), np.tile(noise, 50))
    assert found.used == 16
    assert found.q2 < 0.3


def test_too_few_and_constant():
    unit = points(8, 2)
    few = shares(unit, unit[:, 0])
    assert np.isnan(few.main).all()
    assert "too few" in few.note
    flat = shares(points(64, 2), np.full(64, 0.3))
    assert not flat.total.any()
    assert flat.unexplained == 0
    assert "same" in flat.note
    one = shares(points(64, 1), np.exp(points(64, 1)[:, 0]))
    np.testing.assert_allclose(one.main, [1.0], atol=1e-6)


def test_a_parameter_held_fixed_explains_nothing():
    unit = points(64, 2)
    unit[:, 1] = 0.4
    np.testing.assert_allclose(shares(unit, unit[:, 0]).total, [1, 0], atol=1e-6)


def test_same_seed_same_shares():
    unit = points(64, 3)
    one, two = shares(unit, ishigami(unit), seed=4), shares(unit, ishigami(unit), seed=4)
    assert (one.total == two.total).all()
    assert one.q2 == two.q2


def test_bad_input_is_said():
    unit = points(16, 1)
    with pytest.raises(InputError, match="did you mean 'linear'"):
        shares(unit, unit[:, 0], scale="liner")
    with pytest.raises(InputError, match="log scale"):
        effects({"a": unit[:, 0] - 0.5}, unit[:, 0], [Axis("a", "m", True, 0.1, 1.0)])
    with pytest.raises(InputError, match="nothing was swept"):
        effects({}, unit[:, 0], [])


def test_coded_keeps_the_known_order():
    labels, index = coded(np.array(["b", "c", "b", "a"], object), ["a", "b"])
    assert labels == ["a", "b", "c"]
    assert index.tolist() == [1, 2, 1, 0]
