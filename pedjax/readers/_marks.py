"""Landmarks out of a TOML: `[[landmarks]]`, `landmarks_file`, `return_to_start`, in the frame it names."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pedjax.errors import InputError
from pedjax.readers import _table
from pedjax.readers._file import load
from pedjax.readers._settings import Table
from pedjax.recording import Landmarks

KEYS = ("return_to_start", "landmarks", "landmarks_file", "landmarks_sensor", "frame")

FRAMES = {
    "ENU": np.eye(3),
    "NED": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    "left-handed z-up": np.diag([1.0, -1.0, 1.0]),
}
"""What turns a position of that frame into east, north, up (or any right-handed frame with z up)."""


def frame(top: Table) -> str:
    """The navigation frame that positions in this TOML are given in."""
    table = top.table("frame")
    table.only("navigation")
    return table.choice("navigation", FRAMES, "ENU")


def turned(position: np.ndarray, name: str) -> np.ndarray:
    """Positions `(N, 3)` of that frame in ENU; an unknown coordinate stays unknown."""
    matrix = FRAMES[name]
    order = np.abs(matrix).argmax(axis=1)
    # column by column: a matrix product would spread the NaN
    return position[:, order] * matrix[np.arange(3), order]


def landmarks(top: Table, time: np.ndarray, unit: float = 1.0) -> Landmarks | None:
    """The landmarks of this TOML; `time` is the clock that samples count, `unit` the seconds of its times."""
    if len(time) == 0:
        raise InputError(f"{top.where}: the first sensor has no samples; check the columns it names")
    times: list[float] = []
    places: list[list[float]] = []
    for entry in top.tables("landmarks"):
        entry.only("time", "sample", "position")
        times.append(_time(entry, time, unit))
        places.append(_position(entry))
    if top.get("landmarks_file", "text") is not None:
        more, where = _file(top, time, unit)
        times.extend(more)
        places.extend(where)
    position = turned(np.array(places, dtype=float).reshape(-1, 3), frame(top))
    if top.get("return_to_start", "true or false", False):
        times.extend([float(time[0]), float(time[-1])])
        position = np.concatenate([position, np.zeros((2, 3))])
    if not times:
        return None
    return Landmarks(np.array(times), position, top.get("landmarks_sensor", "text"))


def _time(entry: Table, time: np.ndarray, unit: float) -> float:
    if ("time" in entry.values) == ("sample" in entry.values):
        raise InputError(f"{entry.where}: give either 'time' or 'sample'")
    if "time" in entry.values:
        return unit * float(entry.get("time", "a number"))
    return _at(entry.get("sample", "a whole number"), time, f"{entry.where}: sample")


def _at(sample: int, time: np.ndarray, where: str) -> float:
    if not 0 <= sample < len(time):
        raise InputError(
            f"{where} {sample} lies outside the recording (0 to {len(time) - 1}); correct the number"
        )
    return float(time[sample])


def _position(entry: Table) -> list[float]:
    values = entry.need("position", "a list")
    if len(values) not in (2, 3):
        raise InputError(f"{entry.where}: 'position' has {len(values)} numbers; give [x, y] or [x, y, z]")
    return [_coordinate(value, entry.where) for value in (*values, "?")[:3]]


def _coordinate(value: Any, where: str) -> float:
    if value == "?":
        return math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f'{where}: coordinate {value!r} is no number; write "?" for an unknown one')
    return float(value)


def _file(top: Table, time: np.ndarray, unit: float) -> tuple[list[float], list[list[float]]]:
    file = load(top.folder / top.get("landmarks_file", "text"))
    names = _table.cells(file.lines[0], ",")
    clock = "time" if "time" in names else "sample"
    x, y = (_table.column(file.name, names, name) for name in "xy")
    use = [_table.column(file.name, names, clock), x, y]
    if "z" in names:
        use.append(names.index("z"))
    table = _table.numbers(file.name, file.lines[1:], 2, names, use, empty_as_nan=True)
    if "z" not in names:
        table = np.hstack([table, np.full((len(table), 1), np.nan)])
    if clock == "time":
        times = [unit * float(value) for value in table[:, 0]]
    else:
        if not np.isfinite(table[:, 0]).all():
            raise InputError(
                f"{file.name}: column 'sample' has empty cells; give a sample for every landmark"
            )
        times = [_at(int(value), time, f"{file.name}: sample") for value in table[:, 0]]
    return times, table[:, 1:].tolist()
