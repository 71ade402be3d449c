"""OpenShoe `data_inert.txt`: a MicroStrain 3DM-GX2 in the sole, 17 columns between white space, z up.

Specific force in g, angular rate in rad/s, magnetic field in gauss. Time comes from the sensor's own counter
(19.6608 MHz: 78720 ticks are 4.0039 ms); the host's stamps jitter by up to 20 ms. The counter starts anew
every second, and there the median step is taken. Walks end where they start.
"""

from __future__ import annotations

import numpy as np

from pedjax.errors import InputError
from pedjax.readers import _table
from pedjax.readers._file import File
from pedjax.recording import STANDARD_GRAVITY, Landmarks, Recording, Sensor, Stream

_TICKS_PER_SECOND = 19_660_800.0
_MICROTESLA_PER_GAUSS = 100.0
_NAMES = (
    *("tag", "a_x", "a_y", "a_z", "ar_x", "ar_y", "ar_z", "Counter", "Checksum", "Nr"),
    *("Filtered ts", "Unfiltered ts", "Pred. ts", "Freq.", "m_x", "m_y", "m_z"),
)
_USE = (1, 2, 3, 4, 5, 6, 7, 14, 15, 16)


def recognises(file: File) -> bool:
    """Whether it is an OpenShoe table."""
    return any(line.split()[:1] == ["0xcb"] for line in file.head)


def read(file: File) -> Recording:
    """A loop as sensor 'foot', with a landmark at the start and the same one at the end."""
    notes = []
    start = next((i for i, line in enumerate(file.lines) if line.split()[:1] == ["0xcb"]), None)
    if start is None:
        raise InputError(f"{file.name}: there is no row that starts with the tag 0xcb")
    rows = file.lines[start:]
    if len(rows) > 1 and (len(rows[-1].split()) != len(_NAMES) or not file.text.endswith(("\n", "\r"))):
        rows = rows[:-1]  # logging stopped within the row, perhaps within its last number
        notes.append("the last row is cut off and was dropped")
    table = _table.numbers(file.name, rows, start + 1, _NAMES, _USE, delimiter=None)
    time = _time(table[:, 6])
    known = np.isfinite(table[:, 7:]).all(axis=1)
    magnetometer = None
    if known.any():
        magnetometer = Stream(time[known], _MICROTESLA_PER_GAUSS * table[known, 7:])
        if not known.all():
            notes.append(f"{int((~known).sum())} samples without a magnetic field left that stream")
    sensor = Sensor(
        Stream(time, STANDARD_GRAVITY * table[:, :3]), Stream(time, table[:, 3:6]), magnetometer, up="+z"
    )
    landmarks = Landmarks(time[[0, -1]], np.zeros((2, 3)), "foot")
    return Recording(file.stem, {"foot": sensor}, landmarks=landmarks, format="openshoe", notes=tuple(notes))


def _time(counter: np.ndarray) -> np.ndarray:
    steps = np.diff(counter)
    forward = steps[steps > 0]
    usual = float(np.median(forward)) if len(forward) else 0.0
    # the counter has two lengths of turn; a step back, or far ahead of one lost second, says nothing
    steps = np.where((steps > 0) & (steps < _TICKS_PER_SECOND), steps, usual)
    return np.concatenate([[0.0], np.cumsum(steps)]) / _TICKS_PER_SECOND
