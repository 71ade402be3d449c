"""The gate: hard is the limit of soft, straight-through is hard forward and soft backward."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.gates import gate, log_positive

RATIOS = jnp.array([-8.0, -1.0, -0.2, -1e-6, 1e-6, 0.3, 2.0, 9.0])
HARD = np.array([1, 1, 1, 1, 0, 0, 0, 0.0])


def test_hard_test_is_below_the_threshold_only():
    np.testing.assert_array_equal(gate(RATIOS, 0.0), HARD)
    assert float(gate(jnp.array(0.0), 0.0)) == 0.0


def test_soft_weight_is_a_sigmoid():
    np.testing.assert_allclose(gate(RATIOS, 0.25), 1 / (1 + np.exp(np.asarray(RATIOS) / 0.25)), rtol=1e-14)
    assert float(gate(jnp.array(0.0), 0.25)) == 0.5


def test_hard_gate_is_the_limit_of_the_soft_one():
    distance = [np.abs(np.asarray(gate(RATIOS, w)) - HARD).max() for w in (1e-1, 1e-7, 1e-9)]
    assert distance[1] < 5e-5
    assert distance[2] == 0.0


def test_straight_through_is_hard_forward_and_soft_backward():
    np.testing.assert_array_equal(gate(RATIOS, 0.25, True), HARD)
    slope = jax.vmap(jax.grad(lambda x, w: gate(x, w, True)), (0, None))
    soft = jax.vmap(jax.grad(gate), (0, None))
    np.testing.assert_allclose(slope(RATIOS, 0.25), soft(RATIOS, 0.25), rtol=1e-14)
    assert (np.asarray(slope(RATIOS, 0.25)) < 0).all()


@pytest.mark.parametrize("straight_through", [False, True])
@pytest.mark.parametrize("width", [0.0, 1e-3, 0.25])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_slopes_are_finite_at_ties_and_far_away(straight_through, width, dtype):
    for x in (0.0, 700.0, -700.0, 1e30, -1e30):
        value, slopes = jax.value_and_grad(gate, (0, 1))(
            jnp.asarray(x, dtype), jnp.asarray(width, dtype), straight_through
        )
        assert value.dtype == dtype
        assert np.isfinite([value, *slopes]).all()


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_log_positive_is_finite_with_finite_slope(dtype):
    for x in (0.0, float(jnp.finfo(dtype).tiny), 1.0, float(jnp.finfo(dtype).max), np.inf):
        value, slope = jax.value_and_grad(log_positive)(jnp.asarray(x, dtype))
        assert np.isfinite([value, slope]).all()
    assert float(log_positive(jnp.asarray(2.0, dtype))) == pytest.approx(np.log(2.0), rel=1e-6)


def test_lanes_broadcast():
    weight = gate(jnp.zeros((1, 4)), jnp.array([[0.0], [0.5]]))
    np.testing.assert_array_equal(weight, [[0.0] * 4, [0.5] * 4])
