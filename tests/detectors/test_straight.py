"""Straight walking against naive loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.detectors import straight
from pedjax.detectors.straight import STRAIGHT_DETECTORS, Straight
from pedjax.gates import gate
from tests.reference import heading as naive

NAIVE = {"change": naive.change, "spread": naive.spread}
LANES, STRIDES = 30, 4


@pytest.fixture(scope="module")
def headings():
    """Strides `(STRIDES + 1, L)`: gentle and wild ones about every direction, half a turn too."""
    rng = np.random.default_rng(8)
    about = np.where(np.arange(LANES) % 3 == 0, np.pi, rng.uniform(-np.pi, np.pi, LANES))
    found = about + rng.normal(0, 1, (STRIDES + 1, LANES)) * rng.choice([0.02, 0.1, 0.5], LANES)
    return np.arctan2(np.sin(found), np.cos(found))


def chosen(detector, **own):
    return parameters.replace(Straight(), {"detector": detector, "strides": STRIDES, **own})


ratio = jax.jit(straight.log_ratio)


def looped(detector, headings):
    return np.array([NAIVE[detector](list(each)) for each in headings.T])


def test_circular_mean_across_half_a_turn():
    for about in (np.pi, -np.pi, 0.0, 1.0):
        found = straight.circular_mean([jnp.asarray(about + x) for x in (0.1, -0.1, 0.05, -0.05)])
        assert np.abs(np.exp(1j * float(found)) - np.exp(1j * about)) < 1e-9
    one = [jnp.asarray([np.pi - 0.1, 0.3]), jnp.asarray([0.1 - np.pi, 0.5])]
    np.testing.assert_allclose(np.abs(straight.circular_mean(one)), [np.pi, 0.4], atol=1e-9)


@pytest.mark.parametrize("detector", STRAIGHT_DETECTORS)
def test_statistics_equal_loops(headings, detector):
    p = chosen(detector)
    expected = looped(detector, headings)
    np.testing.assert_allclose(jax.jit(straight.statistic)(p, tuple(headings)), expected, rtol=1e-7)
    np.testing.assert_allclose(np.exp(ratio(p, tuple(headings))), expected / p.angle, rtol=1e-7)
    np.testing.assert_array_equal(gate(ratio(p, tuple(headings)), 0.0), expected < p.angle)
    assert 0.1 < np.mean(expected < p.angle) < 0.9
    half = (expected / p.angle) ** 2  # 1 / width
    np.testing.assert_allclose(gate(ratio(p, tuple(headings)), 0.5), 1 / (1 + half), rtol=1e-6)


@pytest.mark.parametrize("detector", STRAIGHT_DETECTORS)
def test_a_turn_of_all_changes_nothing(headings, detector):
    p = chosen(detector)
    for turn in (1.0, np.pi):
        turned = tuple(np.arctan2(np.sin(headings + turn), np.cos(headings + turn)))
        np.testing.assert_allclose(ratio(p, turned), ratio(p, tuple(headings)), atol=1e-9)


def test_a_slow_curve_is_seen_by_the_spread_and_a_bend_by_both():
    p = {name: chosen(name, strides=6, angle=0.1) for name in STRAIGHT_DETECTORS}
    curve = tuple(jnp.asarray(0.04 * k) for k in range(7))
    assert ratio(p["spread"], curve) > 0
    bend = (*(jnp.asarray(3.1),) * 6, jnp.asarray(-2.9))
    assert all(ratio(q, bend) > 0 for q in p.values())
    drift = tuple(jnp.asarray(0.01 * k) for k in range(7))
    assert all(ratio(q, drift) < 0 for q in p.values())


@pytest.mark.parametrize("detector", STRAIGHT_DETECTORS)
def test_slopes_through_the_soft_gate(headings, detector):
    p = chosen(detector)

    @jax.jit
    def value(angle, given):
        return jnp.sum(gate(straight.log_ratio(parameters.with_leaves(p, {"angle": angle}), given), 0.5))

    given, angle, h = tuple(jnp.asarray(x) for x in headings), jnp.asarray(0.07), 1e-6
    by_angle, by_heading = jax.grad(value, (0, 1))(angle, given)
    difference = (value(angle + h, given) - value(angle - h, given)) / (2 * h)
    assert by_angle == pytest.approx(float(difference), rel=1e-6)
    for k in (0, STRIDES):
        for lane in (0, 7):
            up, down = ((*given[:k], given[k].at[lane].add(s), *given[k + 1 :]) for s in (h, -h))
            difference = (value(angle, up) - value(angle, down)) / (2 * h)
            assert by_heading[k][lane] == pytest.approx(float(difference), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("detector", STRAIGHT_DETECTORS)
def test_slopes_are_finite_everywhere(detector, dtype):
    p = parameters.cast(chosen(detector), dtype)
    cases = [[0.0] * 5, [np.pi] * 5, [0.0, np.pi, 0.0, np.pi, 1.0], [0.0, np.pi / 2, np.pi, -np.pi / 2, 0.3]]
    given = tuple(jnp.asarray(x, dtype) for x in np.transpose(cases))
    for width in (0.0, 0.5):
        slopes = jax.grad(lambda x, w=width: jnp.sum(gate(straight.log_ratio(p, x), w)))(given)
        assert np.isfinite(slopes).all()
