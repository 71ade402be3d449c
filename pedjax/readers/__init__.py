"""Files of others as `Recording`s: `read` finds the format by content (docs/formats.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from pedjax.errors import InputError
from pedjax.readers import (
    _marks,
    broad,
    gaitmap,
    generic,
    microstrain,
    openshoe,
    phone,
    pyshoe,
    static,
    unreadable,
    xio,
)
from pedjax.readers._file import File, load
from pedjax.readers._settings import Table, settings, sidecar
from pedjax.readers.writing import write_csv
from pedjax.recording import Landmarks, Recording

__all__ = ["FORMATS", "Format", "read", "write_csv"]


@dataclass(frozen=True)
class Format:
    """A known format: what recognises it, what reads it, and a line about it."""

    recognises: Callable[[File], bool]
    read: Callable[[File], Recording]
    about: str


FORMATS: dict[str, Format] = {
    "pyshoe": Format(pyshoe.recognises, pyshoe.read, "PyShoe .mat: imu, ts, gt, gt_idx"),
    "broad": Format(broad.recognises, broad.read, "BROAD .mat: imu_acc, imu_gyr, imu_mag, opt_pos, opt_quat"),
    "phone archive": Format(phone.recognises_archive, phone.read_archive, "npz of phone streams and truth"),
    "static archive": Format(static.recognises, static.read, "npz of a unit at rest: gyro_deg_s, accel_g"),
    "openshoe": Format(openshoe.recognises, openshoe.read, "OpenShoe data_inert.txt, 17 columns"),
    "microstrain": Format(microstrain.recognises, microstrain.read, "MicroStrain SensorConnect csv"),
    "x-io": Format(xio.recognises, xio.read, "x-io csv with units in its header"),
    "gaitmap": Format(gaitmap.recognises, gaitmap.read, "gaitmap tables of one foot or two"),
    "phone log": Format(phone.recognises_log, phone.read_log, "text log of unix ms, TYPE_..., values"),
}
"""The formats that need no description; anything else is read through a TOML (`generic`)."""


def read(
    path: str | PathLike[str], *, config: str | PathLike[str] | None = None, sensor: str | None = None
) -> Recording:
    """Read one walk.

    `config` is a TOML that describes the file, or adds landmarks to a known format; without it
    `FILE.toml` beside the file is taken where there is one. `sensor`: of a file with two feet, the one that
    becomes 'foot'; of a described file with several sensors, the one to keep; of a file with one sensor, the
    name it gets. What cannot be read is an `InputError`.
    """
    file = load(path)
    beside = sidecar(file.path) if config is None else config
    top = None if beside is None else settings(beside)
    if top is not None and set(top.values) & set(generic.LAYOUT):
        return _named(generic.read(file, top), sensor)
    known = next((known for known in FORMATS.values() if known.recognises(file)), None)
    if known is None:
        why = unreadable.reason(file) or (
            f"its format is unknown{_arrays(file)}; describe its columns in {file.name}.toml "
            "(docs/formats.md)"
        )
        raise InputError(f"{file.name}: {why}")
    two_feet = known.read is gaitmap.read
    recording = gaitmap.read(file, sensor) if two_feet else _named(known.read(file), sensor)
    return recording if top is None else _with_landmarks(recording, top)


def _arrays(file: File) -> str:
    return f" (arrays: {', '.join(sorted(file.arrays)) or 'none'})" if file.kind in ("npz", "mat") else ""


def _named(recording: Recording, sensor: str | None) -> Recording:
    if sensor is None or set(recording.sensors) == {sensor}:
        return recording
    if len(recording.sensors) == 1:
        return recording.renamed({next(iter(recording.sensors)): sensor})
    own = recording.truth_of(sensor)
    return replace(recording, sensors={sensor: recording.sensor(sensor)}, truth=own, truths={})


def _with_landmarks(recording: Recording, top: Table) -> Recording:
    top.only(*_marks.KEYS, "clock")
    time = next(iter(recording.sensors.values())).gyroscope.time
    more = _marks.landmarks(top, time)
    old = recording.landmarks
    if more is not None and old is not None:
        if None not in (old.sensor, more.sensor) and old.sensor != more.sensor:
            raise InputError(
                f"{top.where}: the file has landmarks of sensor '{old.sensor}', these are of "
                f"'{more.sensor}'; give those of one sensor only"
            )
        time, position = np.concatenate([old.time, more.time]), np.concatenate([old.position, more.position])
        more = Landmarks(time, position, old.sensor or more.sensor)
    clock = top.choice("clock", ("stamps", "uniform", "resample"), recording.clock)
    return replace(recording, landmarks=more if more is not None else old, clock=clock)  # type: ignore[arg-type]
