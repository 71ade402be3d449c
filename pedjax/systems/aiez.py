"""AIEZ (Zhang, Guo and Liu): a compass where the field is pure, a heading heuristic where it is not.

IEZ, tilt by the force of a standing foot, AIEZ's own field detector with an electronic compass, and the
heuristic beside it.
"""

from __future__ import annotations

from pedjax.aids import COMPASS
from pedjax.aids.assembly import aided
from pedjax.aids.heading_heuristic import HEADING_HEURISTIC
from pedjax.aids.tilt import TILT
from pedjax.aids.zero_velocity import ZERO_ANGULAR_RATE, ZERO_VELOCITY
from pedjax.filters.inertial import INERTIAL

VALUES = {
    "initial.bias": ("rest", "kit choice: what the gyroscope reads before the first step is its bias"),
    "initial.gyroscope_bias": (2e-3, "kit choice: 0.1 deg/s, a unit that is not calibrated to the last"),
    "initial.accelerometer_bias": (0.1, "kit choice"),
    "updates.zero_velocity": (0.05, "kit choice: how a foot moves in the last samples of a made stance"),
    "field.detector": ("aiez", "Zhang"),
    "field.window": (1, "kit choice: a look is tested by itself; Zhang: N is not printed"),
    "compass.looking.levelling": ("attitude", "kit choice; Zhang, Eq. 20-24: force"),
    "compass.noise.floor": (0.07, "kit choice"),
    "compass.recovery": ("rivals", "kit choice; Zhang has none"),
    "heuristic.form": ("slope", "kit choice; Zhang: hdr"),
}
"""Defaults that are not those of its parts."""

AIEZ = aided(
    "aiez",
    INERTIAL,
    (ZERO_VELOCITY, ZERO_ANGULAR_RATE, TILT, *COMPASS, HEADING_HEURISTIC),
    "IEZ with compass or heading heuristic",
    values=VALUES,
)
