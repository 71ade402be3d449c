"""Files that are known but are no walk, and what to tell their owner."""

from __future__ import annotations

from pedjax.readers import _table
from pedjax.readers._file import File

_CLOUDS = {"accelerometer", "gyroscope", "magnetometer", "magnetometer-calibrated"}


def reason(file: File) -> str | None:
    """Why this file cannot be a recording, or None where it is simply unknown."""
    if file.kind == "hdf":
        return "it is a MATLAB v7.3 (HDF5) file; save it anew with save(..., '-v7')"
    if file.kind == "binary":
        return "it is neither text nor npz nor mat; export it as csv"
    if file.kind in ("npz", "mat"):
        return _arrays(file)
    first = [set(_table.cells(line, ",")) for line in file.head[:2]]
    if file.stem in _CLOUDS:
        return (
            "it is one sensor's stream for calibration, not a walk; merge accelerometer and gyroscope into "
            "one csv and describe it in a TOML"
        )
    if file.head and "strideIndex" in file.head[0]:
        return "it is a list of strides; read the csv of the same walk, which finds this list by itself"
    if first and {"s_id", "start", "end"} <= first[0]:
        return "it is a list of labelled strides, not a recording; read the imu table it belongs to"
    if len(first) > 1 and {"x", "y", "z"} <= first[1] and not any("acc" in name for name in first[0]):
        return "it is a table of optical markers, not a recording; read the imu table it belongs to"
    return None


def _arrays(file: File) -> str | None:
    names = set(file.arrays)
    if "GCP_meters" in names:
        return f"it holds the landmarks of a walk; read {file.stem}.csv beside it, which finds them by itself"
    if {"m", "quat"} <= names:
        return "it holds a magnetometer and odometry (m, quat, dPos) but no accelerometer and gyroscope"
    return None
