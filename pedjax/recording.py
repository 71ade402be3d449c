"""One walk: named sensors with their own clocks, landmarks and optional truth, checked when it is made.

Conventions (docs/conventions.md): navigation frame ENU, specific force points up at rest, SI units,
magnetic field in microtesla. Everything here is numpy in float64 and lives at the edge; the filters see
only the arrays of an `Inertial`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from pedjax.errors import InputError, suggest

STANDARD_GRAVITY = 9.80665
"""m/s^2, the conversion of g."""

Clock = Literal["stamps", "uniform", "resample"]


def _as_floats(holder: object, *names: str) -> None:
    """Lists and integers become float arrays; what is no number is an `InputError`."""
    for name in names:
        try:
            array = np.asarray(getattr(holder, name), float)
        except (TypeError, ValueError):
            raise InputError(f"{type(holder).__name__}.{name} holds something that is not a number") from None
        object.__setattr__(holder, name, array)


def sampling_rate(steps: np.ndarray) -> float:
    """Mean rate over all steps that are no gaps: a median would mistake jittering stamps."""
    usual = steps[steps < 10 * np.median(steps[steps > 0])]
    return float(len(usual) / usual.sum())


def nominal_rate(imu: Inertial) -> float:
    """The sampling rate rounded to whole Hz: what sets the length of windows."""
    return max(float(round(imu.rate)), 1.0)


@dataclass(frozen=True)
class Stream:
    """Samples of one instrument on its own clock: `time (T,)` in s, `values (T, D)`."""

    time: np.ndarray
    values: np.ndarray

    def __post_init__(self) -> None:
        _as_floats(self, "time", "values")

    @property
    def rate(self) -> float:
        """Sampling rate in Hz, gaps left out."""
        return sampling_rate(np.diff(self.time))


@dataclass(frozen=True)
class Sensor:
    """One inertial unit at one place on the body.

    `accelerometer` is specific force in m/s^2, `gyroscope` rad/s, `magnetometer` microtesla, all in the
    same body axes. `up` names the body axis that points up in the usual stance ("+z", "-z", ...) where
    the reader knows it: only then can a flipped accelerometer be told from a flipped mounting.
    """

    accelerometer: Stream
    gyroscope: Stream
    magnetometer: Stream | None = None
    up: str | None = None


@dataclass(frozen=True)
class Landmarks:
    """Surveyed points: `time (K,)` s on the recording's clock, `position (K, 3)` m in a right-handed
    frame with z up; an unknown coordinate is NaN (a stair landmark knows only its height).
    `sensor` names the one at whose place they were surveyed (None: not said). Kept in time order."""

    time: np.ndarray
    position: np.ndarray
    sensor: str | None = None

    def __post_init__(self) -> None:
        _as_floats(self, "time", "position")
        if self.time.ndim == 1 and len(self.position) == len(self.time):
            order = np.argsort(self.time, kind="stable")
            object.__setattr__(self, "time", self.time[order])
            object.__setattr__(self, "position", self.position[order])


@dataclass(frozen=True)
class Truth:
    """Dense reference: `time (T,)` s, `position (T, 3)` m right-handed z up (NaN where lost), and
    optionally `quaternion (T, 4)`, scalar first, body to navigation. `sensor` names the one at whose place
    it was measured (None: not said)."""

    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray | None = None
    sensor: str | None = None

    def __post_init__(self) -> None:
        _as_floats(self, "time", "position", *(["quaternion"] if self.quaternion is not None else []))


@dataclass(frozen=True)
class Recording:
    """One walk. Making it checks it; what is wrong is an `InputError`, what is odd a line in `findings`.

    `truths` holds, by sensor, the truth of those beside the one that `truth` belongs to, in the same frame.
    """

    name: str
    sensors: Mapping[str, Sensor]
    landmarks: Landmarks | None = None
    truth: Truth | None = None
    clock: Clock = "stamps"
    format: str = "arrays"
    notes: tuple[str, ...] = ()
    truths: Mapping[str, Truth] = field(default_factory=dict)
    findings: tuple[str, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        from pedjax import checks

        named = {n: replace(t, sensor=n) if t.sensor is None else t for n, t in self.truths.items()}
        object.__setattr__(self, "truths", named)
        object.__setattr__(self, "findings", (*self.notes, *checks.check(self)))

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

    @property
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


def _interpolate(stream: Stream, time: np.ndarray) -> np.ndarray:
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
        force = _interpolate(accelerometer, time)
    if clock == "uniform":
        step = (time[-1] - time[0]) / (len(time) - 1)
        time = time[0] + step * np.arange(len(time))
    elif clock == "resample":
        step = float(np.median(np.diff(time)))
        grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step) + 1)
        rate, force = _interpolate(Stream(time, rate), grid), _interpolate(Stream(time, force), grid)
        time = grid
    elif clock != "stamps":
        raise InputError(f"clock '{clock}' is unknown{suggest(clock, ('stamps', 'uniform', 'resample'))}")
    magnetic = None
    if source.magnetometer is not None:
        stream = _without_duplicates(source.magnetometer)
        magnetic = _interpolate(stream, time)
        magnetic[abs(time - stream.time[nearest(stream.time, time)]) > _HELD] = np.nan
    steps = np.diff(time)
    dt = np.concatenate([steps[:1], steps])
    return Inertial(time, dt, force, rate, magnetic)
