"""Rows of roll, pitch and yaw against attitudes truly perturbed, wherever the walker heads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import rotations
from pedjax.filters import kalman, measurements
from pedjax.filters.strapdown import still_at_origin
from tests.reference import filter as dense

SMALL = 1e-6
YAWS = np.radians([0.0, 90.0, 180.0, -135.0])
PITCHES = np.radians([-60.0, -20.0, 0.0, 45.0, 60.0])
ROLLS = np.radians([-100.0, 0.0, 15.0])
ANGLES = np.stack(np.meshgrid(ROLLS, PITCHES, YAWS, indexing="ij")).reshape(3, -1)
ATTITUDES = np.stack([dense.euler_attitude(*each) for each in ANGLES.T], axis=-1)
LANES = ATTITUDES.shape[-1]
SIGMA = jnp.asarray(0.05)


def euler(C):
    """Roll, pitch, yaw `(3, L)` of C = Rz Ry Rx."""
    return np.stack([np.arctan2(C[2, 1], C[2, 2]), -np.arcsin(C[2, 0]), np.arctan2(C[1, 0], C[0, 0])])


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def perturbed(of):
    """Slopes `(m, 3, L)` of `of(exp([t x]) C)` by t."""
    slopes = []
    for axis in np.eye(3):
        up, down = (
            of(np.einsum("ij,jkl->ikl", dense.rotation(s * SMALL * axis), ATTITUDES)) for s in (1, -1)
        )
        slopes.append(wrapped(up - down) / (2 * SMALL))
    return np.stack(slopes, axis=1)


nav = still_at_origin(jnp.asarray(ATTITUDES))


def test_the_block_is_the_slope_of_euler_angles():
    found = measurements.euler_block(nav.attitude)
    np.testing.assert_allclose(found, perturbed(euler), atol=1e-5)  # cut off near the gimbal


@pytest.mark.parametrize("count", [2, 3])
def test_euler_rows_tell_the_error_of_the_attitude(count):
    """Of angles measured of the truth exp([t x]) C: z = H t, to first order."""
    t = np.array([0.004, -0.003, 0.002])
    truth = euler(np.einsum("ij,jkl->ikl", dense.rotation(t), ATTITUDES))
    rows = jax.jit(measurements.euler)(nav, tuple(map(jnp.asarray, truth[:count])), SIGMA)
    assert rows.innovation.shape == (count, LANES)
    np.testing.assert_allclose(rows.innovation, wrapped(truth - ANGLES)[:count], atol=1e-9)
    np.testing.assert_allclose(np.einsum("ijl,j->il", rows.H["t"], t), rows.innovation, atol=2e-4)
    np.testing.assert_allclose(rows.H["t"], perturbed(euler)[:count], atol=1e-5)
    np.testing.assert_allclose(rows.noise[..., 0], 0.0025 * np.eye(count))


def at_rest(attitudes):
    """The force that a body of those attitudes reads."""
    return 9.8 * attitudes[2]


def test_level_rows_tell_the_tilt_wherever_the_walker_heads():
    """Of a body at rest whose attitude is exp([t x]) C: z = (t_x, t_y), whatever t_z is."""
    for t in ([0.004, -0.003, 0.0], [0.004, -0.003, 0.01]):
        truth = np.einsum("ij,jkl->ikl", dense.rotation(np.array(t)), ATTITUDES)
        rows = jax.jit(measurements.level)(nav, jnp.asarray(at_rest(truth)), SIGMA)
        np.testing.assert_allclose(rows.innovation, np.tile(np.array(t[:2])[:, None], LANES), atol=6e-5)
        np.testing.assert_allclose(np.einsum("ijl,j->il", rows.H["t"], t), rows.innovation, atol=6e-5)
        np.testing.assert_allclose(rows.noise[..., 0], 0.0025 * np.eye(2))

    def innovation(truth):
        return np.asarray(measurements.level(nav, jnp.asarray(at_rest(truth)), SIGMA).innovation)

    H = np.broadcast_to(rows.H["t"], (2, 3, LANES))
    np.testing.assert_allclose(H, perturbed(innovation), atol=1e-8)


def tilt_left(rows, t):
    """Angle between true and estimated up after one update with those rows."""
    P = {"tt": 0.01 * jnp.eye(3)[..., None] * jnp.ones(LANES)}
    _, correction = kalman.update(P, rows, jnp.ones(LANES))
    mended = np.asarray(rotations.exp(correction["t"]))
    up = np.einsum("ijl,jkl->ikl", mended, ATTITUDES)
    truth = np.einsum("ij,jkl->ikl", dense.rotation(t), ATTITUDES)
    return np.linalg.norm(np.cross(up[2], truth[2], axis=0), axis=0)


def test_the_identity_turns_the_tilt_away_on_the_way_back():
    """Printed, roll and pitch rows have the wrong sign at 180 degrees; the others are right everywhere."""
    t = np.array([0.02, -0.015, 0.0])
    truth = np.einsum("ij,jkl->ikl", dense.rotation(t), ATTITUDES)
    force = jnp.asarray(at_rest(truth))
    angles, sigma, before = rotations.tilt(force), jnp.asarray(0.01), np.linalg.norm(t)
    level = tilt_left(measurements.level(nav, force, sigma), t)
    block = tilt_left(measurements.euler(nav, angles, sigma), t)
    assert level.max() < 0.02 * before
    assert block.max() < 0.05 * before
    printed = measurements.euler(nav, angles, sigma, True)
    H = np.broadcast_to(printed.H["t"], (2, 3, LANES))
    np.testing.assert_array_equal(H, np.tile(np.eye(3)[:2, :, None], LANES))
    left = tilt_left(printed, t)
    flat = (ANGLES[0] == 0) & (ANGLES[1] == 0)
    out, back = (flat & (np.abs(ANGLES[2] - x) < 1e-9) for x in (0.0, np.pi))
    assert left[out] < 0.02 * before
    assert left[back] > 1.9 * before
    np.testing.assert_allclose(perturbed(euler)[:2, :2, back][..., 0], -np.eye(2), atol=1e-8)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_rows_are_finite_at_the_gimbal_and_without_force(dtype):
    upright = np.stack([dense.euler_attitude(0.3, p, 0.7) for p in (np.pi / 2, -np.pi / 2, 0.0)], axis=-1)
    force = np.stack([[0.0, 0.0, 0.0], [9.8, 0.0, 0.0], [0.0, 0.0, -9.8]], axis=-1)

    def total(attitude, force):
        nav = still_at_origin(attitude)
        rows = [
            measurements.level(nav, force, SIGMA.astype(dtype)),
            measurements.euler(nav, rotations.tilt(force), SIGMA.astype(dtype)),
        ]
        return sum(jnp.sum(x) for x in jax.tree.leaves(rows))

    given = jnp.asarray(upright, dtype), jnp.asarray(force, dtype)
    found, slopes = jax.value_and_grad(total, (0, 1))(*given)
    assert np.isfinite(found)
    assert all(np.isfinite(x).all() for x in slopes)
