"""One walk: named sensors with their own clocks, landmarks and optional truth, checked when it is made.

Conventions (docs/conventions.md): navigation frame ENU, specific force points up at rest, SI units,
magnetic field in microtesla. Everything here is numpy in float64 and lives at the edge; the filters see
only the arrays of an `Inertial`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pedjax.checks import check
from pedjax.errors import InputError, suggest
from pedjax.streams import (
    STANDARD_GRAVITY,
    Clock,
    Landmarks,
    Sensor,
    Stream,
    Truth,
    Unchecked,
    sampling_rate,
)

__all__ = [
    "STANDARD_GRAVITY", "Clock", "Inertial", "Landmarks", "Recording", "Sensor", "Stream", "Truth",
    "inertial", "nearest", "nominal_rate", "sampling_rate",
]  # fmt: skip


@dataclass(frozen=True)
class Recording(Unchecked):
    """One walk. Making it checks it; what is wrong is an `InputError`, what is odd a line in `findings`.

    `truths` holds, by sensor, the truth of those beside the one that `truth` belongs to, in the same frame.
    """

    findings: tuple[str, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        named = {n: replace(t, sensor=n) if t.sensor is None else t for n, t in self.truths.items()}
        object.__setattr__(self, "truths", named)
        object.__setattr__(self, "findings", (*self.notes, *check(self)))

    @property
    def duration(self) -> float:
        """Seconds from the first to the last inertial sample of the longest sensor."""
        return max(float(s.gyroscope.time[-1] - s.gyroscope.time[0]) for s in self.sensors.values())

    def truth_of(self, sensor: str | None = None) -> Truth | None:
        """The sensor's own truth where there is one, else `truth`, whichever sensor it belongs to."""
        return self.truth if sensor is None else self.truths.get(sensor, self.truth)

    def renamed(self, names: Mapping[str, str]) -> Recording:
        """The same walk with other names, new by old, for its sensors and for whose truth and landmarks
        those are."""
        if len({names.get(name, name) for name in self.sensors}) < len(self.sensors):
            raise InputError(f"{self.name}: two of its sensors would have one name; choose another")

        def known(name: str) -> str:
            return names.get(name, name)

        def owned(measured: Any) -> Any:
            if measured is None or measured.sensor is None:
                return measured
            return replace(measured, sensor=known(measured.sensor))

        return replace(
            self,
            sensors={known(name): sensor for name, sensor in self.sensors.items()},
            landmarks=owned(self.landmarks),
            truth=owned(self.truth),
            truths={known(name): owned(truth) for name, truth in self.truths.items()},
        )

    def sensor(self, name: str = "foot") -> Sensor:
        """The sensor of that name."""
        if name in self.sensors:
            return self.sensors[name]
        known = suggest(name, self.sensors)
        raise InputError(f"{self.name}: there is no sensor '{name}'{known} (choose with sensor, --sensor)")


def nominal_rate(imu: Inertial) -> float:
    """The sampling rate rounded to whole Hz: what sets the length of windows."""
    return max(float(round(imu.rate)), 1.0)


@dataclass(frozen=True)
class Inertial:
    """A sensor's samples on one clock, as a filter takes them (numpy, float64, time first).

    `time (T,)` s, `dt (T,)` s (the step that ends at each sample; the first repeats the second),
    `specific_force (T, 3)`, `angular_rate (T, 3)`, `magnetic_field (T, 3)` microtesla or None.
    """

    time: np.ndarray
    dt: np.ndarray
    specific_force: np.ndarray
    angular_rate: np.ndarray
    magnetic_field: np.ndarray | None = None

    @cached_property
    def rate(self) -> float:
        """Sampling rate in Hz, gaps left out."""
        return sampling_rate(self.dt)

    def crop(self, start: int, stop: int) -> Inertial:
        """Samples `start` to `stop` (exclusive)."""
        cut = slice(start, stop)
        field_ = None if self.magnetic_field is None else self.magnetic_field[cut]
        return replace(
            self,
            time=self.time[cut],
            dt=self.dt[cut],
            specific_force=self.specific_force[cut],
            angular_rate=self.angular_rate[cut],
            magnetic_field=field_,
        )


def _without_duplicates(stream: Stream) -> Stream:
    keep = np.concatenate([[True], np.diff(stream.time) > 0])
    return Stream(stream.time[keep], stream.values[keep])


def nearest(time: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Index of the sample of ascending `time` nearest to each of `at`."""
    index = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    return index - (at - time[index - 1] < time[index] - at)


_HELD = 0.5  # s from a reading of the magnetometer, up to which it tells of the field


def interpolate(stream: Stream, time: np.ndarray) -> np.ndarray:
    """Values of a stream at other times, `(T, D)`, by straight lines between its samples."""
    return np.stack([np.interp(time, stream.time, column) for column in stream.values.T], axis=-1)


def inertial(recording: Recording, sensor: str = "foot", clock: Clock | None = None) -> Inertial:
    """Put a sensor's streams on the gyroscope's clock.

    `clock` says how to read the time stamps: `stamps` takes them as they are (true dt), `uniform` takes
    the samples as evenly spaced between the first and the last stamp (late arrivals), `resample`
    interpolates onto an even grid. Default: what the reader chose for this format. More than half a second
    from the nearest reading of the magnetometer the field is NaN: made up, it would look quasi-static.
    """
    source = recording.sensor(sensor)
    gyroscope = source.gyroscope
    accelerometer = source.accelerometer
    clock = clock or recording.clock
    same = np.array_equal(gyroscope.time, accelerometer.time)
    if not (same and clock == "uniform"):  # evenly spaced samples may well arrive with equal stamps
        gyroscope, accelerometer = _without_duplicates(gyroscope), _without_duplicates(accelerometer)
    time, rate, force = gyroscope.time, gyroscope.values, accelerometer.values
    if not same:  # keep only where both streams exist: no extrapolation
        inside = (time >= accelerometer.time[0]) & (time <= accelerometer.time[-1])
        time, rate = time[inside], rate[inside]
        force = interpolate(accelerometer, time)
    if clock == "uniform":
        step = (time[-1] - time[0]) / (len(time) - 1)
        time = time[0] + step * np.arange(len(time))
    elif clock == "resample":
        step = float(np.median(np.diff(time)))
        grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step) + 1)
        rate, force = interpolate(Stream(time, rate), grid), interpolate(Stream(time, force), grid)
        time = grid
    elif clock != "stamps":
        raise InputError(f"clock '{clock}' is unknown{suggest(clock, ('stamps', 'uniform', 'resample'))}")
    magnetic = None
    if source.magnetometer is not None:
        stream = _without_duplicates(source.magnetometer)
        magnetic = interpolate(stream, time)
        magnetic[abs(time - stream.time[nearest(stream.time, time)]) > _HELD] = np.nan
    steps = np.diff(time)
    dt = np.concatenate([steps[:1], steps])
    return Inertial(time, dt, force, rate, magnetic)
