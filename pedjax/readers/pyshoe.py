"""PyShoe `.mat`: `imu` (N, 6) m/s^2 and rad/s, `ts` (1, N) s, `gt`, and `gt_idx` where the truth is sparse.

Frame: their filter works in a frame with z down, turns the sign of z alone for its output, and compares
`gt` with that after a turn about z only. So every `gt` of the set is left-handed with z up, hallway trials
included; its y axis is mirrored here. The stairs give only the height. The unit sits on the toes with z
down, but upside down in the trials of 2018-02-22: so `up` is left unknown and z up is noted.
"""

from __future__ import annotations

import numpy as np

from pedjax.errors import InputError
from pedjax.readers._file import File
from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth

_MIRROR = np.array([1.0, -1.0, 1.0])


def recognises(file: File) -> bool:
    """Whether it is a PyShoe trial."""
    return file.kind == "mat" and {"imu", "ts"} <= set(file.arrays)


def read(file: File) -> Recording:
    """A trial: dense `Truth` where `gt` has a row per sample, `Landmarks` where `gt_idx` is given."""
    imu = file.matrix("imu", 6)
    time = file.array("ts").ravel()
    if len(time) != len(imu):
        raise InputError(
            f"{file.name}: 'ts' has {len(time)} stamps but 'imu' {len(imu)} rows; export it again"
        )
    if len(time) == 0:
        raise InputError(f"{file.name}: 'imu' has no rows; export it again")
    time = time - time[0]
    truth, landmarks, notes = None, None, []
    if "gt" in file.arrays:
        position = _position(file, file.array("gt_idx").size if "gt_idx" in file.arrays else len(time))
        if "gt_idx" in file.arrays:
            index = _sample_index(file, len(time), len(position))
            landmarks = Landmarks(time[index], position, "foot")
        elif len(position) == len(time):
            truth = Truth(time, position, sensor="foot")
        else:
            raise InputError(
                f"{file.name}: 'gt' has {len(position)} rows for {len(time)} samples and there is no "
                "'gt_idx'; give the sample of each row in 'gt_idx'"
            )
        notes.append("gt is left-handed with z up: y was mirrored")
    if np.median(imu[:, 2]) > 0:  # three trials of the set; nothing in the file tells the two causes apart
        notes.append("z points up, unlike most PyShoe trials: mounted upside down, or gravity-signed")
    sensor = Sensor(Stream(time, imu[:, :3]), Stream(time, imu[:, 3:]))
    return Recording(
        file.stem, {"foot": sensor}, landmarks=landmarks, truth=truth, format="pyshoe", notes=tuple(notes)
    )


def _position(file: File, points: int) -> np.ndarray:
    value = file.array("gt")
    if value.size == points:  # one number per point: the stairs' height
        unknown = np.full(points, np.nan)
        return np.stack([unknown, unknown, value.ravel()], axis=-1)
    return file.matrix("gt", 3) * _MIRROR


def _sample_index(file: File, samples: int, rows: int) -> np.ndarray:
    index = file.whole("gt_idx")
    if len(index) != rows:
        raise InputError(
            f"{file.name}: 'gt_idx' has {len(index)} entries but 'gt' {rows} rows; export it again"
        )
    # PyShoe counts samples from 0; an entry equal to N can only come from a file that counts from 1
    if index.max() == samples and index.min() >= 1:
        index = index - 1
    if index.min() < 0 or index.max() >= samples:
        raise InputError(
            f"{file.name}: 'gt_idx' must hold sample numbers from 0 to {samples - 1}; correct the array"
        )
    return index
