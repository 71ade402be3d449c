"""Any csv or npz, described by a TOML (docs/formats.md): columns, units, axes, clocks, frame, landmarks.

Every stream may have its own time column. A row whose time cell and values are all empty holds no sample of
that stream, so columns of different lengths stand side by side in one csv.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pedjax.errors import InputError, suggest
from pedjax.readers import _marks, _table, _units
from pedjax.readers._file import File, numeric
from pedjax.readers._settings import Table
from pedjax.recording import Recording, Sensor, Stream, Truth

LAYOUT = ("format", "time", "sensors", "truth", "truths")
"""The tables that describe a layout; a TOML without any only adds to a format that is known."""

_AXES = re.compile(r"([+-])([xyz])([+-])([xyz])([+-])([xyz])")
_UP = tuple(sign + axis for axis in "xyz" for sign in "+-")
_CLOCKS = ("stamps", "uniform", "resample")
# 180 degrees about north-east: north, east, down to east, north, up
_NED = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])


Fetch = Callable[[str, list[Any]], np.ndarray]
"""`(where, names) -> (N, len(names))`: the columns of a csv or the arrays of an npz."""

Times = Callable[[Table, int], np.ndarray]
"""`(stream, rows) -> (rows,)`: a stream's time in s."""


@dataclass(frozen=True)
class _Csv:
    file: File
    table: Table

    @cached_property
    def rows(self) -> tuple[int, list[str], list[str]]:
        """Line number of the first row, the rows, and the names of the columns."""
        comment = self.table.get("comment", "text", "#")
        header = self.table.get("header", "a whole number", 1)
        lines = ["" if comment and line.lstrip().startswith(comment) else line for line in self.file.lines]
        kept = [number for number, line in enumerate(lines) if line.strip()]
        if header < 0 or len(kept) <= header:
            raise InputError(
                f"{self.file.name}: it has {len(kept)} lines, {header} of them header; no rows are left"
            )
        first = _table.cells(lines[kept[max(header - 1, 0)]], self.delimiter)
        names = first if header else [str(i) for i in range(len(first))]
        return kept[header] + 1, lines[kept[header] :], names

    @property
    def delimiter(self) -> str | None:
        """The text between cells; None for white space."""
        given = self.table.get("delimiter", "text", ",")
        return None if given in ("whitespace", " ", "") else given

    def fetch(self, where: str, names: list[Any]) -> np.ndarray:
        """Columns by name, or by number from 0."""
        line, rows, known = self.rows
        use = []
        for name in names:
            if isinstance(name, int):
                if not 0 <= name < len(known):
                    raise InputError(
                        f"{where}, {self.file.name}: there is no column {name}; "
                        f"it has columns 0 to {len(known) - 1}"
                    )
                use.append(name)
            else:
                use.append(_table.column(f"{where}, {self.file.name}", known, name))
        return _table.numbers(
            self.file.name, rows, line, known, use, delimiter=self.delimiter, empty_as_nan=True
        )


def _from_npz(file: File) -> Fetch:
    def fetch(where: str, names: list[Any]) -> np.ndarray:
        columns = []
        for name in names:
            if name not in file.arrays:
                raise InputError(f"{where}: there is no array '{name}'{suggest(str(name), file.arrays)}")
            value = numeric(file.arrays[name], f"{file.name}: array '{name}'")
            if value.ndim not in (1, 2):
                raise InputError(f"{where}: array '{name}' has shape {value.shape}; (N,) or (N, D) is needed")
            columns.append(value if value.ndim == 2 else value[:, None])
        if len({len(value) for value in columns}) > 1:
            lengths = ", ".join(f"'{n}' {len(v)}" for n, v in zip(names, columns, strict=True))
            raise InputError(f"{where}: arrays of one stream differ in length ({lengths}); export them anew")
        return np.hstack(columns)

    return fetch


def read(file: File, top: Table) -> Recording:
    """The recording that the TOML describes."""
    top.only("name", "notes", "clock", *_marks.KEYS, *LAYOUT)
    layout = top.table("format")
    layout.only("kind", "delimiter", "header", "comment")
    kind = layout.choice("kind", ("csv", "npz"), "npz" if file.kind == "npz" else "csv")
    if (kind == "npz") != (file.kind == "npz") or file.kind not in ("npz", "text"):
        raise InputError(f"{layout.where}: kind = '{kind}' does not fit {file.name}, which is {file.kind}")
    fetch = _from_npz(file) if kind == "npz" else _Csv(file, layout).fetch

    clock = top.table("time")
    clock.only("column", "unit", "rate_hz")
    unit = _units.factor(clock.get("unit", "text", "s"), _units.TIME, clock.where)
    rate = clock.get("rate_hz", "a number")
    if rate is not None and ("column" in clock.values or not rate > 0):
        raise InputError(f"{clock.where}: give either 'column' or a positive 'rate_hz'")

    def times(table: Table, rows: int) -> np.ndarray:
        column = table.get("time", "text", clock.get("column", "text"))
        if column is None and rate is None:
            raise InputError(f"{table.where}: no time; give [time] column or rate_hz, or 'time' here")
        if column is None:
            return np.arange(rows) / rate
        found = unit * fetch(f"{table.where} time", [column])[:, 0]
        if len(found) != rows:
            raise InputError(f"{table.where}: time '{column}' has {len(found)} entries for {rows} samples")
        return found

    described = top.table("sensors")
    sensors = {name: _sensor(described.table(name), fetch, times) for name in described.values}
    if not sensors:
        raise InputError(f"{top.where}: there is no sensor; describe one in a table [sensors.foot]")
    frame = _marks.frame(top)
    first = next(iter(sensors.values())).gyroscope.time
    beside = top.table("truths")
    return Recording(
        top.get("name", "text", file.stem),
        sensors,
        landmarks=_marks.landmarks(top, first, unit),
        truth=_truth(top.table("truth"), fetch, times, frame) if "truth" in top.values else None,
        clock=top.choice("clock", _CLOCKS, "stamps"),  # type: ignore[arg-type]
        format="generic",
        notes=tuple(str(note) for note in top.get("notes", "a list", [])),
        truths={name: _truth(beside.table(name), fetch, times, frame, name) for name in beside.values},
    )


def _sensor(table: Table, fetch: Fetch, times: Times) -> Sensor:
    table.only("accelerometer", "gyroscope", "magnetometer", "up", "gravity_signed")
    for name in ("accelerometer", "gyroscope"):
        table.need(name, "a table")
    accelerometer = _stream(table.table("accelerometer"), fetch, times, _units.ACCELERATION, "m/s^2")
    if table.get("gravity_signed", "true or false", False):
        accelerometer = Stream(accelerometer.time, -accelerometer.values)
    magnetometer = None
    if "magnetometer" in table.values:
        magnetometer = _stream(table.table("magnetometer"), fetch, times, _units.MAGNETIC_FIELD, "uT")
    return Sensor(
        accelerometer,
        _stream(table.table("gyroscope"), fetch, times, _units.ANGULAR_RATE, "rad/s"),
        magnetometer,
        up=table.choice("up", _UP, "+z") if "up" in table.values else None,
    )


def _stream(table: Table, fetch: Fetch, times: Times, units: Mapping[str, float], unit: str) -> Stream:
    table.only("columns", "unit", "axes", "time")
    scale = _units.factor(table.get("unit", "text", unit), units, table.where)
    values = scale * _columns(table, fetch, 3)
    axes = table.get("axes", "text", "+x+y+z")
    match = _AXES.fullmatch(axes)
    if match is None or {match[2], match[4], match[6]} != set("xyz"):
        raise InputError(
            f"{table.where}: axes = '{axes}' is unknown; name the column and sign of each body "
            "axis, as in '+x-y-z'"
        )
    order = ["xyz".index(match[i]) for i in (2, 4, 6)]
    values = values[:, order] * [1.0 if match[i] == "+" else -1.0 for i in (1, 3, 5)]
    return Stream(*_present(times(table, len(values)), values))


def _columns(table: Table, fetch: Fetch, count: int) -> np.ndarray:
    names = table.values.get("columns")
    if isinstance(names, str):  # one array of an npz
        names = [names]
    if not isinstance(names, list) or not names or not all(type(name) in (str, int) for name in names):
        raise InputError(
            f"{table.where}: 'columns' must list {count} columns, or name one array (N, {count})"
        )
    values = fetch(f"{table.where} columns", names)
    if values.shape[1] != count:
        raise InputError(f"{table.where}: 'columns' gives {values.shape[1]} columns where {count} are needed")
    return values


def _present(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    absent = np.isnan(time) & np.isnan(values).all(axis=1)
    return time[~absent], values[~absent]


def _truth(table: Table, fetch: Fetch, times: Times, frame: str, sensor: str | None = None) -> Truth:
    table.only("position", "quaternion", "time", "sensor")
    sensor = table.get("sensor", "text", sensor)
    table.need("position", "a table")
    place = table.table("position")
    place.only("columns", "unit")
    position = _units.factor(place.get("unit", "text", "m"), _units.LENGTH, place.where) * _columns(
        place, fetch, 3
    )
    position = _marks.turned(position, frame)
    time = times(table, len(position))
    if "quaternion" not in table.values:
        return Truth(*_present(time, position), sensor=sensor)
    quaternion = _quaternion(table.table("quaternion"), fetch, frame)
    if len(quaternion) != len(position):
        raise InputError(
            f"{table.where}: {len(quaternion)} quaternions for {len(position)} positions; give as many"
        )
    time, both = _present(time, np.hstack([position, quaternion]))
    return Truth(time, both[:, :3], both[:, 3:], sensor)


def _quaternion(table: Table, fetch: Fetch, frame: str) -> np.ndarray:
    table.only("columns", "order", "direction")
    values = _columns(table, fetch, 4)
    if table.choice("order", ("wxyz", "xyzw"), "wxyz") == "xyzw":
        values = values[:, [3, 0, 1, 2]]
    direction = table.choice("direction", ("body-to-navigation", "navigation-to-body"), "body-to-navigation")
    if direction == "navigation-to-body":
        values = values * [1.0, -1.0, -1.0, -1.0]
    if frame == "NED":
        values = _product(_NED, values)
    elif frame != "ENU":
        raise InputError(
            f"{table.where}: a quaternion cannot belong to a {frame} frame; give it in ENU or NED"
        )
    return values


def _product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The Hamilton product of one quaternion with rows of quaternions, scalar first."""
    w, x, y, z = left
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return right @ matrix.T
