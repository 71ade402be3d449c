"""Factors to the units of a `Recording`: m/s^2, rad/s, microtesla, seconds, metres."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pedjax.errors import InputError, suggest
from pedjax.recording import STANDARD_GRAVITY

ACCELERATION = {"m/s^2": 1.0, "m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}
ANGULAR_RATE = {"rad/s": 1.0, "deg/s": float(np.pi / 180.0), "dps": float(np.pi / 180.0)}
MAGNETIC_FIELD = {
    "uT": 1.0,
    "µT": 1.0,
    "microtesla": 1.0,
    "nT": 1e-3,
    "T": 1e6,
    "gauss": 100.0,
    "milligauss": 0.1,
}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}


def factor(unit: str, table: Mapping[str, float], where: str) -> float:
    """The factor of that unit, or an `InputError` that begins with `where`."""
    if unit in table:
        return table[unit]
    raise InputError(f"{where}: unit '{unit}' is unknown{suggest(unit, table)}")
