"""gaitmap tables: acc [m/s^2], gyr [deg/s], perhaps mag, of one foot or of two (header rows sensor, axis).

The index column is in samples (204.8 Hz unless the name says otherwise) or in seconds. Of two feet one is
'foot', as every foot recording has it: the left one, or the one that `sensor` names. The other keeps its
side: 'foot_right' or 'foot_left'. How the unit sat on the shoe is not written down, so `up` is unknown.
"""

from __future__ import annotations

import re

import numpy as np

from pedjax.errors import InputError, suggest
from pedjax.readers import _table
from pedjax.readers._file import File
from pedjax.recording import Recording, Sensor, Stream

_RATE = 204.8
_RATES_BY_NAME = {"l_walks": 400.0, "imu_sample_ms": 102.4}
_CHANNELS = [f"{kind}_{axis}" for kind in ("acc", "gyr", "mag") for axis in "xyz"]


def recognises(file: File) -> bool:
    """Whether it is such a table, with one header row or with two."""
    return any({"acc_x", "gyr_x"} <= set(_table.cells(line, ",")) for line in file.head[:2])


def read(file: File, sensor: str | None = None) -> Recording:
    """The sensors of the table; `sensor` names the one that becomes 'foot' (left_sensor, right_sensor)."""
    rows = 1 if "acc_x" in _table.cells(file.lines[0], ",") else 2
    axes = _table.cells(file.lines[rows - 1], ",")
    sides = _table.cells(file.lines[0], ",") if rows == 2 else ["foot"] * len(axes)
    if len(sides) != len(axes):
        raise InputError(
            f"{file.name}: the header rows have {len(sides)} and {len(axes)} columns; repair the header"
        )
    names = [f"{side} {axis}".strip() for side, axis in zip(sides, axes, strict=True)]
    numbered = axes[0] not in _CHANNELS
    found = list(dict.fromkeys(side for side, axis in zip(sides, axes, strict=True) if axis in _CHANNELS))
    table = _table.numbers(
        file.name, file.lines[rows:], rows + 1, names, range(len(names)), empty_as_nan=True
    )
    time, notes = _time(file, table[:, 0] if numbered else np.arange(len(table), dtype=float))
    chosen = _chosen(file, found, sensor)
    sensors = {}
    for side in [chosen, *(other for other in found if other != chosen)]:
        key = "foot" if side == chosen else "foot_" + _side(side)
        sensors[key] = _sensor(file, time, table, names, side, notes)
    if len(found) > 1:
        notes.append("sensors: " + ", ".join(f"'{key}' is {side}" for key, side in _named(found, chosen)))
    return Recording(file.stem, sensors, format="gaitmap", notes=tuple(notes))


def _named(found: list[str], chosen: str) -> list[tuple[str, str]]:
    return [("foot", chosen), *(("foot_" + _side(other), other) for other in found if other != chosen)]


def _side(name: str) -> str:
    return name.removesuffix("_sensor")


def _chosen(file: File, found: list[str], sensor: str | None) -> str:
    if sensor is None or (len(found) == 1 and sensor == "foot"):
        return next((name for name in found if _side(name) == "left"), found[0])
    for name in found:
        if sensor in (name, _side(name), "foot_" + _side(name), _side(name) + "_foot"):
            return name
    raise InputError(f"{file.name}: there is no sensor '{sensor}'{suggest(sensor, found)}")


def _time(file: File, index: np.ndarray) -> tuple[np.ndarray, list[str]]:
    steps = np.diff(index)
    step = float(np.median(steps)) if len(steps) else 1.0
    if step != 1.0:
        if 0.0 < step < 0.1:
            return index, []
        raise InputError(
            f"{file.name}: the first column steps by {step:g}, which is neither samples nor seconds; "
            f"describe the file in {file.name}.toml"
        )
    stated = re.search(r"(\d+(?:\.\d+)?)\s*hz", file.stem, re.IGNORECASE)
    rate = float(stated[1]) if stated else _RATE
    rate = next((known for part, known in _RATES_BY_NAME.items() if part in file.stem), rate)
    return index / rate, [f"the table counts samples: taken as {rate:g} Hz"]


def _sensor(
    file: File, time: np.ndarray, table: np.ndarray, names: list[str], side: str, notes: list[str]
) -> Sensor:
    def values(kind: str) -> np.ndarray:
        return table[:, [_table.column(file.name, names, f"{side} {kind}_{axis}") for axis in "xyz"]]

    magnetometer = None
    if f"{side} mag_x" in names:
        field = values("mag")
        size = float(np.nanmedian(np.linalg.norm(field, axis=1))) if np.isfinite(field).any() else 0.0
        if size > 5.0:
            magnetometer = Stream(time, field)
        else:
            notes.append(f"{side}: magnetometer dropped: its size of {size:.2f} is in no physical unit")
    return Sensor(Stream(time, values("acc")), Stream(time, np.deg2rad(values("gyr"))), magnetometer)
