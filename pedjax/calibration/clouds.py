"""What a calibration is fitted to: the field of one sensor, with its specific force where that is known.

From a `Recording`, from a folder of phone streams (`magnetometer.txt`: time s and raw x, y, z µT in its first
columns; `accelerometer.txt`: time s, x, y, z m/s²), or from plain rows of numbers `x y z` or `t x y z` µT.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from pedjax.errors import InputError
from pedjax.readers import _table
from pedjax.readers._file import File, load
from pedjax.recording import Recording, Sensor, Stream

SMOOTH_S = 0.3
"""Specific force is averaged over this time before it is held against gravity (kit choice)."""

_MOST_SPREAD = 0.5  # m/s² of |f| within the average, and
_MOST_OFF = 0.3  # m/s² of it from the median of the quiet ones, for a sample to count as at rest


@dataclass(frozen=True)
class Cloud:
    """`name`, `time (N,)` s, `field (N, 3)` µT; `force (N, 3)` m/s² averaged about each sample, or None;
    `quiet (N,)`: where it is gravity alone; `recorded`: the day, where the data say so."""

    name: str
    time: np.ndarray
    field: np.ndarray
    force: np.ndarray | None = None
    quiet: np.ndarray | None = None
    recorded: str | None = None

    def between(self, start: float, end: float) -> Cloud:
        """The samples between two times in s."""
        keep = (self.time >= start) & (self.time <= end)
        if not keep.any():
            raise InputError(
                f"{self.name}: --between {start:g} {end:g} holds no sample; the data go from "
                f"{self.time[0]:.3f} to {self.time[-1]:.3f} s"
            )
        force, quiet = (None if x is None else x[keep] for x in (self.force, self.quiet))
        return replace(self, time=self.time[keep], field=self.field[keep], force=force, quiet=quiet)


def cloud(
    name: str, magnetometer: Stream, accelerometer: Stream | None, recorded: str | None = None
) -> Cloud:
    """A cloud of the magnetometer's samples, with the specific force where both streams exist."""
    if accelerometer is None:
        return Cloud(name, magnetometer.time, magnetometer.values, recorded=recorded)
    time, force = accelerometer.time, accelerometer.values
    width = max(round(SMOOTH_S * accelerometer.rate), 1)
    kernel = np.ones(width)
    size = np.linalg.norm(force, axis=1)
    if len(time) < width:
        return Cloud(name, magnetometer.time, magnetometer.values, recorded=recorded)
    share = np.convolve(np.ones(len(time)), kernel, mode="same")  # fewer samples count at the ends
    smooth, mean, square = (
        np.stack([np.convolve(c, kernel, mode="same") / share for c in np.atleast_2d(x)])
        for x in (force.T, size, size**2)
    )
    spread = np.sqrt(np.maximum(square[0] - mean[0] ** 2, 0.0))
    steady = spread < _MOST_SPREAD
    at_rest = np.linalg.norm(smooth, axis=0)
    gravity = np.median(at_rest[steady]) if steady.any() else np.nan
    good = steady & (np.abs(at_rest - gravity) < _MOST_OFF)
    good[: width // 2 + 1] = good[len(good) - width // 2 - 1 :] = False  # no whole average there
    at = np.clip(np.searchsorted(time, magnetometer.time), 1, len(time) - 1)
    inside = (magnetometer.time >= time[0]) & (magnetometer.time <= time[-1])
    near = np.stack([np.interp(magnetometer.time, time, column) for column in smooth], axis=-1)
    return Cloud(
        name, magnetometer.time, magnetometer.values, near, good[at] & good[at - 1] & inside, recorded
    )


def of_sensor(name: str, sensor: Sensor) -> Cloud:
    """The cloud of a recording's sensor."""
    if sensor.magnetometer is None:
        raise InputError(f"{name}: it has no magnetometer; name another --sensor or recording")
    return cloud(name, sensor.magnetometer, sensor.accelerometer)


def is_cloud(path: str) -> bool:
    """Whether the path is a folder of phone streams, or plain rows of three or four numbers."""
    place = Path(path)
    if place.is_dir():
        return (place / "magnetometer.txt").exists()
    if not place.is_file():
        return False
    try:
        head = load(place).head
    except InputError:
        return False
    rows = [line.replace(",", " ").split() for line in head[:-1] or head if line.strip()]
    return bool(rows) and all(len(row) in (3, 4) and _numeric(row) for row in rows)


def read(path: str) -> Cloud:
    """Read such a folder or file."""
    place = Path(path)
    if place.is_dir():
        streams = [_rows(load(place / f"{kind}.txt"), (4, 7)) for kind in ("magnetometer", "accelerometer")
                   if (place / f"{kind}.txt").exists()]  # fmt: skip
        forces = Stream(streams[1][:, 0], streams[1][:, 1:4]) if len(streams) > 1 else None
        return cloud(place.name, Stream(streams[0][:, 0], streams[0][:, 1:4]), forces, _day(place))
    file = load(place)
    table = _rows(file, (3, 4))
    time = table[:, 0] if table.shape[1] == 4 else np.arange(len(table), dtype=float)
    return cloud(file.stem, Stream(time, table[:, -3:]), None)


def of_recording(recording: Recording, sensor: str) -> Cloud:
    """The cloud of one of its sensors."""
    return of_sensor(f"{recording.name}: sensor '{sensor}'", recording.sensor(sensor))


def _numeric(row: list[str]) -> bool:
    try:
        [float(cell) for cell in row]
    except ValueError:
        return False
    return True


def _rows(file: File, widths: tuple[int, int]) -> np.ndarray:
    """All rows as numbers, each with one of the numbers of columns."""
    lines = [line.replace(",", " ") for line in file.lines]
    width = len(lines[0].split())
    if width not in widths:
        raise InputError(
            f"{file.name}: its rows have {width} columns where {widths[0]} or {widths[1]} are needed; remove "
            "a header, or export it anew"
        )
    names = [str(i) for i in range(width)]
    return _table.numbers(file.name, lines, 1, names, range(width), delimiter=None)


def _day(place: Path) -> str | None:
    """The day in UTC that `record.properties` names as StartTime (unix seconds)."""
    notes = place / "record.properties"
    for line in notes.read_text(errors="replace").splitlines() if notes.is_file() else []:
        key, _, value = line.partition("=")
        if key.strip() == "StartTime" and value.strip().isdigit():
            return datetime.fromtimestamp(int(value), UTC).date().isoformat()
    return None
