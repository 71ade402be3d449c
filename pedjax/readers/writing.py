"""Writing a `Recording` as csv and the TOML that describes it; both read back to the same numbers."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from itertools import zip_longest
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pedjax.errors import InputError
from pedjax.output import atomic, folder, write_toml
from pedjax.recording import Recording, Stream, Truth

_UNITS = {"accelerometer": "m/s^2", "gyroscope": "rad/s", "magnetometer": "uT"}


def write_csv(recording: Recording, path: str | PathLike[str]) -> Path:
    """Write `path` (csv, gzip'ed where it ends in .gz) and `path` + '.toml'; return the latter.

    `read(path)` then gives every number back exactly, in the units of a `Recording`. Each file appears whole
    or not at all.
    """
    path = Path(path)
    columns = _Columns()
    top: dict[str, Any] = {"name": recording.name, "clock": recording.clock}
    if recording.notes:
        top["notes"] = list(recording.notes)
    top["format"] = {"kind": "csv"}
    top["sensors"] = {}
    for name, sensor in recording.sensors.items():
        if set(name) & set(',"\n\r#') or not name.strip():
            raise InputError(
                f"{recording.name}: sensor name '{name}' cannot head a csv column; rename the sensor"
            )
        entry: dict[str, Any] = {} if sensor.up is None else {"up": sensor.up}
        for kind, unit in _UNITS.items():
            stream: Stream | None = getattr(sensor, kind)
            if stream is not None:
                entry[kind] = {
                    "time": columns.clock(stream.time),
                    "columns": columns.add(f"{name}_{kind}", "xyz", stream.values),
                    "unit": unit,
                }
        top["sensors"][name] = entry
    if recording.truth is not None:
        top["truth"] = _truth(columns, recording.truth, "truth")
    if recording.truths:
        further = recording.truths.items()
        top["truths"] = {name: _truth(columns, truth, f"{name}_truth") for name, truth in further}
    if recording.landmarks is not None:
        if recording.landmarks.sensor is not None:
            top["landmarks_sensor"] = recording.landmarks.sensor
        marks = zip(recording.landmarks.time.tolist(), recording.landmarks.position.tolist(), strict=True)
        top["landmarks"] = [{"time": time, "position": position} for time, position in marks]
    sidecar = path.with_name(path.name + ".toml")
    data = columns.text().encode()
    if path.suffix == ".gz":
        data = gzip.compress(data, mtime=0)
    folder(path.parent)
    atomic(path, lambda file: file.write(data))
    write_toml(sidecar, top)
    return sidecar


def _truth(columns: _Columns, truth: Truth, prefix: str) -> dict[str, Any]:
    """The table of a truth, whose columns begin with that prefix."""
    table: dict[str, Any] = {} if truth.sensor is None else {"sensor": truth.sensor}
    table["time"] = columns.clock(truth.time)
    table["position"] = {"columns": columns.add(prefix, "xyz", truth.position), "unit": "m"}
    if truth.quaternion is not None:
        names = columns.add(f"{prefix}_quaternion", "wxyz", truth.quaternion)
        table["quaternion"] = {"columns": names, "order": "wxyz"}
    return table


class _Columns:
    """Named columns of any length; clocks that are equal share one column."""

    def __init__(self) -> None:
        self._columns: dict[str, np.ndarray] = {}
        self._clocks: list[str] = []

    def clock(self, time: np.ndarray) -> str:
        for name in self._clocks:
            if np.array_equal(self._columns[name], time):
                return name
        name = f"time_{len(self._clocks)}" if self._clocks else "time"
        self._clocks.append(name)
        self._columns[name] = time
        return name

    def add(self, name: str, axes: str, values: np.ndarray) -> list[str]:
        names = [f"{name}_{axis}" for axis in axes]
        self._columns.update(zip(names, values.T, strict=True))
        return names

    def text(self) -> str:
        return "\n".join([",".join(self._columns), *self._rows(), ""])

    def _rows(self) -> Iterator[str]:
        # repr is the shortest text that reads back to the same float
        cells = [map(repr, np.asarray(column, dtype=float).tolist()) for column in self._columns.values()]
        return map(",".join, zip_longest(*cells, fillvalue=""))
