"""Levelled fields against rotated fields; means over stances; slopes."""

import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.calibration import levelling
from pedjax.detectors.field import inclination
from tests.calibration.common import assert_slopes, sloped
from tests.reference.calibration import attitudes, earth, turn

G = np.array([0, 0, 9.81])


def test_field_and_inclination_of_a_tilted_body():
    roll, pitch, yaw, declination, dip = np.deg2rad([17.0, -23.0, 63.0, 5.0, 64.0])
    c = turn(roll, pitch, yaw)
    force, mag = c.T @ G, c.T @ earth(declination, dip, 48.0)
    np.testing.assert_allclose(levelling.roll_pitch(force), [roll, pitch], atol=1e-14)
    levelled = levelling.level(force, mag)
    np.testing.assert_allclose(inclination(levelled.T), dip, atol=1e-12)
    np.testing.assert_allclose(levelled, turn(roll, pitch, 0.0) @ mag, atol=1e-12)


def test_fields_of_many_attitudes(rng):
    c = attitudes(rng, 200)
    h = earth(-0.1, 1.1, 50.0)
    levelled = levelling.level(np.einsum("nji,j->ni", c, G), np.einsum("nji,j->ni", c, h))
    yaw = np.arctan2(c[:, 1, 0], c[:, 0, 0])
    apart = np.arctan2(levelled[:, 0], levelled[:, 1]) + 0.1 - yaw
    np.testing.assert_allclose(np.sin(apart / 2), 0, atol=1e-10)
    np.testing.assert_allclose(inclination(levelled.T), 1.1, atol=1e-12)


def test_equations_of_the_paper_with_its_signs():
    """Ma's Eq. 3 and 5 level a north-east-down field with negated angles, and this one with true ones."""
    c = turn(0.3, -0.2, 1.0)
    force, mag = c.T @ G, c.T @ earth(0.0, 1.1, 48.0)
    roll, pitch = (float(a) for a in levelling.roll_pitch(force))

    def printed(m, r, p):
        return np.array(
            [
                m[0] * np.cos(p) + m[1] * np.sin(p) * np.sin(r) - m[2] * np.sin(p) * np.cos(r),
                m[1] * np.cos(r) + m[2] * np.sin(r),
            ]
        )

    right = levelling.level(force, mag)[:2]
    np.testing.assert_allclose(printed(mag, -roll, -pitch), right, atol=1e-12)
    assert np.linalg.norm(printed(mag, roll, pitch) - right) > 10.0


def test_stance_means_are_weighted(rng):
    values, weights = rng.normal(size=(50, 3)), rng.uniform(0, 1, 50)
    stances = np.repeat([-1, 0, 1, -1, 2], 10)
    weights[12] = 0.0
    with_hole = values.copy()
    with_hole[12] = np.nan
    found, weight = levelling.stance_means(
        jnp.asarray(with_hole), jnp.asarray(weights), jnp.asarray(stances), 5
    )
    for k in range(3):
        at = stances == k
        np.testing.assert_allclose(found[k], np.average(values[at], axis=0, weights=weights[at]))
        np.testing.assert_allclose(weight[k], weights[at].sum())
    assert not np.asarray(found[3:]).any()
    assert not np.asarray(weight[3:]).any()


def _everything(x, weights):
    levelled = levelling.level(x[:, :3], x[:, 3:])
    means, _ = levelling.stance_means(levelled, weights, jnp.array([0, 0, 1, -1, 1]), 3)
    return jnp.concatenate([levelled.ravel(), means.ravel()]), levelled


SLOPES = sloped(_everything)


def test_slopes(rng):
    c = attitudes(rng, 5)
    x = np.concatenate([np.einsum("nji,j->ni", c, v) for v in (G, earth(0, 1.1, 48.0))], axis=1)
    assert_slopes(SLOPES, x, 24, rng)


@pytest.mark.parametrize(
    ("force", "mag"),
    [
        ([0, 0, 0], [1, 2, 3]),
        ([9.8, 0, 0], [1, 2, 3]),
        ([0, 0, -9.8], [1, 2, 3]),
        ([0, 0, 9.8], [0, 0, 0]),
        ([0, 0, 9.8], [0, 0, -40]),
    ],
)
def test_slopes_are_finite_where_angles_are_not_defined(force, mag):
    for dtype in (np.float32, np.float64):
        x = np.tile(np.array([*force, *mag], dtype), (5, 1))
        (value, levelled), slopes = SLOPES(x, np.ones(5, dtype), np.ones(24, dtype))
        assert np.isfinite(value)
        assert levelled.dtype == dtype
        assert all(np.isfinite(s).all() for s in slopes)
        assert np.abs(slopes[0]).max() < 1e3
