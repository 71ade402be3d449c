"""BROAD `.mat`: imu_acc [m/s^2], imu_gyr [rad/s], imu_mag [uT], opt_pos [m], opt_quat (scalar first, ENU).

One clock of `sampling_rate`. A board moved by hand, so the sensor is 'hand' and no axis is up. Where the
cameras lost it the truth is NaN.
"""

from __future__ import annotations

import numpy as np

from pedjax.errors import InputError
from pedjax.readers._file import File
from pedjax.recording import Recording, Sensor, Stream, Truth


def recognises(file: File) -> bool:
    """Whether it is a BROAD trial."""
    return file.kind == "mat" and {"imu_acc", "imu_gyr"} <= set(file.arrays)


def read(file: File) -> Recording:
    """A trial as sensor 'hand' with optical truth."""
    rate = file.array("sampling_rate").ravel()
    if len(rate) != 1 or not rate[0] > 0:
        raise InputError(f"{file.name}: 'sampling_rate' must be one positive number in Hz")
    acceleration = file.matrix("imu_acc", 3)
    time = np.arange(len(acceleration)) / rate[0]
    magnetometer = Stream(time, file.matrix("imu_mag", 3)) if "imu_mag" in file.arrays else None
    truth = None
    if "opt_pos" in file.arrays:
        quaternion = file.matrix("opt_quat", 4) if "opt_quat" in file.arrays else None
        truth = Truth(time, file.matrix("opt_pos", 3), quaternion, "hand")
    sensor = Sensor(Stream(time, acceleration), Stream(time, file.matrix("imu_gyr", 3)), magnetometer)
    return Recording(file.stem, {"hand": sensor}, truth=truth, format="broad")
