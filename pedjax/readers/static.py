"""npz archives of a unit at rest: `gyro_deg_s` (N, 3), `accel_g` (N, 3), `sample_rate_hz`; z down."""

from __future__ import annotations

import numpy as np

from pedjax.errors import InputError
from pedjax.readers._file import File
from pedjax.recording import STANDARD_GRAVITY, Recording, Sensor, Stream


def recognises(file: File) -> bool:
    """Whether it is such an archive."""
    return file.kind == "npz" and {"gyro_deg_s", "accel_g"} <= set(file.arrays)


def read(file: File) -> Recording:
    """A recording at rest as sensor 'static', for Allan deviations."""
    rate = file.array("sample_rate_hz").ravel()
    if len(rate) != 1 or not rate[0] > 0:
        raise InputError(f"{file.name}: 'sample_rate_hz' must be one positive number")
    gyroscope = np.deg2rad(file.matrix("gyro_deg_s", 3))
    time = np.arange(len(gyroscope)) / rate[0]
    sensor = Sensor(
        Stream(time, STANDARD_GRAVITY * file.matrix("accel_g", 3)), Stream(time, gyroscope), up="-z"
    )
    return Recording(
        file.stem, {"static": sensor}, format="static archive", notes=("at rest: it is no walk",)
    )
