"""Sliding windows against loops: values, causality to the bit, and no cancellation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import windows

moments, mean_of = (
    jax.jit(getattr(windows, f"trailing_{name}"), static_argnums=1) for name in ("moments", "mean")
)
WIDTHS = (1, 2, 3, 4, 5, 6, 7, 13, 16)


def each_window(x, width):
    """The samples of the window that ends at each sample, the first one repeated before the start."""
    padded = np.concatenate([np.repeat(x[:1], width - 1, axis=0), x])
    return [padded[n : n + width] for n in range(len(x))]


@pytest.mark.parametrize("width", WIDTHS)
def test_windows_equal_loops(rng, width):
    x = rng.normal(size=(23, 3))
    cut = each_window(x, width)
    mean, variance = moments(jnp.asarray(x), width)
    np.testing.assert_allclose(mean, [w.mean(axis=0) for w in cut], atol=1e-14)
    np.testing.assert_allclose(variance, [w.var(axis=0) for w in cut], atol=1e-14)
    np.testing.assert_allclose(mean_of(jnp.asarray(x), width), mean, atol=1e-14)


@pytest.mark.parametrize("width", WIDTHS)
def test_only_whole_windows_are_complete(width):
    np.testing.assert_array_equal(windows.is_complete(20, width), np.arange(1, 21) >= width)


@pytest.mark.parametrize("width", [2, 5, 7])
def test_cropping_either_end_changes_no_bit(rng, width):
    x = jnp.asarray(rng.normal(size=(64, 3)))
    whole = moments(x, width)
    for whole_part, part in zip(whole, moments(x[:40], width), strict=True):
        np.testing.assert_array_equal(whole_part[:40], part)
    for whole_part, part in zip(whole, moments(x[10:], width), strict=True):
        np.testing.assert_array_equal(whole_part[10 + width - 1 :], part[width - 1 :])


def test_variance_survives_a_large_mean(rng):
    x = rng.normal(size=(200, 1)) * 1e-3
    for dtype, offset, tolerance in ((jnp.float64, 1e6, 1e-5), (jnp.float32, 10.0, 2e-3)):
        shifted = jnp.asarray(x + offset, dtype)
        exact = [w.var() for w in each_window(np.asarray(shifted, np.float64), 5)]
        _, variance = moments(shifted, 5)
        np.testing.assert_allclose(variance[:, 0], exact, rtol=tolerance, atol=1e-12)


def test_constant_input_has_exactly_no_variance():
    _, variance = moments(jnp.full((30, 2), 9.80665), 5)
    assert (np.asarray(variance) == 0).all()


def test_windows_longer_than_the_recording_and_trees():
    x = jnp.arange(3.0)
    np.testing.assert_allclose(windows.trailing_mean(x, 8), [0.0, 1 / 8, 3 / 8])
    tree = windows.delay({"a": x, "b": -x}, 2)
    np.testing.assert_array_equal(tree["a"], [0, 0, 0])
    np.testing.assert_array_equal(tree["b"], [0, 0, 0])
    assert windows.delay(x, 0) is x


def test_empty_window_is_refused():
    with pytest.raises(ValueError, match="at least one sample"):
        windows.trailing_mean(jnp.zeros(4), 0)
