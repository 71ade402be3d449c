"""Whether a magnetic field is steady: its strength does not depend on how the sensor is turned."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from pedjax.windows import trailing


class Readings(NamedTuple):
    """Of a magnetometer: `field (T, 3)` µT in body axes, zero where there is no reading, `known (T,)` 1 where
    there is one, and `spread (T,)` µT, the largest strength less the smallest over a trailing window."""

    field: Array
    known: Array
    spread: Array


def readings(field: Array, width: int) -> Readings:
    """Of a field `(T, 3)`, NaN where there is no reading, and a window of that many samples, in which a
    missing reading makes the spread as large as numbers go."""
    known = jnp.isfinite(field).all(axis=1)
    whole = jnp.where(known[:, None], field, 0.0)
    size = jnp.sqrt(jnp.sum(whole * whole, axis=1))
    far = jnp.finfo(field.dtype).max / 1e8
    high = trailing(jnp.maximum, jnp.where(known, size, far), width)
    low = trailing(jnp.minimum, jnp.where(known, size, 0.0), width)
    return Readings(whole, known.astype(field.dtype), high - low)
