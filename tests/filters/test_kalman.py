"""The written-out derivative of an update against automatic differentiation of its formulas, both ways."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.filters import kalman
from pedjax.filters.covariance import STATES
from pedjax.filters.kalman import Rows

LANES = 4


def by_the_book(P, rows, weight):
    """The same without a derivative of its own."""
    return kalman.downdate(P, kalman.whiten(P, rows, weight), weight)


def mirrored(x):
    return x + jnp.swapaxes(x, 0, 1)


def random_like(rng, tree):
    return jax.tree.map(lambda x: jnp.asarray(rng.normal(size=jnp.shape(x))), tree)


def inner(one, other):
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return float(sum(jnp.sum(x * y) for x, y in pairs))


def matrices(rng, m, states):
    return {s: jnp.asarray(rng.normal(size=(m, 3, LANES))) for s in states}


CASES = {
    "identity": lambda rng: (3, {"v": None}),
    "one row": lambda rng: (1, matrices(rng, 1, "t")),
    "two rows of two states": lambda rng: (2, matrices(rng, 2, "ga")),
    "identity and a matrix": lambda rng: (3, {"p": None, **matrices(rng, 3, "t")}),
}


@pytest.fixture(params=CASES)
def given(request, rng):
    m, H = CASES[request.param](rng)
    factor = rng.normal(size=(15, 20, LANES))
    full = np.einsum("ikl,jkl->ijl", factor, factor)
    P = {
        a + b: jnp.asarray(full[3 * i : 3 * i + 3, 3 * j : 3 * j + 3])
        for i, a in enumerate(STATES)
        for j, b in enumerate(STATES)
        if i <= j
    }
    noise = jnp.asarray(np.eye(m)[:, :, None] * rng.uniform(0.5, 3.0, LANES))
    rows = Rows(jnp.asarray(rng.normal(size=(m, LANES))), noise, H)
    return P, rows, jnp.asarray([0.0, 0.3, 1.0, 0.01])


@pytest.fixture
def moves(given, rng):
    """In any direction that leaves covariances symmetric."""
    P, rows, weight = random_like(rng, given)
    P = {name: mirrored(x) if name[0] == name[1] else x for name, x in P.items()}
    return P, rows._replace(noise=mirrored(rows.noise)), weight


def test_forward_slopes(given, moves):
    found, slope = jax.jvp(kalman.update, given, moves)
    expected, expected_slope = jax.jvp(by_the_book, given, moves)
    jax.tree.map(np.testing.assert_array_equal, found, expected)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9), slope, expected_slope)


def test_backward_slopes(given, moves, rng):
    found, back = jax.vjp(kalman.update, *given)
    _, expected_back = jax.vjp(by_the_book, *given)
    weights = random_like(rng, found)
    slopes, expected_slopes = back(weights), expected_back(weights)
    assert inner(slopes, moves) == pytest.approx(inner(expected_slopes, moves), rel=1e-11)
    one, other = slopes[1:], expected_slopes[1:]
    np.testing.assert_allclose(one[1], other[1], rtol=1e-10)
    np.testing.assert_allclose(one[0].innovation, other[0].innovation, rtol=1e-10, atol=1e-12)
    for state, matrix in given[1].H.items():
        if matrix is not None:
            np.testing.assert_allclose(one[0].H[state], other[0].H[state], rtol=1e-9, atol=1e-10)


def test_numbers_without_lanes_are_spread_over_them(given):
    P, rows, _ = given
    thin = rows._replace(noise=rows.noise[:, :, :1])

    def size(noise, weight):
        changed, correction = kalman.update(P, thin._replace(noise=noise), weight)
        return sum(jnp.sum(x) for x in (*changed.values(), *correction.values()))

    slopes = jax.grad(size, argnums=(0, 1))(thin.noise, 0.5)
    assert slopes[0].shape == thin.noise.shape
    step = 1e-6
    difference = (size(thin.noise, 0.5 + step) - size(thin.noise, 0.5 - step)) / (2 * step)
    assert slopes[1] == pytest.approx(float(difference), rel=1e-6)
