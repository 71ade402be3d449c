"""MicroStrain SensorConnect csv, with ruler landmarks where their files lie beside it.

`STEM.csv` has `Time` [s] and, behind a node name and a colon, either scaledAccel [g], scaledGyro [rad/s],
scaledMag [gauss], or estCompensatedAccel [m/s^2], estAngularRate [rad/s]; a `:valid` column of 0 marks a
cell that is no measurement. `STEM.mat` (GCP_meters, GCP_stride_numbers, numberOfStrides) and
`STEM_strideIndex*.csv` (beside it or in `stride_index/`) give the foot's position after each stride: row s
of the stride list is stride s and row 0 the start, so the list has numberOfStrides + 1 rows. Its sample
numbers are on a 200 Hz axis; the `timestamp` column, where there is one, is the time itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pedjax.errors import InputError
from pedjax.readers import _table
from pedjax.readers._file import File, load
from pedjax.recording import STANDARD_GRAVITY, Landmarks, Recording, Sensor, Stream

# Their g is the standard one (data sheet); the 9.8029 of the PyShoe code is a local gravity.
_SETS = (("scaledAccel", STANDARD_GRAVITY, "scaledGyro"), ("estCompensatedAccel", 1.0, "estAngularRate"))
_MICROTESLA_PER_GAUSS = 100.0
_STRIDE_RATE = 200.0
_JITTER = 0.2


def recognises(file: File) -> bool:
    """Whether it is a SensorConnect table."""
    return _header_line(file.head) is not None


def read(file: File) -> Recording:
    """A SensorConnect table as sensor 'foot' (z down)."""
    at = _header_line(file.lines)
    if at is None:
        raise InputError(f"{file.name}: there is no SensorConnect header line with Time and acceleration")
    names = _table.cells(file.lines[at], ",")
    channels = [name.split(":")[-1] if not name.endswith(":valid") else "" for name in names]
    found = next((known for known in _SETS if known[0] + "X" in channels), None)
    if found is None:
        raise InputError(
            f"{file.name}: there is no column '{_SETS[0][0]}X' or '{_SETS[1][0]}X'; export it again"
        )
    acceleration, gravity, rotation = found
    wanted = [prefix + axis for prefix in (acceleration, rotation) for axis in "XYZ"]
    magnetic = "scaledMagX" in channels
    if magnetic:
        wanted += ["scaledMag" + axis for axis in "XYZ"]
    use = [_table.column(file.name, channels, name) for name in ["Time", *wanted]]
    flags = [names.index(names[i] + ":valid") for i in use if names[i] + ":valid" in names]
    table = _table.numbers(file.name, file.lines[at + 1 :], at + 2, names, [*use, *flags], empty_as_nan=True)
    valid = (table[:, len(use) :] == 1).all(axis=1) & np.isfinite(table[:, : len(use)]).all(axis=1)
    if not valid.any():
        raise InputError(
            f"{file.name}: no row has all of {acceleration} and {rotation} valid; export it again"
        )
    notes = [] if valid.all() else [f"{int((~valid).sum())} rows that are not valid were dropped"]
    stamps = table[:, 0] - table[valid][0, 0]
    time, values = stamps[valid], table[valid, 1 : len(use)]
    late = _jitters(time)
    if late:
        notes.append("the time stamps are late arrivals: samples are taken as evenly spaced")
    landmarks, reason = _landmarks(file, stamps, late)
    if landmarks is None:
        notes.append(f"read without landmarks: {reason}")
    sensor = Sensor(
        Stream(time, gravity * values[:, :3]),
        Stream(time, values[:, 3:6]),
        Stream(time, _MICROTESLA_PER_GAUSS * values[:, 6:9]) if magnetic else None,
        up="-z",
    )
    return Recording(
        file.stem,
        {"foot": sensor},
        landmarks=landmarks,
        clock="uniform" if late else "stamps",
        format="microstrain",
        notes=tuple(notes),
    )


def _header_line(lines: Sequence[str]) -> int | None:
    # an export may carry lines about the nodes above the table
    for number, line in enumerate(lines[:40]):
        names = line.lstrip("\ufeff")
        if names.startswith("Time,") and any(s[0] + "X" in names for s in _SETS):
            return number
    return None


def _jitters(time: np.ndarray) -> bool:
    steps = np.diff(time)
    if len(steps) == 0 or not (steps > 0).any():
        return False
    step = float(np.median(steps[steps > 0]))
    return float(np.percentile(np.abs(steps - step), 95)) > _JITTER * step


def _landmarks(file: File, stamps: np.ndarray, late: bool) -> tuple[Landmarks | None, str]:
    """The points of the walk, or None and why not."""
    folder = file.path.parent
    truth = _first([folder], f"{file.stem}.mat")
    if truth is None:
        return None, f"there is no {file.stem}.mat beside it"
    places = [folder, folder / "stride_index", folder.parent / "stride_index"]
    strides = _first(places, f"{file.stem}_strideIndex*.csv")
    if strides is None:
        return None, f"there is no {file.stem}_strideIndex*.csv beside it or in stride_index/"
    points = load(truth)
    if not {"GCP_meters", "GCP_stride_numbers", "numberOfStrides"} <= set(points.arrays):
        return None, f"{points.name} has no GCP_meters, GCP_stride_numbers and numberOfStrides"
    position = points.matrix("GCP_meters", 2)
    numbers = points.whole("GCP_stride_numbers")
    count = int(points.whole("numberOfStrides")[0])
    time = _stride_times(load(strides), stamps)
    if late:  # the samples are moved to an even grid, and the strides with them
        time = np.interp(time, stamps, np.linspace(stamps[0], stamps[-1], len(stamps)))
    if len(time) != count + 1 or len(numbers) != len(position) or not set(numbers) <= set(range(count + 1)):
        return None, (
            f"{strides.name} has {len(time)} rows and {points.name} {len(position)} points for {count} "
            "strides where a row for the start and one for each stride are needed"
        )
    height = np.full((len(position), 1), np.nan)
    return Landmarks(time[numbers], np.hstack([position, height]), "foot"), ""


def _stride_times(file: File, stamps: np.ndarray) -> np.ndarray:
    """Seconds of the start and of each stride; `stamps` are the seconds of the walk's rows."""
    start = next((i for i, line in enumerate(file.lines) if line[:1].isdigit()), len(file.lines))
    header = file.lines[start - 1] if start else ""
    names = ["strideIndex"] if header.startswith("#") or not header else _table.cells(header, ",")
    use = [0, names.index("timestamp")] if "timestamp" in names else [0]
    table = _table.numbers(file.name, file.lines[start:], start + 1, names, use)
    if len(use) == 2:
        return table[:, 1]
    span = float(stamps[-1] - stamps[0])
    if abs(len(stamps) - 1 - _STRIDE_RATE * span) > 0.05 * len(stamps):
        return table[:, 0] / _STRIDE_RATE
    beyond = ~((table[:, 0] >= 0) & (table[:, 0] < len(stamps)))
    if beyond.any():
        raise InputError(
            f"{file.name}: sample {table[beyond, 0][0]:g} lies outside the {len(stamps)} rows of the walk; "
            "is it the list of another walk?"
        )
    return stamps[table[:, 0].astype(int)]


def _first(folders: Sequence[Path], pattern: str) -> Path | None:
    found = (path for folder in folders for end in ("", ".gz") for path in sorted(folder.glob(pattern + end)))
    return next(found, None)
