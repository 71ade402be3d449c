"""The systems by name: one file each, nothing but the assembly of the parts."""

from __future__ import annotations

from collections.abc import Sequence

from pedjax.aids import find_aid
from pedjax.aids.assembly import aided
from pedjax.errors import InputError, suggest
from pedjax.filters.euler import EULER
from pedjax.filters.inertial import INERTIAL
from pedjax.filters.orientation import BOUNDED, ORIENTATION
from pedjax.system import System
from pedjax.systems.aiez import AIEZ
from pedjax.systems.iez import IEZ
from pedjax.systems.ma2018 import MA2018
from pedjax.systems.munoz_diaz import MUNOZ_DIAZ, MUNOZ_DIAZ_TWIN, POCKET
from pedjax.systems.wang import WANG

SYSTEMS: dict[str, System] = {
    each.name: each for each in (IEZ, MA2018, AIEZ, WANG, MUNOZ_DIAZ, MUNOZ_DIAZ_TWIN, POCKET)
}

_OURS = frozenset(SYSTEMS)

FILTERS = {each.name: each for each in (INERTIAL, EULER, ORIENTATION, BOUNDED)}
"""What aids can be put on, by name."""


def register_system(system: System) -> System:
    """Make a system of your own known by its name; one of the package's cannot be replaced."""
    if system.name in _OURS:
        raise InputError(f"the system '{system.name}' comes with pedjax; give yours another name")
    SYSTEMS[system.name] = system
    return system


def system(name: str | System) -> System:
    """The system of that name; an unknown one is an `InputError` with a suggestion."""
    if isinstance(name, System):
        return name
    if name not in SYSTEMS:
        raise InputError(f"system '{name}' is unknown{suggest(name, SYSTEMS)}")
    return SYSTEMS[name]


def assembled(name: str, filter: str, aids: Sequence[str]) -> System:
    """The system made of a filter and aids by their names, as a config asks for it; registered as `name`."""
    if filter not in FILTERS:
        raise InputError(f"system '{name}': filter '{filter}' is unknown{suggest(filter, FILTERS)}")
    known = SYSTEMS.get(name)
    made = aided(name, FILTERS[filter], [find_aid(aid) for aid in aids])
    if known is not None and known.title == made.title and known.gates == made.gates:
        return known  # the same once more: programs are compiled for one object
    return register_system(made)
