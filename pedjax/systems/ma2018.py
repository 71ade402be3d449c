"""Ma 2018: the ZUPT-EKF with the heading of a quasi-static magnetic field.

IEZ at every sample; once in each stance a look at the field, a detector over the last looks, and where the
field is quasi-static the magnetic heading as a further row. Zero velocity and heading are updated one after
the other, which for independent noises is the stacked update of the paper (Eq. 35-38).

The same parts give the systems it is compared with: field.detector = "iqsf" or "qsf", and compass.update =
"none", pure ZUPT. A heading heuristic beside (`heuristic.form`) is off.

The paper prints no noises. A zero velocity of 0.01 m/s, IEZ's, is not true of a foot that begins to lift
before the detector sees it: in made walks the last samples of a stance move at 0.01 to 0.08 m/s, always
forward and up. Told as certain to 0.01 m/s they drive tilt and accelerometer bias to a degree, which in a
steep field is two of heading; told as they are, the attitude levels a field better than the force does.
"""

from __future__ import annotations

from pedjax.aids import COMPASS
from pedjax.aids.assembly import aided
from pedjax.aids.heading_heuristic import HEADING_HEURISTIC
from pedjax.aids.zero_velocity import ZERO_ANGULAR_RATE, ZERO_VELOCITY
from pedjax.filters.inertial import INERTIAL

VALUES = {
    "updates.zero_velocity": (0.07, "kit choice: how a foot moves in the last samples of a made stance"),
    "initial.accelerometer_bias": (0.3, "OpenShoe"),
    "compass.looking.levelling": ("attitude", "kit choice; Ma 2018, Eq. 3-5: force"),
}
"""Defaults that are not those of its parts."""

MA2018 = aided(
    "ma2018",
    INERTIAL,
    (ZERO_VELOCITY, ZERO_ANGULAR_RATE, *COMPASS, HEADING_HEURISTIC),
    "ZUPT-EKF with quasi-static magnetic heading",
    values=VALUES,
)
