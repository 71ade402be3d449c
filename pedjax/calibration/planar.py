"""Hard and soft iron of a walked loop, from one levelled horizontal field per stance (Ma 2018, 2.3).

The stances' points lie on an ellipse with centre o, half axes a > b, the long one at angle eta:

    corrected = L (m - o),    tau = b / a

`minmax` is the paper's recipe with atan2 in Eq. 8 (its arc sine loses the sign of m_x); its circle has the
radius b. `lsq`, the default, fits the conic by least squares; `soft` is `minmax` with smooth extremes. Both
`lsq` and what falls back on a circle keep the area, so that the radius is sqrt(a b).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax.calibration.algebra import (
    angle,
    clean,
    least_squares,
    mean,
    norm,
    rms,
    root,
    safe_divide,
    scatter,
    solve,
    standardise,
)

FEWEST = {"lsq": 5, "minmax": 4, "soft": 4}
"""Points below which a method says nothing."""

_SLIMMEST = 1e-3  # tau below which a conic is no ellipse but a line
_LINE = 1e-4  # ratio of the two spreads (squared) below which points lie on a line


class Planar(NamedTuple):
    """`offset (2,)` µT, `matrix (2, 2)`, `radius` µT of the corrected circle, `eta` rad in (-pi/2, pi/2],
    `tau` = b / a, `residual` RMS distance from the circle in µT, `gap` rad between neighbours in azimuth at
    most. Flags: `ellipse`, otherwise a circle was fitted; `enough` points, not all on one line."""

    offset: Array
    matrix: Array
    radius: Array
    eta: Array
    tau: Array
    residual: Array
    gap: Array
    ellipse: Array
    enough: Array


def lsq(points: ArrayLike, weights: Array | None = None) -> Planar:
    """Least-squares conic [x², xy, y², x, y] p = 1 through `points (K, 2)` µT; a circle where it is no
    ellipse."""
    given, w = clean(jnp.asarray(points), weights)
    p, centre, size = standardise(given, w)
    x, y = p[:, 0], p[:, 1]
    one = jnp.ones_like(x)
    conic = least_squares(jnp.stack([x * x, x * y, y * y, x, y], axis=-1), one, w)
    quadratic = jnp.stack([jnp.stack([conic[0], conic[1] / 2]), jnp.stack([conic[1] / 2, conic[2]])])
    trace, det = conic[0] + conic[2], conic[0] * conic[2] - conic[1] ** 2 / 4
    ellipse = (det > (_SLIMMEST * trace) ** 2) & (trace > 0)
    quadratic = jnp.where(ellipse, quadratic, jnp.eye(2, dtype=p.dtype))
    middle = -0.5 * solve(quadratic, jnp.where(ellipse, conic[3:], 0.0))
    height = 1 + middle @ quadratic @ middle  # positive with the quadratic form
    root_, eta, tau = _root(quadratic / height)

    round_ = least_squares(jnp.stack([2 * x, 2 * y, one], axis=-1), x * x + y * y, w)
    radius_round = root(round_[2] + round_[0] ** 2 + round_[1] ** 2)
    radius_ellipse = jnp.linalg.det(root_) ** -0.5
    radius = size * jnp.where(ellipse, radius_ellipse, radius_round)
    matrix = jnp.where(ellipse, radius_ellipse * root_, jnp.eye(2, dtype=p.dtype))
    offset = centre + size * jnp.where(ellipse, middle, round_[:2])
    return _told(given, w, offset, matrix, radius, eta, tau, ellipse, FEWEST["lsq"])


def _root(w: Array) -> tuple[Array, Array, Array]:
    """Symmetric root of a positive definite `w (2, 2)`, and angle and ratio of the ellipse xᵀ w x = 1."""
    half, cross, both = 0.5 * (w[0, 0] - w[1, 1]), w[0, 1], 0.5 * (w[0, 0] + w[1, 1])
    det = w[0, 0] * w[1, 1] - cross * cross
    s = root(det)
    found = (w + s * jnp.eye(2, dtype=w.dtype)) / root(2 * both + 2 * s)
    apart = norm(jnp.stack([half, cross]))
    tau = root(jnp.maximum(both - apart, 0.0) / (both + apart))
    return found, 0.5 * angle(-2 * cross, -2 * half), tau


def minmax(points: ArrayLike, weights: Array | None = None) -> Planar:
    """Ma 2018, Eq. 6-12: centre between the extremes of x and y, axes at the farthest and the nearest
    point. Its slopes are those of the points at the extremes."""
    given, w = clean(jnp.asarray(points), weights)
    known = (w > 0) | ~(w > 0).any()
    high = jnp.max(jnp.where(known[:, None], given, -jnp.inf), axis=0)
    low = jnp.min(jnp.where(known[:, None], given, jnp.inf), axis=0)
    offset = 0.5 * (high + low)
    away = given - offset
    r = norm(away)
    far = jnp.argmax(jnp.where(known, r, -jnp.inf))
    near = jnp.argmin(jnp.where(known, r, jnp.inf))
    eta = _half_turn(angle(away[far, 1], away[far, 0]))
    tau = safe_divide(r[near], r[far])
    matrix = _squeeze(eta, tau)
    return _told(given, w, offset, matrix, r[near], eta, tau, tau > _SLIMMEST, FEWEST["minmax"])


def soft(points: ArrayLike, temperature: ArrayLike = 1.0, weights: Array | None = None) -> Planar:
    """`minmax` with smooth extremes: t log sum exp(x / t) for the largest of x, whose excess cancels in the
    centre; the long axis and the radii from means with weights softmax(± r / t).

    `temperature` t in µT, best at about twice the noise of a stance (kit choice: 1). As t goes to 0 this
    becomes `minmax` wherever the farthest and the nearest point, and each extreme of x and y, is a single
    one. With log sum exp for the radii too, tau would be low by 0.09 where t is 1 µT.
    """
    given, w = clean(jnp.asarray(points), weights)
    t = jnp.asarray(temperature, given.dtype)
    present = jnp.where((w > 0).any(), w, 1.0)

    def largest(x: Array) -> Array:
        return t * jax.nn.logsumexp(x / t, axis=0, b=present[:, None])

    def share(x: Array) -> Array:
        return present * jax.nn.softmax(jnp.where(present > 0, x / t, -jnp.inf))

    offset = 0.5 * (largest(given) - largest(-given))
    away = given - offset
    r = norm(away)
    s = scatter(away, share(r))
    eta = 0.5 * angle(2 * s[0, 1], s[0, 0] - s[1, 1])
    far, near = mean(r, share(r)), mean(r, share(-r))
    tau = safe_divide(near, far)
    return _told(given, w, offset, _squeeze(eta, tau), near, eta, tau, tau > _SLIMMEST, FEWEST["soft"])


METHODS = {"lsq": lsq, "minmax": minmax, "soft": lambda points, weights=None: soft(points, weights=weights)}
"""The methods by name; each takes points and weights."""


def _half_turn(eta: Array) -> Array:
    """The same axis as an angle in (-pi/2, pi/2]."""
    return 0.5 * angle(jnp.sin(2 * eta), jnp.cos(2 * eta))


def _squeeze(eta: Array, tau: Array) -> Array:
    """Rᵀ diag(tau, 1) R: shortens by tau along the axis at eta (Ma 2018, Eq. 9-12)."""
    c, s = jnp.cos(eta), jnp.sin(eta)
    axis = jnp.stack([c, s])
    return jnp.eye(2, dtype=axis.dtype) - (1 - tau) * axis[:, None] * axis[None]


def azimuth_gap(points: Array, weights: Array) -> Array:
    """Largest angle in rad between neighbours of `points (K, 2)` as seen from the origin."""
    known = weights > 0
    turn = angle(points[:, 1], points[:, 0])
    turn = jnp.sort(jnp.where(known, turn, turn[jnp.argmax(known)]))  # padding repeats a point
    return jnp.maximum(jnp.max(jnp.diff(turn), initial=0.0), 2 * jnp.pi - (turn[-1] - turn[0]))


def _told(
    points: Array, weights: Array, offset: Array, matrix: Array, radius: Array, eta: Array, tau: Array,
    ellipse: Array, fewest: int,
) -> Planar:  # fmt: skip
    """The fit with what is said about it."""
    corrected = (points - offset) @ matrix.T
    residual = rms(norm(corrected) - radius, weights)
    spread = scatter(points - mean(points, weights), weights)
    det = spread[0, 0] * spread[1, 1] - spread[0, 1] ** 2
    line = det <= _LINE * (spread[0, 0] + spread[1, 1]) ** 2
    enough = (jnp.sum(weights > 0) >= fewest) & ~line
    tau, eta = jnp.where(ellipse, tau, 1.0), jnp.where(ellipse, eta, 0.0)
    return Planar(
        offset, matrix, radius, eta, tau, residual, azimuth_gap(corrected, weights), ellipse, enough
    )
