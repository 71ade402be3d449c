"""Ellipsoids against closed forms, Ma's table 1, and fits by other routes; degenerate clouds; slopes."""

import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.calibration import ellipsoid
from pedjax.calibration.magnetometer import apply, uncalibrated
from tests.calibration.common import (
    B_C,
    FITS,
    K_C,
    STRENGTH,
    assert_slopes,
    directions,
    factor,
    quality,
    refine,
    sloped,
    table_one,
)
from tests.reference import calibration as reference

TRUE_SHAPE = K_C.T @ K_C / STRENGTH**2
OTHERS = {"algebraic": reference.quadric, "clsef": reference.fang, "li-griffiths": reference.li_griffiths}


@pytest.mark.parametrize("method", list(FITS))
def test_without_noise_the_ellipsoid_is_recovered(rng, method):
    points = table_one(rng, 500, 0.0)
    found = FITS[method](points)
    assert found.positive
    for fit in (found, refine(found, points)):
        np.testing.assert_allclose(fit.centre, B_C, rtol=1e-9)
        np.testing.assert_allclose(factor(fit, STRENGTH, form="upper"), K_C, atol=1e-9)
    k = factor(found, STRENGTH)
    np.testing.assert_allclose(k, k.T, atol=1e-14)
    np.testing.assert_allclose(k @ k, K_C.T @ K_C, atol=1e-9)


@pytest.mark.parametrize("method", list(FITS))
def test_table_one_of_ma_with_noise(method):
    """2 mGs of noise, 500 points, 40 clouds: mean errors of hard iron (mGs) and of the largest entry of K."""
    rng, offset, matrix = np.random.default_rng(4), [], []
    for _ in range(40):
        found = FITS[method](table_one(rng, 500, 2.0))
        offset.append(np.linalg.norm(found.centre - B_C))
        matrix.append(np.abs(factor(found, STRENGTH, form="upper") - K_C).max())
    assert np.mean(offset) < 0.3
    assert np.mean(matrix) < 0.0013


@pytest.mark.parametrize("method", list(FITS))
def test_fits_equal_the_reference(rng, method):
    for count, noise in ((500, 2.0), (40, 20.0)):
        points = table_one(rng, count, noise)
        centre, w = OTHERS[method](points)
        found = FITS[method](points)
        np.testing.assert_allclose(found.centre, centre, rtol=1e-7)
        np.testing.assert_allclose(found.shape, w, rtol=1e-6, atol=1e-12)


def test_refinement_equals_the_reference(rng):
    points = table_one(rng, 60, 10.0)
    start = FITS["algebraic"](points)
    centre, w = reference.geometric(points, np.asarray(start.centre), np.asarray(start.shape))
    found = refine(start, points)
    np.testing.assert_allclose(found.centre, centre, rtol=1e-6)
    np.testing.assert_allclose(found.shape, w, rtol=1e-5, atol=1e-12)
    from_far = refine(FITS["li-griffiths"](points), points)
    np.testing.assert_allclose(from_far.centre, found.centre, rtol=1e-9)


def test_a_far_centre_does_not_matter(rng):
    """A phone carries nine times the earth's field (without centring an algebraic fit suffers)."""
    near = table_one(rng, 60, 5.0)
    far = near + np.array([5e4, -3e4, 4e4])
    for fit in FITS.values():
        np.testing.assert_allclose(fit(far).shape, fit(near).shape, rtol=1e-6, atol=1e-13)
        np.testing.assert_allclose(fit(far).centre - fit(near).centre, [5e4, -3e4, 4e4], rtol=1e-9)


def test_factors_and_strength(rng):
    found = FITS["algebraic"](table_one(rng, 60, 0.0))
    strength = STRENGTH / np.linalg.det(K_C) ** (1 / 3)
    np.testing.assert_allclose(ellipsoid.strength(found), strength, rtol=1e-9)
    for form in ellipsoid.FACTORS:
        np.testing.assert_allclose(np.linalg.det(factor(found, form=form)), 1.0, rtol=1e-9)
    assert np.abs(np.tril(factor(found, form="upper"), -1)).max() == 0
    with pytest.raises(ValueError, match="lower"):
        ellipsoid.factor(found, form="lower")


def test_quality(rng):
    axes, centre = np.array([30.0, 40.0, 60.0]), np.array([1.0, -2.0, 3.0])
    points = directions(rng, 500) * axes + centre
    found = FITS["algebraic"](points)
    told = quality(found, points)
    np.testing.assert_allclose(told.axes, axes, rtol=1e-9)
    assert told.residual < 1e-8
    np.testing.assert_allclose(told.coverage, 1 / 3, atol=0.05)
    np.testing.assert_allclose(told.flatness, 900 / (900 + 1600 + 3600), atol=0.02)
    cap = points[points[:, 2] > 60]
    assert quality(FITS["algebraic"](cap), cap).coverage < 0.02
    assert quality(FITS["algebraic"](cap), cap).condition > 30 * told.condition


def test_weights(rng):
    points = table_one(rng, 40, 10.0)
    twice = FITS["algebraic"](np.concatenate([points, points[:9]]))
    weighted = FITS["algebraic"](points, weights=np.array([2.0] * 9 + [1.0] * 31))
    np.testing.assert_allclose(weighted.centre, twice.centre, rtol=1e-9)


def test_single_precision(rng):
    points = 0.1 * table_one(rng, 60, 2.0)
    for fit in FITS.values():
        single, double = fit(points.astype(np.float32)), fit(points)
        assert single.centre.dtype == single.shape.dtype == jnp.float32
        np.testing.assert_allclose(single.centre, double.centre, atol=1e-3)
    single = refine(single, points.astype(np.float32))
    np.testing.assert_allclose(single.centre, refine(double, points).centre, atol=1e-3)


def _told(fit, refined):
    def function(x, w):
        found = ellipsoid.refine(fit(x, w), x, w) if refined else fit(x, w)
        told = ellipsoid.quality(found, 1.02 * x + jnp.array([1.0, 2.0, 0.0]), w)
        factors = [100 * ellipsoid.factor(found).ravel(), ellipsoid.factor(found, 50.0, "upper").ravel()]
        rest = jnp.stack([told.residual, told.coverage, told.flatness])
        return jnp.concatenate([found.centre, *factors, rest]), (found, told)

    return sloped(function)


SLOPES = {name: _told(fit, False) for name, fit in ellipsoid.FITS.items()}
SLOPES["refined"] = _told(ellipsoid.algebraic, True)


@pytest.mark.parametrize("method", list(SLOPES))
def test_slopes(rng, method):
    assert_slopes(SLOPES[method], table_one(rng, 30, 10.0), 24, rng, h=1e-3)


@pytest.mark.parametrize("method", list(SLOPES))
def test_slopes_on_a_sphere(rng, method):
    """Where all half axes are equal, eigenvectors have no derivative, but these fits have."""
    assert_slopes(SLOPES[method], 45 * directions(rng, 30), 24, rng, h=1e-3, rtol=1e-5)


SPHERE = 45 * directions(np.random.default_rng(0), 30)
LOW = 0.1 * SPHERE[:, :2]
CLOUDS = {
    "sphere": SPHERE,
    "plane": SPHERE * [1, 1, 0] + [0, 0, 3],
    "line": SPHERE * [1, 0, 0],
    "constant": np.tile([20.0, 3.0, -40.0], (30, 1)),
    "zero": np.zeros((30, 3)),
    "cap": np.column_stack([LOW, np.sqrt(45**2 - np.sum(LOW**2, axis=1))]),
    "eight": np.concatenate([SPHERE[:8], np.full((22, 3), np.nan)]),
}


@pytest.mark.parametrize("case", list(CLOUDS))
@pytest.mark.parametrize("method", list(SLOPES))
def test_degenerate_clouds(case, method):
    points = CLOUDS[case]
    known = np.isfinite(points).all(axis=1).astype(float)
    (value, (found, told)), slopes = SLOPES[method](points, known, np.ones(24))
    assert np.isfinite(value)
    assert np.isfinite(found.centre).all()
    assert np.isfinite(found.shape).all()
    assert all(np.isfinite(s).all() for s in slopes)
    if case in ("sphere", "cap"):
        assert found.positive
        np.testing.assert_allclose(found.centre, 0, atol=1e-4)
    if case in ("plane", "line", "constant", "zero"):
        assert told.flatness < 1e-9
    if case == "constant":
        assert not found.positive


def test_apply(rng):
    points = table_one(rng, 50, 0.0)
    found = FITS["algebraic"](points)
    k = factor(found, STRENGTH)
    whole = uncalibrated()._replace(hard_iron=found.centre, matrix=k)
    np.testing.assert_allclose(np.linalg.norm(apply(whole, points), axis=1), STRENGTH, rtol=1e-9)
    np.testing.assert_allclose(apply(whole, points[3]), k @ (points[3] - B_C), atol=1e-6)
    np.testing.assert_array_equal(apply(uncalibrated(), points), points)
