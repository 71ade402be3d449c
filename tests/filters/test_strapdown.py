"""Mechanisation: attitude updates, the order of position and velocity, exact motion, lanes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.filters import strapdown
from pedjax.filters.strapdown import ATTITUDE_UPDATES
from tests.reference import filter as oracle
from tests.reference.walk import walk

GRAVITY = 9.81
mechanise = jax.jit(strapdown.mechanise, static_argnums=5)


@pytest.mark.parametrize("method", ATTITUDE_UPDATES)
def test_attitude_updates_equal_their_formulas(rng, method):
    c = oracle.rotation(rng.normal(size=3))
    rate = rng.normal(0, 8, (3, 5))
    found = jax.jit(strapdown.turn, static_argnums=2)(jnp.asarray(c)[..., None], rate * 0.01, method)
    for lane in range(5):
        np.testing.assert_allclose(
            found[..., lane], oracle.next_attitude(c, rate[:, lane], 0.01, method), atol=1e-14
        )


@pytest.mark.parametrize("method", ATTITUDE_UPDATES)
def test_attitude_stays_a_rotation_over_a_minute_of_turning(method):
    rates = jnp.asarray(np.random.default_rng(0).normal(0, 5, (6000, 3)))

    @jax.jit
    def end(c):
        return jax.lax.scan(lambda c, w: (strapdown.turn(c, w * 0.01, method), None), c, rates)[0]

    c = np.asarray(end(jnp.eye(3)))
    np.testing.assert_allclose(c @ c.T, np.eye(3), atol=1e-4 if method == "first_order" else 1e-11)


def test_rest_stays_at_rest(rng):
    c = jnp.asarray(oracle.rotation(rng.normal(size=3)))
    nav = strapdown.still_at_origin(c)
    after, middle, force_n = mechanise(nav, GRAVITY * c[2], jnp.zeros(3), 0.01, GRAVITY)
    np.testing.assert_allclose(middle, c, atol=1e-15)
    np.testing.assert_allclose(force_n, [0, 0, GRAVITY], atol=1e-14)
    for found, before in zip(after, nav, strict=True):
        np.testing.assert_allclose(found, before, atol=1e-14)


def test_constant_acceleration_is_exact(rng):
    """Position with the old velocity plus a dt²/2; with the new one (Wang's Eq. 1) it would overshoot."""
    dt, acceleration = 0.02, np.array([1.0, -2.0, 0.5])
    nav = strapdown.still_at_origin(jnp.eye(3))
    for _ in range(50):
        nav, *_ = mechanise(
            nav, jnp.asarray(acceleration + np.array([0, 0, GRAVITY])), jnp.zeros(3), dt, GRAVITY
        )
    np.testing.assert_allclose(nav.velocity, acceleration, atol=1e-13)
    np.testing.assert_allclose(nav.position, acceleration / 2, atol=1e-13)


def test_walk_is_followed_without_updates():
    """Exact sensors over the first strides: only discretisation is left."""
    exact = walk(4.0, 400.0, seed=3)
    nav = strapdown.still_at_origin(jnp.asarray(exact.initial_attitude))

    @jax.jit
    def track(nav, samples):
        def body(nav, sample):
            nav, *_ = strapdown.mechanise(nav, *sample, GRAVITY)
            return nav, nav

        return jax.lax.scan(body, nav, samples)[1]

    found = track(nav, (exact.specific_force, exact.angular_rate, exact.dt))
    np.testing.assert_allclose(found.attitude, exact.attitude, atol=1e-10)
    np.testing.assert_allclose(found.velocity, exact.velocity, atol=5e-4)
    np.testing.assert_allclose(found.position, exact.position, atol=2e-3)


def test_lanes_equal_one_by_one(rng):
    c = np.stack([oracle.rotation(v) for v in rng.normal(size=(4, 3))], axis=-1)
    force, rate, velocity = rng.normal(size=(3, 3, 4))
    dt = rng.uniform(0.005, 0.02, 4)
    nav = strapdown.still_at_origin(jnp.asarray(c))._replace(velocity=jnp.asarray(velocity))
    together = mechanise(nav, force, rate, dt, GRAVITY)
    for lane in range(4):
        one = jax.tree.map(lambda x, i=lane: x[..., i], nav)
        alone = mechanise(one, force[:, lane], rate[:, lane], dt[lane], GRAVITY)
        for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(a[..., lane], b, atol=1e-14)
