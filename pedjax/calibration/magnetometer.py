"""What a calibration is, in two parts: of the sensor in body axes, and of the levelled field in stance.

    body:     m = K (raw - b)          (turned through all attitudes; ellipsoid.py)
    levelled: m = L (m_level - o)      (a walked loop, Ma 2018, Eq. 6-12; planar.py)

Either may be the identity. The levelled part is measured behind the body part.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


class Calibration(NamedTuple):
    """`hard_iron (3,)` µT and `matrix (3, 3)` in body axes; `level_offset (2,)` µT and
    `level_matrix (2, 2)` for the horizontal field of the levelled body."""

    hard_iron: Array
    matrix: Array
    level_offset: Array
    level_matrix: Array


def uncalibrated() -> Calibration:
    """The identity."""
    return Calibration(jnp.zeros(3), jnp.eye(3), jnp.zeros(2), jnp.eye(2))


def apply(calibration: Calibration, mag: ArrayLike) -> Array:
    """Body part: K (raw - b) for `mag (..., 3)` µT in body axes."""
    return (jnp.asarray(mag) - calibration.hard_iron) @ calibration.matrix.T
