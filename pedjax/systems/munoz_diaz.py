"""Munoz Diaz 2017: gyroscope biases from magnetic fields, for a sensor in a trouser pocket.

`munoz_diaz` is the paper: Euler angles and AR(1) biases, absolute gravity and differential magnetic updates,
each behind its detector. `munoz_diaz_twin` is the same on rotation matrices, which no phone that hangs
upright in a pocket can bring to a singularity, with the field as a state. `pocket` is what finds the heading
of real pockets: the velocity is bounded rather than the force gravity, hard iron is a state, and each reading
of the field counts the less the odder it is."""

from __future__ import annotations

from pedjax.aids.assembly import aided
from pedjax.aids.bounded_velocity import BOUNDED_VELOCITY
from pedjax.aids.field_reference import FIELD_REFERENCE
from pedjax.aids.gravity_update import GRAVITY_UPDATE
from pedjax.aids.steps import STEPS
from pedjax.filters.euler import EULER
from pedjax.filters.orientation import BOUNDED, ORIENTATION

MUNOZ_DIAZ = aided(
    "munoz_diaz",
    EULER,
    (GRAVITY_UPDATE, FIELD_REFERENCE, STEPS),
    "Euler EKF with gravity and differential magnetic updates, in a pocket",
    role="pocket",
    values={"zero_acceleration.rows": ("angles", "Munoz Diaz 2017, Eq. 12-14")},
)
"""As published, with the differential update transposed."""

MUNOZ_DIAZ_TWIN = aided(
    "munoz_diaz_twin",
    ORIENTATION,
    (GRAVITY_UPDATE, FIELD_REFERENCE, STEPS),
    "attitude EKF with gravity and a field that is estimated, in a pocket",
    role="pocket",
    values={"reference.form": ("state", "kit choice; Munoz Diaz 2017: differential")},
)
"""The same without angles, and with the field as a state."""

POCKET = aided(
    "pocket",
    BOUNDED,
    (BOUNDED_VELOCITY, FIELD_REFERENCE, STEPS),
    "attitude EKF with bounded velocity, hard iron and a wandering field, in a pocket",
    role="pocket",
    values={
        "process.gyroscope": (7e-3, "kit choice: a phone in a pocket"),
        "process.gyroscope_scale": (2e-3, "kit choice"),
        "process.gyroscope_bias": (1.6e-4, "kit choice"),
        "initial.attitude": (0.1, "kit choice: a pocket that may be moving"),
        "initial.gyroscope_bias": (1.4e-2, "kit choice: 0.8 deg/s"),
        "steps.ahead": ("learned", "kit choice: a phone hangs as it likes"),
        "reference.form": ("state", "kit choice"),
        "reference.density": (2.9, "kit choice: a room's field beside a swinging leg"),
        "reference.detector": ("odd", "kit choice"),
        "reference.state.walk": (0.05, "kit choice"),
        "reference.state.deviates": (False, "kit choice"),
        "reference.state.iron": (True, "kit choice"),
        "reference.state.start": ("expected", "kit choice"),
    },
)
"""For phones in real pockets."""
