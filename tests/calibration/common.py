"""What the tests of calibration share: Ma's table 1, functions compiled once, slopes by differences."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pedjax.calibration import alignment, ellipsoid, planar

K_C = np.array([[1.027, 0.037, 0.046], [0, 1.018, -0.002], [0, 0, 1.062]])
B_C = np.array([143.36, 79.75, -56.41])  # mGs, as printed; a fit knows no unit
STRENGTH = 480.0

jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
"""Tests compile longer than they run."""


def padded(function, sizes):
    """`function(*arrays, weights)` compiled for few sizes: rows of NaN without weight fill them up."""
    compiled = jit(function)

    def run(*args, weights=None):
        first = next(a for a in args if isinstance(a, np.ndarray))
        fill = next(n for n in sizes if n >= len(first)) - len(first)
        known = np.ones(len(first)) if weights is None else weights
        arrays = [
            np.concatenate([a, np.full((fill, a.shape[1]), np.nan, a.dtype)])
            if isinstance(a, np.ndarray)
            else a
            for a in args
        ]
        found = compiled(*arrays, np.concatenate([known, np.zeros(fill)]).astype(first.dtype))
        return jax.tree.map(np.asarray, found)

    return run


FITS = {name: padded(fit, (64, 512)) for name, fit in ellipsoid.FITS.items()}
PLANAR = {name: padded(fit, (32,)) for name, fit in planar.METHODS.items()}
soft = padded(lambda points, temperature, weights: planar.soft(points, temperature, weights), (32,))
refine = padded(lambda start, points, weights: ellipsoid.refine(start, points, weights), (64, 512))
quality = padded(ellipsoid.quality, (64, 512))
align = padded(alignment.align, (80,))
factor = jit(ellipsoid.factor, static_argnames="form")


def directions(rng, count):
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def table_one(rng, count, noise):
    """Raw field of a sensor with the distortion of Ma's table 1 (CLSEF), turned at random."""
    clean = directions(rng, count) @ np.linalg.inv(K_C).T * STRENGTH + B_C
    return clean + noise * rng.normal(size=clean.shape)


def sloped(function):
    """`function(x, weights)`, which gives a vector and anything, with the slope of the vector's part along
    `pick`: compiled `(x, weights, pick) -> (value, anything), slopes`."""

    def value(x, weights, pick):
        vector, rest = function(x, weights)
        return jnp.sum(pick * vector), rest

    return jit(jax.value_and_grad(value, (0, 1), has_aux=True))


def assert_slopes(compiled, x, count, rng, rtol=1e-6, h=1e-4, atol=1e-9):
    """Slopes of a `sloped` function with `count` results along random directions of points and weights,
    against fourth-order differences."""
    weights = rng.uniform(0.5, 1.5, len(x))
    for _ in range(2):
        pick, way, turn = rng.normal(size=count), rng.normal(size=x.shape), rng.normal(size=len(x)) / 100
        ends = [compiled(x + k * h * way, weights + k * h * turn, pick)[0][0] for k in (-2, -1, 1, 2)]
        expected = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
        by_x, by_w = compiled(x, weights, pick)[1]
        np.testing.assert_allclose(np.sum(by_x * way) + np.sum(by_w * turn), expected, rtol=rtol, atol=atol)
