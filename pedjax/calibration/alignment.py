"""The rotation between magnetometer and accelerometer: the inclination of the field is the same in every
attitude, so that f̂ · R m is a constant, -F sin(inclination)."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax import rotations
from pedjax.calibration.algebra import (
    angle,
    clean,
    mean,
    minimise,
    norm,
    rms,
    root,
    safe_divide,
    scatter,
    stop,
)


class Alignment(NamedTuple):
    """`rotation (3, 3)` from the magnetometer's to the accelerometer's axes, `constant` of f̂ · R m in µT,
    `residual` RMS about it in µT, `inclination` rad (down positive), `sigma` rad: the standard deviation of
    the worst known axis, were the residuals independent."""

    rotation: Array
    constant: Array
    residual: Array
    inclination: Array
    sigma: Array


def align(mag: ArrayLike, force: ArrayLike, weights: Array | None = None, iterations: int = 20) -> Alignment:
    """R that minimises the variance of f̂ · R m over calibrated `mag (N, 3)` µT and specific force `(N, 3)`
    at rest. Searched from no rotation and from the one nearest to the best linear map."""
    m, w = clean(jnp.asarray(mag), weights)
    f, _ = clean(jnp.asarray(force), w)
    up = safe_divide(f, norm(f)[:, None])
    size = rms(norm(m), w)
    size = jnp.where(size > 0, size, 1.0)
    data = (up, m / size)

    def deviation(phi: Array, data: tuple[Array, Array, Array, Array]) -> Array:
        up, m, start, weights = data
        along = jnp.einsum("ni,ij,nj->n", up, start @ rotations.exp(phi), m)
        return along - mean(along, weights)

    def search(start: Array) -> Array:
        phi = minimise(deviation, jnp.zeros(3, m.dtype), (*data, start, w), w, iterations)
        return start @ rotations.exp(phi)

    starts = jnp.stack([jnp.eye(3, dtype=m.dtype), _linear(stop(up), stop(data[1]), stop(w))])
    found = jax.lax.map(search, starts)
    along = jnp.einsum("ni,sij,nj->sn", up, found, m)
    spread = jnp.stack([rms(a - mean(a, w), w) for a in along])
    best = jnp.argmin(spread)
    rotation, constant = found[best], mean(along[best], w)
    jacobian = jax.jacfwd(deviation)(jnp.zeros(3, m.dtype), (*data, rotation, w))
    weakest = jnp.linalg.eigvalsh(scatter(jacobian, w))[0]
    sigma = spread[best] / size * root(1 / jnp.maximum(weakest, jnp.finfo(m.dtype).eps))
    across = root(size**2 - constant**2)
    return Alignment(
        rotation,
        constant,
        spread[best],
        angle(-constant, across),
        sigma / root(jnp.sum(w > 0).astype(m.dtype)),
    )


def _linear(up: Array, m: Array, weights: Array) -> Array:
    """The rotation nearest to the matrix B for which f̂ᵀ B m varies least, compared with its size."""
    products = (up[:, :, None] * m[:, None]).reshape(len(m), 9)
    design = jnp.concatenate([products, jnp.ones_like(m[:, :1])], axis=-1)
    _, vectors = jnp.linalg.eigh(scatter(design, weights))
    b = vectors[:9, 0].reshape(3, 3)
    b = jnp.where(jnp.linalg.det(b) < 0, -b, b)
    left, _, right = jnp.linalg.svd(b)
    turn = jnp.array([1.0, 1.0, 1.0], m.dtype).at[2].set(jnp.linalg.det(left @ right))
    return (left * turn) @ right
