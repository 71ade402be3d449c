"""IEZ: inertial navigation with a 15-state error-state EKF and zero-velocity updates (INS-EKF-ZUPT).

A heading heuristic can be set beside (`heuristic.form`), as in the IEZ+ of Jimenez 2010; it is off.
Published defaults: the stance detector of PyShoe, the filter noises of OpenShoe and PyShoe.
"""

from __future__ import annotations

from pedjax.aids.assembly import aided
from pedjax.aids.heading_heuristic import HEADING_HEURISTIC
from pedjax.aids.zero_velocity import ZERO_ANGULAR_RATE, ZERO_VELOCITY
from pedjax.filters.inertial import INERTIAL

IEZ = aided("iez", INERTIAL, (ZERO_VELOCITY, ZERO_ANGULAR_RATE, HEADING_HEURISTIC), "INS-EKF-ZUPT")
