"""What a calibration is, in two parts: of the sensor in body axes, and of the levelled field in stance.

    body:     m = K (raw - b)          (turned through all attitudes; ellipsoid.py)
    levelled: m = L (m_level - o)      (a walked loop, Ma 2018, Eq. 6-12; planar.py)

Either may be the identity. The levelled part is measured behind the body part.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax.lanes import add

AXES = "xyz"
"""Names of the body axes."""


class Calibration(NamedTuple):
    """`hard_iron (3,)` µT and `matrix (3, 3)` in body axes; `level_offset (2,)` µT and
    `level_matrix (2, 2)` for the horizontal field of the levelled body, whose x is the level direction of the
    body axis `level_ahead` (0, 1, 2)."""

    hard_iron: Array
    matrix: Array
    level_offset: Array
    level_matrix: Array
    level_ahead: int = 0


def uncalibrated() -> Calibration:
    """The identity."""
    return Calibration(jnp.zeros(3), jnp.eye(3), jnp.zeros(2), jnp.eye(2))


def corrected(field: Sequence[Array], offset: Sequence[Any], matrix: Sequence[Sequence[Any]]) -> list[Array]:
    """Either part, matrix (field - offset), number by number: n of the `field` and its `offset` in µT, n rows
    of n of the `matrix`, each with any lanes."""
    away = [m - b for m, b in zip(field, offset, strict=True)]
    return [add(k * x for k, x in zip(row, away, strict=True)) for row in matrix]


def apply(calibration: Calibration, mag: ArrayLike) -> Array:
    """Body part: K (raw - b) for `mag (..., 3)` µT in body axes."""
    raw = jnp.moveaxis(jnp.asarray(mag), -1, 0)
    return jnp.stack(corrected(list(raw), list(calibration.hard_iron), list(calibration.matrix)), axis=-1)
