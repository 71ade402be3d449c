"""The rotation to the accelerometer: recovered from random attitudes, slopes, what cannot be known."""

import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.calibration import alignment
from tests.calibration.common import align, assert_slopes, sloped
from tests.reference.calibration import attitudes, earth, turn

DIP, STRENGTH = np.deg2rad(64.0), 48.0


def turned(rng, count, rotation, noise=0.0):
    """Field in axes that `rotation` turns to the body's, and specific force."""
    c = attitudes(rng, count)
    h = earth(0.05, DIP, STRENGTH)
    force = np.einsum("nji,j->ni", c, [0, 0, 9.81]) + 0.1 * noise * rng.normal(size=(count, 3))
    return np.einsum("nji,j->ni", c, h) @ rotation + noise * rng.normal(size=(count, 3)), force


@pytest.mark.parametrize(
    "angles", [(0, 0, 0), (0.05, -0.03, 0.1), (1.0, -0.7, 2.5), (np.pi, 0, 0), (0, 0, np.pi / 2)]
)
def test_rotation_is_recovered(rng, angles):
    rotation = turn(*angles)
    mag, force = turned(rng, 80, rotation)
    found = align(mag, force)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(found.constant, -STRENGTH * np.sin(DIP), rtol=1e-9)
    np.testing.assert_allclose(found.inclination, DIP, rtol=1e-9)
    assert found.residual < 1e-9


def test_sigma_says_how_far_off_it_is():
    rng, off, said = np.random.default_rng(3), [], []
    for _ in range(60):
        rotation = turn(*rng.uniform(-0.2, 0.2, 3))
        mag, force = turned(rng, 80, rotation, 0.3)
        found = align(mag, force)
        off.append(np.arccos((np.trace(found.rotation.T @ rotation) - 1) / 2))
        said.append(float(found.sigma))
    assert 0.7 < np.sqrt(np.mean(np.square(off)) / 3) / np.mean(said) < 1.3


def test_padding(rng):
    mag, force = turned(rng, 80, turn(0.1, 0.2, 0.3), 0.5)
    weights = np.array([1.0] * 60 + [0.0] * 20)
    mag[60:], force[70:] = np.nan, np.nan
    expected = align(mag[:60], force[:60])
    for a, b in zip(align(mag, force, weights=weights), expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9)


def _function(x, weights):
    found = alignment.align(x[:, :3], x[:, 3:], weights)
    rest = jnp.stack([found.constant, found.residual, found.inclination])
    return jnp.concatenate([found.rotation.ravel(), rest]), found


SLOPES = sloped(_function)


def test_slopes(rng):
    assert_slopes(SLOPES, np.concatenate(turned(rng, 30, turn(0.1, 0.2, -0.3), 1.0), axis=1), 12, rng)


@pytest.mark.parametrize("force", ["turned", "still", "none", "along"])
@pytest.mark.parametrize("mag", ["turned", "still", "none"])
def test_what_says_nothing_stays_finite(mag, force):
    rng = np.random.default_rng(1)
    clean = dict(zip(("mag", "force"), turned(rng, 30, np.eye(3)), strict=True))
    fields = {"turned": clean["mag"], "still": np.tile([0, 20.0, -40.0], (30, 1)), "none": np.zeros((30, 3))}
    forces = {"turned": clean["force"], "still": np.tile([0, 0, 9.81], (30, 1)), "none": np.zeros((30, 3))}
    forces["along"] = fields[mag]
    x = np.concatenate([fields[mag], forces[force]], axis=1)
    (value, found), grads = SLOPES(x, np.ones(30), np.ones(12))
    assert np.isfinite(value)
    assert all(np.isfinite(g).all() for g in grads)
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-9)
