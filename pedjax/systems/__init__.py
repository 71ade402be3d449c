"""The systems by name: one file each, nothing but the assembly of the parts."""

from __future__ import annotations

from pedjax.errors import InputError, suggest
from pedjax.system import System
from pedjax.systems.iez import IEZ
from pedjax.systems.ma2018 import MA2018

SYSTEMS: dict[str, System] = {each.name: each for each in (IEZ, MA2018)}


def system(name: str | System) -> System:
    """The system of that name; an unknown one is an `InputError` with a suggestion."""
    if isinstance(name, System):
        return name
    if name not in SYSTEMS:
        raise InputError(f"system '{name}' is unknown{suggest(name, SYSTEMS)}")
    return SYSTEMS[name]
