"""Heading errors against numpy: the unwrapped error about its mean, over what is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pedjax.evaluation.heading import heading_rms, turn_about_up
from pedjax.walks import reference_of

COUNT = 40
rms = jax.jit(heading_rms)


def turned(attitude, error):
    """Attitudes `(K, 3, 3)` turned about up by `error (K,)` rad."""
    return Rotation.from_rotvec(np.asarray(error)[:, None] * [0, 0, 1]).as_matrix() @ attitude


@pytest.fixture
def true(rng):
    """Any attitudes, upside down and steep ones too."""
    return Rotation.random(COUNT, rng).as_matrix()


def reference(true):
    return reference_of(np.full((len(true), 3), np.nan), attitude=true)


def expected(error):
    """Of errors in rad that are followed from point to point."""
    return np.degrees(np.std(np.unwrap(error)))


def test_it_is_the_spread_of_the_unwrapped_error(true, rng):
    error = 2.9 + np.cumsum(rng.normal(0, 0.3, COUNT))
    found = float(rms(turned(true, error), reference(true)))
    assert found == pytest.approx(expected(error), rel=1e-12)
    assert float(rms(turned(true, error + 1.7), reference(true))) == pytest.approx(found, rel=1e-12)


def test_it_grows_beyond_half_a_turn(true):
    error = np.linspace(0.0, 4 * np.pi, COUNT)
    found = float(rms(turned(true, error), reference(true)))
    assert found == pytest.approx(np.degrees(np.std(error)), rel=1e-12)
    assert found > 180.0


def test_a_tilt_is_no_heading_error(true, rng):
    """To first order in the tilt."""
    tilt = rng.normal(0, 1e-4, (COUNT, 3)) * [1, 1, 0]
    leaned = Rotation.from_rotvec(tilt).as_matrix() @ true
    assert float(rms(leaned, reference(true))) < 1e-5
    steep = Rotation.from_euler("y", 90, degrees=True).as_matrix()[..., None]
    off = Rotation.from_euler("z", 10, degrees=True).as_matrix()[..., None]
    angle = turn_about_up(jnp.asarray(off[..., 0] @ steep[..., 0])[..., None], jnp.asarray(steep))
    np.testing.assert_allclose(angle, np.radians(10))


def test_points_without_a_known_attitude_do_not_count(true, rng):
    error = rng.normal(0, 1.0, COUNT)
    padded = np.concatenate([true, np.full((9, 3, 3), np.nan)])
    estimate = np.concatenate([turned(true, error), Rotation.random(9, rng).as_matrix()])
    alone = float(rms(turned(true, error), reference(true)))
    assert float(rms(estimate, reference(padded))) == pytest.approx(alone, rel=1e-12)


def test_a_gap_in_what_is_known_is_stepped_over(true, rng):
    error = np.cumsum(rng.normal(0, 0.3, COUNT))
    gap = np.isin(np.arange(COUNT), (0, 11, 12, 30))
    holed = np.where(gap[:, None, None], np.nan, true)
    found = float(rms(turned(true, error), reference(holed)))
    assert found == pytest.approx(expected(error[~gap]), rel=1e-12)


def test_without_any_truth_it_is_no_number(true):
    assert np.isnan(rms(true, reference(np.full_like(true, np.nan))))


def test_lanes_equal_one_by_one(true, rng):
    """Sets and recordings behind the points."""
    others = np.stack([true, Rotation.random(COUNT, rng).as_matrix()], axis=-1)
    together = jax.tree.map(lambda *x: jnp.stack(x, -1), *(reference(others[..., r]) for r in range(2)))
    error = rng.normal(0, 0.5, (COUNT, 3, 2))
    estimate = np.stack(
        [np.stack([turned(others[..., r], error[:, s, r]) for r in range(2)], -1) for s in range(3)], -2
    )
    found = rms(estimate, together)
    assert found.shape == (3, 2)
    for s in range(3):
        for r in range(2):
            assert float(found[s, r]) == pytest.approx(expected(error[:, s, r]), rel=1e-12)


def test_the_slope_equals_differences_and_is_finite_without_an_error(true, rng):
    shape = rng.normal(0, 1.0, COUNT)

    @jax.jit
    @jax.value_and_grad
    def scaled(size):
        c, s = jnp.cos(size * shape), jnp.sin(size * shape)
        nothing, one = jnp.zeros(COUNT), jnp.ones(COUNT)
        turn = jnp.stack(
            [jnp.stack([c, -s, nothing]), jnp.stack([s, c, nothing]), jnp.stack([nothing, nothing, one])]
        )
        return heading_rms(jnp.moveaxis(turn, -1, 0) @ true, reference(true))

    h = 1e-6
    up, down = (float(scaled(0.3 + x)[0]) for x in (h, -h))
    assert float(scaled(0.3)[1]) == pytest.approx((up - down) / (2 * h), rel=1e-7)
    value, slope = jax.value_and_grad(heading_rms)(jnp.asarray(true), reference(true))
    assert abs(float(value)) < 1e-5
    assert np.isfinite(slope).all()
    still = jnp.broadcast_to(jnp.eye(3), (COUNT, 3, 3))
    value, slope = jax.value_and_grad(heading_rms)(still, reference(np.asarray(still)))
    assert float(value) == 0.0
    assert np.isfinite(slope).all()


def test_the_slope_is_finite_forward_where_points_are_padding(true):
    """Padding has no rotation, and its attitude may be all zeros."""
    some = np.concatenate([true[:-5], np.full((5, 3, 3), np.nan)])
    found = jnp.asarray(np.nan_to_num(some))
    value, slope = jax.jvp(lambda x: heading_rms(x, reference(some)), (found,), (jnp.ones_like(found),))
    assert np.isfinite(value)
    assert np.isfinite(slope)
