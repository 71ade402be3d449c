"""Hard and soft iron of a sensor turned through all attitudes: the ellipsoid of its raw field.

    raw = b + K⁻¹ m + noise,  |m| = F:    (x - b)ᵀ W (x - b) = 1,  W = Kᵀ K / F²

Three algebraic fits give b and W, `refine` makes them the least-squares ones in |m|. K follows from W up to
a rotation (`factor`), which gravity settles (alignment.py). Fits take `mag (N, 3)` µT and a weight each.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax.calibration.algebra import (
    clean,
    constrained,
    least_squares,
    mean,
    minimise,
    norm,
    rms,
    root,
    safe_divide,
    scatter,
    solve,
    standardise,
    symmetric_root,
)

FEWEST = 9
"""Points below which an ellipsoid is not determined."""

FACTORS = ("symmetric", "upper")

_FLATTEST = 1e-6  # ratio of the squared half axes below which a quadric is no ellipsoid


class Ellipsoid(NamedTuple):
    """(x - centre)ᵀ shape (x - centre) = 1: `centre (3,)` µT, `shape (3, 3)` 1/µT². `positive` is false
    where the fit gave no ellipsoid; it is then the least-squares sphere."""

    centre: Array
    shape: Array
    positive: Array


class Quality(NamedTuple):
    """`residual` µT, RMS of |m| - F; `axes (3,)` µT, half axes in ascending order; `coverage`, the smallest
    eigenvalue of the mean u uᵀ over the calibrated directions u (1/3 at best); `flatness`, the smallest
    share of an axis in the cloud's own variance (0 for a plane); `condition` number of the algebraic fit."""

    residual: Array
    axes: Array
    coverage: Array
    flatness: Array
    condition: Array


def algebraic(mag: ArrayLike, weights: Array | None = None) -> Ellipsoid:
    """Least squares of [x², y², z², 2yz, 2xz, 2xy, 2x, 2y, 2z] p = 1, centred and scaled.

    Linear, so its gradients are the safest.
    """
    x, w, centre, size = _standard(mag, weights)
    p = least_squares(_squares(x), jnp.ones_like(w), w)
    return _ellipsoid(_form(p[:3], p[3:6]), p[6:], jnp.asarray(-1.0, x.dtype), x, w, centre, size)


def clsef(mag: ArrayLike, weights: Array | None = None) -> Ellipsoid:
    """Constrained least squares of Fang et al. 2011: the x-y section is an ellipse, 4 a1 a3 - a2² = 1.

    Prefers the x-y plane of the sensor; here as the baseline of Ma 2018.
    """
    x, w, centre, size = _standard(mag, weights)
    a, b, c = x.T
    one = jnp.ones_like(a)
    design = jnp.stack([a * a, a * b, b * b, a * c, b * c, c * c, a, b, c, one], axis=-1)
    plane = np.array([[0.0, 0.0, 2.0], [0.0, -1.0, 0.0], [2.0, 0.0, 0.0]])
    p = _eliminated(design, w, plane)
    form = _form(p[jnp.array([0, 2, 5])], p[jnp.array([4, 3, 1])] / 2)
    return _ellipsoid(form, p[6:9] / 2, p[9], x, w, centre, size)


def li_griffiths(mag: ArrayLike, weights: Array | None = None, k: float = 4.0) -> Ellipsoid:
    """Li and Griffiths 2004: k J - I² = 1 (k = 4 is an ellipsoid for certain, if no axis is under half of
    another)."""
    x, w, centre, size = _standard(mag, weights)
    design = jnp.concatenate([_squares(x), jnp.ones_like(x[:, :1])], axis=-1)
    block = np.zeros((6, 6))
    block[:3, :3] = (k / 2 - 1) * (1 - np.eye(3)) - np.eye(3)
    block[3:, 3:] = -k * np.eye(3)
    p = _eliminated(design, w, block)
    return _ellipsoid(_form(p[:3], p[3:6]), p[6:9], p[9], x, w, centre, size)


FITS = {"algebraic": algebraic, "clsef": clsef, "li-griffiths": li_griffiths}
"""The algebraic fits by name."""


def refine(start: Ellipsoid, mag: ArrayLike, weights: Array | None = None, iterations: int = 30) -> Ellipsoid:
    """The ellipsoid that minimises the sum of w (|K (x - b)| - F)², from `start`: nine parameters, b and an
    upper triangular K."""
    x, w, centre, size = _standard(mag, weights)
    upper = jnp.linalg.cholesky(start.shape).T * size
    corner = np.triu_indices(3)
    first = jnp.concatenate([(start.centre - centre) / size, upper[corner]])

    def residual(p: Array, points: Array) -> Array:
        factor_ = jnp.zeros((3, 3), p.dtype).at[corner].set(p[3:])
        return norm((points - p[:3]) @ factor_.T) - 1

    p = minimise(residual, first, x, w, iterations)
    factor_ = jnp.zeros((3, 3), p.dtype).at[corner].set(p[3:]) / size
    return Ellipsoid(centre + size * p[:3], factor_.T @ factor_, start.positive)


def factor(ellipsoid: Ellipsoid, field: ArrayLike | None = None, form: str = "symmetric") -> Array:
    """K `(3, 3)` with Kᵀ K = F² W, `symmetric` (turns nothing) or `upper` triangular (Ma 2018, table 1).

    F is `field` in µT; by default the geometric mean of the half axes, so that K keeps volumes.
    """
    if form not in FACTORS:
        raise ValueError(f"form '{form}' is none of {', '.join(FACTORS)}")
    f = strength(ellipsoid) if field is None else jnp.asarray(field)
    half = symmetric_root(ellipsoid.shape) if form == "symmetric" else jnp.linalg.cholesky(ellipsoid.shape).T
    return f * half


def strength(ellipsoid: Ellipsoid) -> Array:
    """Geometric mean of the half axes in µT."""
    return jnp.linalg.det(ellipsoid.shape) ** (-1 / 6)


def quality(ellipsoid: Ellipsoid, mag: ArrayLike, weights: Array | None = None) -> Quality:
    """How well points `(N, 3)` µT lie on it, in µT at the geometric mean of its axes, and how they spread."""
    x, w = clean(jnp.asarray(mag), weights)
    k = factor(ellipsoid)
    m = (x - ellipsoid.centre) @ k.T
    size = norm(m)
    u = safe_divide(m, size[:, None])
    away = scatter(x - mean(x, w), w)
    standard, _, _ = standardise(x, w)
    design = _squares(standard)
    gram = jnp.linalg.eigvalsh(jnp.einsum("n,ni,nj->ij", w, design, design))
    return Quality(
        rms(size - strength(ellipsoid), w),
        jnp.linalg.eigvalsh(ellipsoid.shape)[::-1] ** -0.5,
        jnp.linalg.eigvalsh(scatter(u, w))[0],
        safe_divide(jnp.linalg.eigvalsh(away)[0], jnp.trace(away)),
        root(safe_divide(gram[-1], jnp.maximum(gram[0], jnp.finfo(x.dtype).eps * gram[-1]))),
    )


def _standard(mag: ArrayLike, weights: Array | None) -> tuple[Array, Array, Array, Array]:
    """Points about their mean and over their spread, weights, mean, spread."""
    points, w = clean(jnp.asarray(mag), weights)
    x, centre, size = standardise(points, w)
    return x, w, centre, size


def _squares(p: Array) -> Array:
    x, y, z = p.T
    return jnp.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z], axis=-1)


def _form(diagonal: Array, off: Array) -> Array:
    """Symmetric matrix from its diagonal and its yz, xz and xy entries."""
    (a, b, c), (f, g, h) = diagonal, off
    return jnp.stack([jnp.stack([a, h, g]), jnp.stack([h, b, f]), jnp.stack([g, f, c])])


def _eliminated(design: Array, weights: Array, constraint: np.ndarray) -> Array:
    """p `(10,)` that minimises |design p| under a quadratic constraint on its first entries."""
    n = len(constraint)
    g = scatter(design, weights)
    inner = solve(g[n:, n:], g[n:, :n])
    reduced = g[:n, :n] - g[:n, n:] @ inner
    head = constrained(0.5 * (reduced + reduced.T), jnp.asarray(constraint, design.dtype))
    return jnp.concatenate([head, -inner @ head])


def _ellipsoid(
    form: Array, half: Array, last: Array, x: Array, weights: Array, centre: Array, size: Array
) -> Ellipsoid:
    """xᵀ form x + 2 half x + last = 0 in standard points; the best sphere where it is no ellipsoid."""
    sign = jnp.where(jnp.trace(form) < 0, -1.0, 1.0).astype(form.dtype)
    form, half, last = sign * form, sign * half, sign * last
    minors = jnp.stack([form[0, 0], jnp.linalg.det(form[:2, :2]), jnp.linalg.det(form)])
    trace = jnp.trace(form) / 3
    limit = _FLATTEST * jnp.stack([trace, trace**2, trace**3])
    identity = jnp.eye(3, dtype=form.dtype)
    definite = (minors > limit).all() & jnp.isfinite(form).all()
    safe = jnp.where(definite, form, identity)
    middle = -solve(safe, jnp.where(definite, half, 0.0))
    height = middle @ safe @ middle - jnp.where(definite, last, -1.0)
    positive = definite & (height > 0)
    height = jnp.where(positive, height, 1.0)
    design = jnp.concatenate([2 * x, jnp.ones_like(x[:, :1])], axis=-1)
    ball = least_squares(design, jnp.sum(x * x, axis=-1), weights)
    square = ball[3] + jnp.sum(ball[:3] ** 2)
    square = jnp.where(square > 0, square, 1.0)
    return Ellipsoid(
        centre + size * jnp.where(positive, middle, ball[:3]),
        jnp.where(positive, safe / height, identity / square) / size**2,
        positive,
    )
