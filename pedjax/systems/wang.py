"""Wang 2018: a start aligned by gradient descent, and a compensated magnetic heading whose noise adapts.

Zero velocities; the first attitude by AGDA; a magnetic heading in every stance, which allows for the size of
the start's disturbance and counts less the less it is expected. No detector has a say. As published, but for
the corrections that `calibration.attitude`, `filters.compensation` and `filters.adaptive` tell of, the
innovation law among them (the printed one is inert in rad²); the start is as sure as the settings say.

The paper prints no noise, no gain and no window.
"""

from __future__ import annotations

from pedjax.aids import COMPASS
from pedjax.aids.assembly import aided
from pedjax.aids.heading_heuristic import HEADING_HEURISTIC
from pedjax.aids.zero_velocity import ZERO_ANGULAR_RATE, ZERO_VELOCITY
from pedjax.filters.inertial import INERTIAL

VALUES = {
    "initial.alignment": ("agda", "Wang 2018"),
    "initial.align.covariance": ("given", "Wang 2018: not told"),
    "initial.gyroscope_bias": (3.5e-3, "Wang 2018, Table 1: 0.2 deg/s"),
    "initial.accelerometer_bias": (0.03, "Wang 2018, Table 1"),
    "updates.zero_velocity": (0.05, "kit choice: how a foot moves in the last samples of a made stance"),
    "field.detector": ("none", "Wang 2018"),
    "compass.start_sigma": (0.01, "kit choice: as an aligned start is without a disturbance"),
    "compass.looking.per": ("sample", "Wang 2018: at each zero velocity"),
    "compass.looking.levelling": ("attitude", "Wang 2018, Eq. 6"),
    "compass.reference": ("given", "Wang 2018: looked up"),
    "compass.compensation.mode": ("magnitude", "Wang 2018, Eq. 7-8"),
    "compass.adaptive.law": ("innovation", "kit choice; Wang 2018, Eq. 10: trace"),
}
"""Defaults that are not those of its parts."""

WANG = aided(
    "wang",
    INERTIAL,
    (ZERO_VELOCITY, ZERO_ANGULAR_RATE, *COMPASS, HEADING_HEURISTIC),
    "ZUPT-EKF with aligned start and adaptive magnetic heading",
    values=VALUES,
)
