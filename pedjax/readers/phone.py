"""Phones: every stream has its own clock.

Two formats: npz archives with `accel_time`, `accel`, `gyro_time`, `gyro`, `mag_*` and optical truth (a phone
in a trouser pocket), and text logs of `unix ms TAB TYPE TAB values` with surveyed waypoints (a phone held
flat). The field is the phone's own calibrated one: the raw one carries several hundred microtesla of hard
iron.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pedjax.errors import InputError
from pedjax.readers._file import File
from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth

_STREAMS = {"TYPE_ACCELEROMETER": 3, "TYPE_GYROSCOPE": 3, "TYPE_MAGNETIC_FIELD": 3, "TYPE_WAYPOINT": 2}
_AT_THE_EDGE = 0.5  # s; the first waypoint is tapped a moment before the sensors start


def recognises_archive(file: File) -> bool:
    """Whether it is an npz archive of phone streams."""
    return file.kind == "npz" and {"accel", "accel_time", "gyro", "gyro_time"} <= set(file.arrays)


def read_archive(file: File) -> Recording:
    """Sensor 'pocket'; truth in m where the archive has it (room frame, not aligned with north)."""
    magnetometer, notes = None, []
    for name in ("mag_android", "mag", "mag_raw"):
        if name in file.arrays and name + "_time" in file.arrays:
            magnetometer = _stream(file, name)
            if name == "mag_raw":
                notes.append("magnetometer not calibrated: it carries the phone's hard iron")
            break
    truth = None
    if {"truth_time", "truth_position_mm"} <= set(file.arrays):
        quaternion = None
        if "truth_quaternion_wxyz" in file.arrays:
            quaternion = file.matrix("truth_quaternion_wxyz", 4)
        position = 1e-3 * file.matrix("truth_position_mm", 3)
        truth = Truth(file.array("truth_time").ravel(), position, quaternion, "pocket")
    sensor = Sensor(_stream(file, "accel"), _stream(file, "gyro"), magnetometer)
    return Recording(file.stem, {"pocket": sensor}, truth=truth, format="phone archive", notes=tuple(notes))


def _stream(file: File, name: str) -> Stream:
    return Stream(file.array(name + "_time").ravel(), file.matrix(name, 3))


def recognises_log(file: File) -> bool:
    """Whether it is a text log of phone streams."""
    return any("\tTYPE_" in line for line in file.head)


def read_log(file: File) -> Recording:
    """Sensor 'hand' (screen up); waypoints are landmarks in the floor's frame (x right, y up the plan)."""
    rows: dict[str, list[list[float]]] = {kind: [] for kind in _STREAMS}
    for number, line in enumerate(file.lines, start=1):
        if line.startswith("#") or not line.strip():
            continue
        fields: list[Any] = line.rstrip().split("\t")
        if len(fields) < 2 or not fields[1].startswith("TYPE_"):
            raise InputError(
                f"{file.name}: line {number} is no 'unix ms, TYPE_..., values' with tabs; repair or delete it"
            )
        size = _STREAMS.get(fields[1])
        if size is None:
            continue
        # a sensor's accuracy may follow its three values; more is a second record that lost its line break
        if not size + 2 <= len(fields) <= size + 3:
            raise InputError(
                f"{file.name}: line {number} has {len(fields) - 2} values for {fields[1]} where {size} are "
                "needed; repair or delete it"
            )
        try:
            rows[fields[1]].append([float(field) for field in (fields[0], *fields[2 : 2 + size])])
        except ValueError as error:
            raise InputError(
                f"{file.name}: line {number}, {fields[1]}: {error}; repair or delete that line"
            ) from None
    for kind in ("TYPE_ACCELEROMETER", "TYPE_GYROSCOPE"):
        if not rows[kind]:
            raise InputError(f"{file.name}: there are no {kind} lines; a walk needs both inertial streams")
    start = min(rows["TYPE_ACCELEROMETER"][0][0], rows["TYPE_GYROSCOPE"][0][0])

    def stream(kind: str) -> Stream:
        table = np.array(rows[kind])
        return Stream(1e-3 * (table[:, 0] - start), table[:, 1:])

    sensor = Sensor(
        stream("TYPE_ACCELEROMETER"),
        stream("TYPE_GYROSCOPE"),
        stream("TYPE_MAGNETIC_FIELD") if rows["TYPE_MAGNETIC_FIELD"] else None,
        up="+z",
    )
    landmarks: Landmarks | None = None
    notes: list[str] = []
    if rows["TYPE_WAYPOINT"]:
        landmarks, notes = _waypoints(stream("TYPE_WAYPOINT"), sensor.gyroscope.time)
    return Recording(file.stem, {"hand": sensor}, landmarks=landmarks, format="phone log", notes=tuple(notes))


def _waypoints(marks: Stream, time: np.ndarray) -> tuple[Landmarks | None, list[str]]:
    inside = np.clip(marks.time, time[0], time[-1])
    off = np.abs(marks.time - inside)
    keep = off <= _AT_THE_EDGE
    notes: list[str] = []
    if (off[keep] > 0).any():
        notes.append(f"a waypoint {off[keep].max():.2f} s outside the sensor data was moved to their edge")
    if not keep.all():
        notes.append(f"{int((~keep).sum())} waypoints outside the sensor data were dropped")
    if not keep.any():
        return None, notes
    height = np.full((int(keep.sum()), 1), np.nan)
    return Landmarks(inside[keep], np.hstack([marks.values[keep], height]), "hand"), notes
