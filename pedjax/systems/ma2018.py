"""Ma 2018: the ZUPT-EKF with the heading of a quasi-static magnetic field.

IEZ at every sample; once in each stance a look at the field, a detector over the last looks, and where the
field is quasi-static the magnetic heading as a further row. Zero velocity and heading are updated one after
the other, which for independent noises is the stacked update of the paper (Eq. 35-38).

The same parts give the systems it is compared with: field.detector = "iqsf" or "qsf", and compass.update =
"none", pure ZUPT.
"""

from __future__ import annotations

from pedjax.aids.assembly import aided
from pedjax.aids.magnetic_heading import FIELD_RATE, MAGNETIC_HEADING
from pedjax.aids.zero_velocity import ZERO_ANGULAR_RATE, ZERO_VELOCITY
from pedjax.filters.inertial import INERTIAL

MA2018 = aided(
    "ma2018",
    INERTIAL,
    (ZERO_VELOCITY, ZERO_ANGULAR_RATE, MAGNETIC_HEADING, FIELD_RATE),
    "ZUPT-EKF with quasi-static magnetic heading",
)
