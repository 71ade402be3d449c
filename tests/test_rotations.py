"""Rotations against scipy and Rodrigues' formula, and finite gradients at every degenerate point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pedjax import rotations
from tests.reference import filter as oracle

exp, log, cayley, from_euler, to_euler, from_quaternion, levelled = (
    jax.jit(getattr(rotations, name))
    for name in ("exp", "log", "cayley", "from_euler", "to_euler", "from_quaternion", "levelled")
)


@pytest.fixture
def phi(rng):
    """Rotation vectors `(3, 40)` up to 1.5 rad."""
    direction = rng.normal(size=(3, 40))
    return direction / np.linalg.norm(direction, axis=0) * np.linspace(0.0, 1.5, 40)


def matrices(rotation):
    return np.moveaxis(rotation.as_matrix(), 0, -1)


def test_exp_is_rodrigues_in_any_lane(phi):
    found = exp(phi)
    for lane in range(phi.shape[1]):
        np.testing.assert_allclose(found[..., lane], oracle.rotation(phi[:, lane]), atol=1e-15)
        np.testing.assert_allclose(exp(phi[:, lane]), found[..., lane], atol=1e-15)


def test_exp_up_to_half_a_turn_to_1e_9(phi):
    far = phi / 1.5 * np.pi
    np.testing.assert_allclose(exp(far), matrices(Rotation.from_rotvec(far.T)), atol=2e-9)
    product = np.einsum("ijl,kjl->ikl", exp(far), exp(far))
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3)[..., None], product.shape), atol=1e-14)


def test_exp_in_float32(phi):
    found = exp(jnp.asarray(phi, jnp.float32))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, matrices(Rotation.from_rotvec(phi.T)), atol=3e-7)


def test_log_inverts_exp(phi):
    np.testing.assert_allclose(log(exp(phi)), phi, atol=1e-12)


def test_log_is_finite_for_half_a_turn_and_for_what_is_no_rotation():
    cases = jnp.stack([jnp.diag(jnp.array(x)) for x in ([1.0, -1, -1], [0.0, 0, 0], [0.0, 0, 1])], axis=-1)
    found, slope = log(cases), jax.grad(lambda c: jnp.sum(log(c)))(cases)
    assert np.isfinite(found).all()
    assert np.isfinite(slope).all()


def test_cayley_is_its_fraction_and_turns_by_twice_the_arctangent(phi):
    found = cayley(phi)
    for lane in range(phi.shape[1]):
        expected = oracle.next_attitude(np.eye(3), phi[:, lane], 1.0, "pade")
        np.testing.assert_allclose(found[..., lane], expected, atol=1e-14)
    size = np.linalg.norm(phi, axis=0)
    turned = np.linalg.norm(log(found), axis=0)
    np.testing.assert_allclose(turned, 2 * np.arctan(size / 2), atol=1e-12)


def test_orthonormalise_squares_the_distance_to_a_rotation(rng):
    for size in (1e-2, 1e-3):
        rough = oracle.rotation(rng.normal(size=3)) + size * rng.normal(size=(3, 3))
        c = np.asarray(rotations.orthonormalise(jnp.asarray(rough)))
        assert np.abs(c @ c.T - np.eye(3)).max() < 10 * size**2


def test_euler_is_zyx_and_inverts(rng):
    roll, yaw = rng.uniform(-3, 3, (2, 20))
    pitch = rng.uniform(-1.5, 1.5, 20)
    c = from_euler(roll, pitch, yaw)
    expected = matrices(Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)))
    np.testing.assert_allclose(c, expected, atol=1e-15)
    np.testing.assert_allclose(to_euler(c), [roll, pitch, yaw], atol=1e-12)


def test_quaternion_is_scalar_first_and_normalised_here(rng):
    q = rng.normal(size=(4, 12))
    expected = matrices(Rotation.from_quat(q[[1, 2, 3, 0]].T))
    np.testing.assert_allclose(from_quaternion(q), expected, atol=1e-14)


def test_levelled_recovers_roll_pitch_and_heading(rng):
    roll, pitch, yaw = rng.uniform(-1.4, 1.4, (3, 10))
    c = from_euler(roll, pitch, yaw)
    force = np.asarray(c)[2] * 9.81  # the upward reaction seen in the body
    np.testing.assert_allclose(levelled(force, yaw), c, atol=1e-12)
    for lane in range(10):
        expected = oracle.levelled_attitude(force[:, lane], yaw[lane])
        np.testing.assert_allclose(levelled(force[:, lane], yaw[lane]), expected, atol=1e-12)


def test_skew_is_the_vector_product(rng):
    x, y = rng.normal(size=(2, 3))
    np.testing.assert_allclose(np.asarray(rotations.skew(x)) @ y, np.cross(x, y), atol=1e-15)


def test_wrap_lands_within_half_a_turn():
    np.testing.assert_allclose(
        rotations.wrap(np.array([0.1, 3 * np.pi - 0.1, -7.0])), [0.1, np.pi - 0.1, -7 + 2 * np.pi]
    )


@pytest.mark.parametrize(
    ("function", "at"),
    [
        (rotations.exp, np.zeros(3)),
        (rotations.exp, np.array([np.pi, 0.0, 0.0])),
        (rotations.cayley, np.zeros(3)),
        (rotations.log, np.eye(3)),
        (rotations.to_euler, np.asarray(rotations.from_euler(0.3, np.pi / 2, 0.2))),
        (rotations.to_euler, np.asarray(rotations.from_euler(0.3, -np.pi / 2, 0.2))),
        (rotations.to_euler, np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])),
        (rotations.from_quaternion, np.zeros(4)),
        (rotations.tilt, np.zeros(3)),
        (rotations.tilt, np.array([9.8, 0.0, 0.0])),
        (lambda f: rotations.levelled(f, jnp.zeros(())), np.zeros(3)),
        (rotations.orthonormalise, np.zeros((3, 3))),
    ],
)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_gradients_are_finite_at_degenerate_points(function, at, dtype):
    both = jax.jit(lambda x: (jax.jacfwd(function)(x), jax.jacrev(function)(x)))
    for slope in jax.tree.leaves(both(jnp.asarray(at, dtype))):
        assert np.isfinite(slope).all()
