"""Landmark errors after the nuisance that an inertial filter cannot know: yaw and origin.

Lanes last: estimates `(K, 3, *L)` in m, references broadcast against them. Alignments are closed forms and
differentiable, so that a tuned parameter is never paid for a better yaw.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from pedjax.lanes import align as lanes_last
from pedjax.lanes import root

ALIGNMENTS = ("none", "yaw", "yaw_translation")
"""`none`: both frames are taken as one. `yaw`: the first known points are laid on each other, then the best
rotation about that point. `yaw_translation`: best rotation and shift of all points."""


class Reference(NamedTuple):
    """Where the walker truly was: `position (K, 3, *L)` m, 0 where unknown; `horizontal (K, *L)` and
    `vertical (K, *L)` are 1 where x and y, or z, are known, else 0 (also for padding). Where headings are
    scored, `attitude (K, 3, 3, *L)` body to navigation, and `oriented (K, *L)`, 1 where it is known."""

    position: Array
    horizontal: Array
    vertical: Array
    attitude: Array | None = None
    oriented: Array | None = None


class Errors(NamedTuple):
    """Errors in m, `(*L)` each: horizontal RMS, mean, maximum and last; RMS in space where all three are
    known (NaN where nowhere); and PyShoe's ARMSE, the mean over points of the RMS over the two axes."""

    rms_2d: Array
    mean_2d: Array
    max_2d: Array
    final_2d: Array
    rms_3d: Array
    armse: Array


def _mean(x: Array, weight: Array) -> Array:
    """Weighted mean over points; 0 where no point counts."""
    return jnp.sum(x * weight, axis=0) / jnp.maximum(jnp.sum(weight, axis=0), 1e-9)


def _first(x: Array, weight: Array) -> Array:
    """The value at the first point that counts."""
    pick = (weight > 0) & (jnp.cumsum(weight, axis=0) <= 1)
    return jnp.sum(jnp.where(pick, x, 0.0), axis=0)


def onto(reference: Reference, lanes: int) -> Reference:
    """The reference with unit axes for lanes that only the estimate has, `lanes` axes in all."""
    attitude, oriented = reference.attitude, reference.oriented
    return Reference(
        lanes_last(reference.position, 2, lanes),
        lanes_last(reference.horizontal, 1, lanes),
        lanes_last(reference.vertical, 1, lanes),
        None if attitude is None else lanes_last(attitude, 3, lanes),
        None if oriented is None else lanes_last(oriented, 1, lanes),
    )


def align(estimate: Array, reference: Reference, alignment: str) -> Array:
    """The estimate `(K, 3, *L)` laid on the reference. Heights are matched with the origin or the mean."""
    if alignment == "none":
        return estimate
    reference = onto(reference, estimate.ndim - 2)
    anchor = _first if alignment == "yaw" else _mean
    x, y, z = estimate[:, 0], estimate[:, 1], estimate[:, 2]
    rx, ry, rz = reference.position[:, 0], reference.position[:, 1], reference.position[:, 2]
    h, v = reference.horizontal, reference.vertical
    x, y = x - anchor(x, h), y - anchor(y, h)
    ax, ay = anchor(rx, h), anchor(ry, h)
    px, py = rx - ax, ry - ay
    cosine, sine = jnp.sum(h * (x * px + y * py), axis=0), jnp.sum(h * (x * py - y * px), axis=0)
    size_square = cosine * cosine + sine * sine
    turns = size_square > 0  # a single point, or a loop seen only where it closes, fixes no yaw
    size = jnp.sqrt(jnp.where(turns, size_square, 1.0))
    cosine, sine = jnp.where(turns, cosine / size, 1.0), jnp.where(turns, sine / size, 0.0)
    shift = jnp.where(jnp.sum(v, axis=0) > 0, anchor(rz, v) - anchor(z, v), 0.0)
    return jnp.stack([cosine * x - sine * y + ax, sine * x + cosine * y + ay, z + shift], axis=1)


def landmark_errors(estimate: Array, reference: Reference, alignment: str = "yaw_translation") -> Errors:
    """Errors of positions `(K, 3, *L)` at the landmarks, after alignment."""
    reference = onto(reference, estimate.ndim - 2)
    difference = align(estimate, reference, alignment) - reference.position
    square = difference[:, 0] ** 2 + difference[:, 1] ** 2
    h = reference.horizontal * jnp.ones_like(square)
    both = h * reference.vertical
    distance = root(square)
    last = (h > 0) & (jnp.cumsum(h[::-1], axis=0)[::-1] <= 1)
    cube = root(_mean(square + difference[:, 2] ** 2, both))
    return Errors(
        rms_2d=root(_mean(square, h)),
        mean_2d=_mean(distance, h),
        max_2d=jnp.max(jnp.where(h > 0, distance, 0.0), axis=0),
        final_2d=jnp.sum(jnp.where(last, distance, 0.0), axis=0),
        rms_3d=jnp.where(jnp.sum(both, axis=0) > 0, cube, jnp.nan),
        armse=_mean(distance, h) / jnp.sqrt(2.0),
    )
