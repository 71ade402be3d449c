"""Aids by name: what can be put on a filter. `aid` says what one is, `assembly` how they go together."""

from __future__ import annotations

from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.aids.assembly import aided
from pedjax.aids.bounded_velocity import BOUNDED_VELOCITY
from pedjax.aids.field_reference import FIELD_REFERENCE
from pedjax.aids.gravity_update import GRAVITY_UPDATE
from pedjax.aids.heading_heuristic import HEADING_HEURISTIC
from pedjax.aids.initial_alignment import INITIAL_ALIGNMENT, START_CHECK
from pedjax.aids.magnetic_heading import FIELD_RATE, MAGNETIC_HEADING
from pedjax.aids.steps import STEPS
from pedjax.aids.tilt import TILT
from pedjax.aids.zero_velocity import ZERO_ANGULAR_RATE, ZERO_VELOCITY
from pedjax.errors import InputError, suggest

COMPASS = (INITIAL_ALIGNMENT, MAGNETIC_HEADING, START_CHECK, FIELD_RATE)
"""What goes by the magnetic field, in the order in which they build on each other."""

_OURS = (
    ZERO_VELOCITY, ZERO_ANGULAR_RATE, TILT, *COMPASS, HEADING_HEURISTIC,
    GRAVITY_UPDATE, BOUNDED_VELOCITY, FIELD_REFERENCE, STEPS,
)  # fmt: skip

AIDS: dict[str, Aid] = {each.name: each for each in _OURS}


def register_aid(aid: Aid) -> Aid:
    """Make an aid of your own known by its name, for configs that list aids."""
    AIDS[aid.name] = aid
    return aid


def find_aid(name: str) -> Aid:
    """The aid of that name; an unknown one is an `InputError` with a suggestion."""
    if name not in AIDS:
        raise InputError(f"aid '{name}' is unknown{suggest(name, AIDS)}")
    return AIDS[name]


__all__ = [
    "AIDS", "BOUNDED_VELOCITY", "COMPASS", "FIELD_RATE", "FIELD_REFERENCE", "GRAVITY_UPDATE",
    "HEADING_HEURISTIC", "INITIAL_ALIGNMENT", "MAGNETIC_HEADING", "START_CHECK", "STEPS", "TILT",
    "ZERO_ANGULAR_RATE", "ZERO_VELOCITY", "Aid", "Measured", "Seen", "aided", "find_aid", "register_aid",
]  # fmt: skip
