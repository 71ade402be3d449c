"""Small algebra of the fits, with finite gradients where a fit is degenerate.

Points come first, `(N, D)`, with a weight each; a weight of zero is padding, whatever the point holds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from pedjax import lanes

stop = jax.lax.stop_gradient


def norm(x: Array) -> Array:
    """Length of `x (..., D)`; its gradient at zero is zero."""
    return lanes.norm(x, axis=-1)


def root(x: Array) -> Array:
    """Square root; zero with zero gradient where `x` is not positive."""
    return lanes.root(jnp.where(x > 0, x, 0.0))


def angle(y: Array, x: Array) -> Array:
    """atan2(y, x); at the origin zero with zero gradient."""
    zero = x * x + y * y <= jnp.finfo(jnp.result_type(x, y)).tiny
    return jnp.arctan2(jnp.where(zero, 0.0, y), jnp.where(zero, 1.0, x))


def safe_divide(a: Array, b: Array) -> Array:
    """a / b, zero where b is zero."""
    zero = b == 0
    return jnp.where(zero, 0.0, a / jnp.where(zero, 1.0, b))


def clean(points: Array, weights: Array | None) -> tuple[Array, Array]:
    """Points and their weights (default one each), with zeros where the weight is zero."""
    weights = jnp.ones_like(points[:, 0]) if weights is None else jnp.asarray(weights, points.dtype)
    return jnp.where(weights[:, None] > 0, points, 0.0), weights


def mean(x: Array, weights: Array) -> Array:
    """Weighted mean over the points of `x (N, ...)`."""
    flat = weights.reshape(weights.shape + (1,) * (x.ndim - 1))
    return safe_divide(jnp.sum(flat * x, axis=0), jnp.sum(weights))


def rms(x: Array, weights: Array) -> Array:
    """Weighted root mean square of `x (N,)`."""
    return root(mean(x * x, weights))


def scatter(x: Array, weights: Array) -> Array:
    """Weighted second moment `(D, D)` of `x (N, D)`."""
    return jnp.einsum("n,ni,nj->ij", safe_divide(weights, jnp.sum(weights)), x, x)


def standardise(points: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Points about their mean, over their RMS distance from it: `(N, D)`, mean `(D,)`, scale.

    Without it the squares of a cloud far from the origin swamp what is fitted.
    """
    centre = mean(points, weights)
    away = points - centre
    size = rms(norm(away), weights)
    size = jnp.where(size > 0, size, 1.0)
    return jnp.where(weights[:, None] > 0, away / size, 0.0), centre, size


def _with_ridge(matrix: Array, share: float) -> Array:
    """A symmetric matrix with this share of its trace added to the diagonal (to a zero one, the share)."""
    size = jnp.trace(jnp.abs(matrix))
    size = jnp.where(size > jnp.finfo(matrix.dtype).tiny, size, 1.0)
    return matrix + share * size * jnp.eye(matrix.shape[0], dtype=matrix.dtype)


def solve(matrix: Array, right: Array) -> Array:
    """Solution of a symmetric system; a ridge of rounding size keeps it finite where there is none."""
    return jnp.linalg.solve(_with_ridge(matrix, float(jnp.finfo(matrix.dtype).eps)), right)


def least_squares(design: Array, target: Array, weights: Array) -> Array:
    """x that minimises sum of w (design x - target)² for `design (N, P)`, `target (N,)`.

    Normal equations with a ridge, which bounds the slopes where points do not determine x; three refinements
    take the ridge, and the digits lost by squaring, out where they do.
    """
    gram = jnp.einsum("n,ni,nj->ij", weights, design, design)
    inverse = jnp.linalg.inv(_with_ridge(gram, float(jnp.finfo(design.dtype).eps) ** 0.75))
    x = jnp.zeros(design.shape[1], design.dtype)
    for _ in range(4):
        x = x + inverse @ jnp.einsum("n,ni,n->i", weights, design, target - design @ x)
    return x


def constrained(moment: Array, constraint: Array) -> Array:
    """a that minimises aᵀ M a under aᵀ C a = 1, for M `(P, P)` positive semidefinite and C with one positive
    eigenvalue.

    The eigenvectors come from a symmetric problem without a gradient; one Newton step on
    (M - l C) a = 0, aᵀ C a = 1 then carries the exact one, also where other eigenvalues coincide.
    """
    size, dtype = moment.shape[0], moment.dtype
    held, scale = stop(moment), stop(jnp.trace(moment)) + jnp.finfo(dtype).tiny
    small = 10 * jnp.finfo(dtype).eps
    lower = jnp.linalg.cholesky(held / scale + small * jnp.eye(size, dtype=dtype))
    inverse = jnp.linalg.inv(lower)
    pencil = inverse @ constraint @ inverse.T
    _, vectors = jnp.linalg.eigh(0.5 * (pencil + pencil.T))
    a = inverse.T @ vectors[:, -1]
    a = a / norm(a)
    fixed = a @ constraint @ a
    a = a / root(fixed)
    multiplier = a @ held @ a
    a, multiplier = (jnp.where(jnp.isfinite(x).all(), x, jnp.ones_like(x)) for x in (a, multiplier))

    pull = constraint @ a
    bordered = jnp.block(
        [[(held - multiplier * constraint) / scale, -pull[:, None]], [-pull[None], jnp.zeros((1, 1), dtype)]]
    )
    wrong = jnp.concatenate([(moment @ a - multiplier * pull) / scale, jnp.zeros(1, dtype)])
    return a - _indefinite(bordered, wrong)[:size]


def _indefinite(matrix: Array, right: Array) -> Array:
    """Solution of a small square system, zero where it is singular."""
    x = jnp.linalg.solve(matrix, stop(right))
    good = jnp.isfinite(x).all()
    held = jnp.where(good, matrix, jnp.eye(matrix.shape[0], dtype=matrix.dtype))
    return jnp.where(good, jnp.linalg.solve(held, right), 0.0)


def symmetric_root(matrix: Array) -> Array:
    """Symmetric K with K K = `matrix (n, n)`, positive definite.

    One Newton step from the eigenvectors' root carries the gradient, finite where eigenvalues coincide.
    """
    n, dtype = matrix.shape[0], matrix.dtype
    values, vectors = jnp.linalg.eigh(stop(matrix))
    least = jnp.finfo(dtype).eps * jnp.abs(values[-1]) + jnp.finfo(dtype).tiny
    k = (vectors * jnp.sqrt(jnp.maximum(values, least))) @ vectors.T
    one = jnp.eye(n, dtype=dtype)
    step = jnp.linalg.solve(jnp.kron(k, one) + jnp.kron(one, k), (matrix - k @ k).reshape(-1))
    found = k + step.reshape(n, n)
    return 0.5 * (found + found.T)


def minimise(
    residual: Callable[[Array, Any], Array], start: Array, data: Any, weights: Array, iterations: int = 30
) -> Array:
    """x `(P,)` that minimises sum of w residual(x, data)² by Levenberg-Marquardt, from `start`.

    A fixed number of steps, each kept where it lowers the sum. The search itself has no gradient: a last
    Newton step x - H⁻¹ g, zero in value at the minimum, carries the exact derivative by data and weights.
    """

    def cost(x: Array, data: Any, weights: Array) -> Array:
        r = residual(x, data)
        return 0.5 * jnp.sum(weights * r * r)

    held, w = stop(data), stop(weights)
    eps = jnp.finfo(start.dtype).eps

    def step(_: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        x, damping, best = state
        r, jacobian = residual(x, held), jax.jacfwd(residual)(x, held)
        gram = jnp.einsum("n,ni,nj->ij", w, jacobian, jacobian)
        diagonal = jnp.diag(gram) + eps * jnp.trace(gram) + jnp.finfo(x.dtype).tiny
        new = x - jnp.linalg.solve(gram + jnp.diag(damping * diagonal), jacobian.T @ (w * r))
        found = cost(new, held, w)
        better = found < best  # false for NaN
        damping = jnp.clip(jnp.where(better, 0.2 * damping, 5 * damping), 1e3 * eps, 1e8)
        return jnp.where(better, new, x), damping, jnp.where(better, found, best)

    first = stop(start)
    opening = (first, jnp.asarray(1e-3, start.dtype), cost(first, held, w))
    x, _, best = jax.lax.fori_loop(0, iterations, step, opening)
    hessian = jax.hessian(cost)(x, held, w)
    last = x - solve(hessian, jax.grad(cost)(x, data, weights))
    better = cost(stop(last), held, w) <= best * (1 + 1e-6)  # nearer than the sum of squares resolves
    value = jnp.where(better, stop(last), x)
    return value + (last - stop(last))
