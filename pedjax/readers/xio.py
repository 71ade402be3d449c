"""x-io csv: `Time (s)`, `Gyroscope X (deg/s)`, `Accelerometer X (g)`, perhaps `Magnetometer X (uT)`; z up.

The stamps are the instrument's own (a grid of 2.51 ms); where a sample was lost the one before it stands
twice with the same stamp, and the next comes after the gap. So the stamps are taken as they are and the
repeats dropped. The file knows no truth; a walk that ends at its start says so in a sidecar
(`return_to_start = true`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from pedjax.errors import InputError
from pedjax.readers import _table, _units
from pedjax.readers._file import File
from pedjax.recording import Recording, Sensor, Stream

_COLUMN = re.compile(r"^(Time|Timestamp|(?:Gyroscope|Accelerometer|Magnetometer) [XYZ]) \(([^)]*)\)$")


def recognises(file: File) -> bool:
    """Whether it is an x-io table."""
    return bool(file.head) and "Gyroscope X (" in file.head[0] and "Accelerometer X (" in file.head[0]


def read(file: File) -> Recording:
    """A table as sensor 'foot'; units are those of the header."""
    names = _table.cells(file.lines[0], ",")
    found: dict[str, tuple[int, str]] = {}
    for index, name in enumerate(names):
        match = _COLUMN.match(name)
        if match:
            found[match[1].replace("Timestamp", "Time")] = (index, match[2])
    wanted = [f"{kind} {axis}" for kind in ("Gyroscope", "Accelerometer") for axis in "XYZ"]
    for name in ["Time", *wanted]:
        if name not in found:
            raise InputError(
                f"{file.name}: there is no column '{name} (unit)'; the header has {', '.join(names)}"
            )
    magnetic = [f"Magnetometer {axis}" for axis in "XYZ"]
    notes = []
    if "Magnetometer X" in found and found["Magnetometer X"][1] not in _units.MAGNETIC_FIELD:
        notes.append(f"magnetometer dropped: its unit '{found['Magnetometer X'][1]}' is not a physical one")
    elif all(name in found for name in magnetic):
        wanted += magnetic
    use = [found[name][0] for name in ["Time", *wanted]]
    table = _table.numbers(file.name, file.lines[1:], 2, names, use)
    time = table[:, 0] * _units.factor(found["Time"][1], _units.TIME, f"{file.name}: column 'Time'")

    def stream(kind: str, start: int, units: Mapping[str, float]) -> Stream:
        factors = [
            _units.factor(found[f"{kind} {a}"][1], units, f"{file.name}: column '{kind} {a}'") for a in "XYZ"
        ]
        return Stream(time, table[:, start : start + 3] * np.array(factors))

    sensor = Sensor(
        stream("Accelerometer", 4, _units.ACCELERATION),
        stream("Gyroscope", 1, _units.ANGULAR_RATE),
        stream("Magnetometer", 7, _units.MAGNETIC_FIELD) if len(wanted) == 9 else None,
        up="+z",
    )
    return Recording(file.stem, {"foot": sensor}, format="x-io", notes=tuple(notes))
