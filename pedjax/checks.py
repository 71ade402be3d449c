"""What makes a recording unusable, and what merely looks odd."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pedjax.errors import InputError, suggest
from pedjax.streams import Sensor, Stream, Truth, Unchecked

_MIN_SAMPLES = 20
_AXES = {"x": 0, "y": 1, "z": 2}
_UP = ("+x", "-x", "+y", "-y", "+z", "-z")
_RATES = (20.0, 5000.0)  # Hz, between which a foot can be navigated by


def check(recording: Unchecked) -> list[str]:
    """Raise `InputError` for what cannot be used; return a line for each oddity."""
    with np.errstate(over="ignore", invalid="ignore"):  # absurd values are for the checks to name
        return _check(recording)


def _check(recording: Unchecked) -> list[str]:
    findings: list[str] = []
    if not isinstance(recording.sensors, Mapping) or any(
        not hasattr(sensor, "gyroscope") for sensor in recording.sensors.values()
    ):
        raise InputError(f"{recording.name}: sensors must map names to Sensor, as in {{'foot': Sensor(...)}}")
    if not recording.sensors:
        raise InputError(f"{recording.name}: no sensor in it; give at least one, usually named 'foot'")
    for name, sensor in recording.sensors.items():
        where = f"{recording.name}: sensor '{name}'"
        _check_stream(where, "accelerometer", sensor.accelerometer, recording.clock, findings)
        _check_stream(where, "gyroscope", sensor.gyroscope, recording.clock, findings)
        if sensor.magnetometer is not None:
            _check_stream(where, "magnetometer", sensor.magnetometer, recording.clock, findings)
        if sensor.up is not None and sensor.up not in _UP:
            raise InputError(f"{where}: up = '{sensor.up}' must be one of {', '.join(_UP)}")
        _check_overlap(where, sensor)
        _check_gyroscope(where, sensor, findings)
        _check_gravity(where, sensor, findings)
        _check_magnetometer(where, sensor, findings)
    _check_landmarks(recording)
    _check_truths(recording)
    return findings


def _check_stream(where: str, kind: str, stream: Stream, clock: str, findings: list[str]) -> None:
    time, values = stream.time, stream.values
    if time.ndim != 1 or values.ndim != 2 or values.shape != (len(time), 3):
        raise InputError(
            f"{where}: {kind} has time {time.shape} and values {values.shape}; needed are (T,) and (T, 3)"
        )
    if len(time) < _MIN_SAMPLES:
        raise InputError(f"{where}: {kind} has {len(time)} samples; at least {_MIN_SAMPLES} are needed")
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise InputError(f"{where}: {kind} time stamp {bad[0]} is not a number; remove or repair that row")
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise InputError(
            f"{where}: {kind} has {len(bad)} samples that are not numbers, the first at sample {bad[0]} "
            f"({time[bad[0]]:.3f} s); remove those rows or fill the gaps before reading"
        )
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back):
        raise InputError(
            f"{where}: {kind} time goes backwards at sample {back[0] + 1} "
            f"({time[back[0]]:.4f} s to {time[back[0] + 1]:.4f} s); sort the rows or cut the file there"
        )
    if not (steps > 0).any():
        raise InputError(f"{where}: all time stamps of the {kind} are equal; give the sampling rate instead")
    if kind != "magnetometer" and not _RATES[0] <= stream.rate <= _RATES[1]:
        raise InputError(
            f"{where}: the {kind} samples at {stream.rate:.3g} Hz, where {_RATES[0]:g} to {_RATES[1]:g} is "
            "expected; check the unit of its time (ms for s?) or the rate that was given"
        )
    duplicates = int((steps == 0).sum())
    if duplicates:
        findings.append(f"{where}: {duplicates} duplicate time stamps of the {kind}; the repeats are dropped")
    step = float(np.median(steps[steps > 0]))
    jitter = float(np.percentile(np.abs(steps[steps > 0] - step), 95)) / step
    if jitter > 0.2:
        findings.append(
            f"{where}: {kind} time stamps jitter by {100 * jitter:.0f} % of the {1e3 * step:.2f} ms step "
            f"(95th percentile); they are read with clock = '{clock}'"
            + ("; 'uniform' or 'resample' if they are arrival times" if clock == "stamps" else "")
        )
    gap = float(steps.max())
    if gap > max(10 * step, 0.1):
        at = int(steps.argmax())
        findings.append(f"{where}: {kind} has a gap of {gap:.2f} s at {time[at]:.2f} s")


def _check_overlap(where: str, sensor: Sensor) -> None:
    start = max(sensor.accelerometer.time[0], sensor.gyroscope.time[0])
    stop = min(sensor.accelerometer.time[-1], sensor.gyroscope.time[-1])
    inside = (sensor.gyroscope.time >= start) & (sensor.gyroscope.time <= stop)
    if inside.sum() < _MIN_SAMPLES:
        raise InputError(
            f"{where}: accelerometer ({sensor.accelerometer.time[0]:.2f} to "
            f"{sensor.accelerometer.time[-1]:.2f} s) and gyroscope ({sensor.gyroscope.time[0]:.2f} to "
            f"{sensor.gyroscope.time[-1]:.2f} s) hardly overlap; bring them to one time base"
        )


def _check_gyroscope(where: str, sensor: Sensor, findings: list[str]) -> None:
    peak = float(np.percentile(np.linalg.norm(sensor.gyroscope.values, axis=1), 99.5))
    if peak > 50.0:
        raise InputError(
            f"{where}: the gyroscope turns at {peak:.0f} rad/s (99.5th percentile), which no foot does; "
            "it looks like deg/s: set its unit to deg/s"
        )
    shake = float(np.percentile(np.linalg.norm(sensor.accelerometer.values, axis=1), 99.5))
    if peak < 0.35 and shake > 15.0:
        findings.append(
            f"{where}: the gyroscope stays below {peak:.3f} rad/s while the specific force reaches "
            f"{shake:.0f} m/s^2; is its unit right?"
        )


def still_window(sensor: Sensor, seconds: float = 0.4) -> tuple[slice, float]:
    """The accelerometer samples of the stillest stretch, and its angular rate (RMS, rad/s)."""
    gyroscope = sensor.gyroscope
    width = min(max(int(seconds * gyroscope.rate), 5), len(gyroscope.time) // 2)
    energy = np.concatenate([[0.0], np.cumsum(np.sum(gyroscope.values**2, axis=1))])
    mean = (energy[width:] - energy[:-width]) / width
    start = int(mean.argmin())
    begin, end = gyroscope.time[start], gyroscope.time[start + width - 1]
    time = sensor.accelerometer.time
    first, last = np.searchsorted(time, [begin, end])
    return slice(int(first), int(max(last, first + 1))), float(np.sqrt(mean[start]))


def _check_gravity(where: str, sensor: Sensor, findings: list[str]) -> None:
    window, motion = still_window(sensor)
    force = sensor.accelerometer.values[window]
    if len(force) == 0:
        return
    mean = force.mean(axis=0)
    size = float(np.linalg.norm(mean))
    moving = motion > 0.2  # rad/s; a phone in a pocket bounces at its stillest, a foot in stance does not
    if 0.9 < size < 1.12 or (moving and 0.5 < size < 2.0):
        raise InputError(
            f"{where}: the specific force at rest is {size:.3f}, not 9.81 m/s^2; "
            "it looks like g: set the accelerometer's unit to g"
        )
    if moving:
        findings.append(
            f"{where}: it is never still (angular rate {motion:.2f} rad/s at best); "
            "gravity and biases could not be checked"
        )
    if not 9.0 < size < 10.6 and not (moving and 6.0 < size < 16.0):
        raise InputError(
            f"{where}: the specific force at rest is {size:.2f} m/s^2 where 9.81 is expected; "
            "check the accelerometer's unit and scale, and that gravity was not removed"
        )
    if not moving and abs(size - 9.81) > 0.15:
        findings.append(f"{where}: the specific force at rest is {size:.3f} m/s^2 (scale or bias error)")
    if sensor.up is not None:
        component = float(mean[_AXES[sensor.up[1]]]) * (1 if sensor.up[0] == "+" else -1)
        if component < -0.5 * size:
            raise InputError(
                f"{where}: the specific force at rest points down ({component:.2f} m/s^2 along {sensor.up}); "
                "the accelerometer is gravity-signed or flipped: reverse its sign (specific force points up)"
            )


def _check_magnetometer(where: str, sensor: Sensor, findings: list[str]) -> None:
    if sensor.magnetometer is None:
        return
    values = sensor.magnetometer.values
    size = float(np.median(np.linalg.norm(values, axis=1)))
    spread = float((np.percentile(values, 99, axis=0) - np.percentile(values, 1, axis=0)).max())
    if size < 5.0:
        raise InputError(
            f"{where}: the magnetic field is {size:.3f} microtesla (the earth's is 25 to 65); "
            "it looks like gauss: set the magnetometer's unit to gauss"
        )
    if size > 200.0 and spread > 200.0:
        raise InputError(
            f"{where}: the magnetic field is {size:.0f} microtesla and turns through {spread:.0f} "
            "(the earth's is 25 to 65); it looks like milligauss: set the magnetometer's unit to milligauss"
        )
    if not 15.0 < size < 90.0:
        findings.append(
            f"{where}: the magnetic field is {size:.0f} microtesla (the earth's is 25 to 65): "
            "strong hard iron or milligauss; calibrate before using it for heading"
        )


def _check_landmarks(recording: Unchecked) -> None:
    marks = recording.landmarks
    if marks is None:
        return
    time, position = marks.time, marks.position
    if time.ndim != 1 or position.shape != (len(time), 3):
        raise InputError(
            f"{recording.name}: landmarks have time {time.shape} and position {position.shape}; "
            "needed are (K,) and (K, 3) with NaN for an unknown coordinate"
        )
    if len(time) == 0:
        raise InputError(f"{recording.name}: the list of landmarks is empty; leave it out instead")
    if not np.isfinite(time).all():
        raise InputError(f"{recording.name}: landmark {int((~np.isfinite(time)).argmax())} has no time")
    unknown = np.flatnonzero(~np.isfinite(position).any(axis=1))
    if len(unknown):
        raise InputError(f"{recording.name}: landmark {unknown[0]} has no known coordinate; remove it")
    half = np.flatnonzero(np.isfinite(position[:, 0]) != np.isfinite(position[:, 1]))
    if len(half):
        raise InputError(
            f"{recording.name}: landmark {half[0]} has only one of x and y; give both, or neither"
        )
    start = min(s.gyroscope.time[0] for s in recording.sensors.values())
    stop = max(s.gyroscope.time[-1] for s in recording.sensors.values())
    step = max(1.0 / s.gyroscope.rate for s in recording.sensors.values())
    outside = np.flatnonzero((time < start - step) | (time > stop + step))
    if len(outside):
        at = outside[0]
        raise InputError(
            f"{recording.name}: landmark {at} at {time[at]:.3f} s lies outside the recording "
            f"({start:.3f} to {stop:.3f} s); check its time base or sample index"
        )


def _check_truths(recording: Unchecked) -> None:
    if recording.truth is not None:
        _check_truth(recording, recording.truth, "truth")
    for name, truth in recording.truths.items():
        if name not in recording.sensors:
            known = suggest(name, recording.sensors)
            raise InputError(f"{recording.name}: there is a truth of '{name}', which is no sensor{known}")
        if truth.sensor != name:
            raise InputError(
                f"{recording.name}: the truth of sensor '{name}' says it is that of {truth.sensor!r}; "
                "make the two agree"
            )
        if recording.truth is not None and recording.truth.sensor == name:
            raise InputError(f"{recording.name}: there are two truths of sensor '{name}'; leave one out")
        _check_truth(recording, truth, f"truth of sensor '{name}'")


def _check_truth(recording: Unchecked, truth: Truth, what: str) -> None:
    if truth.position.shape != (len(truth.time), 3):
        raise InputError(
            f"{recording.name}: {what} has time {truth.time.shape} and position {truth.position.shape}; "
            "needed are (T,) and (T, 3)"
        )
    if truth.quaternion is not None and truth.quaternion.shape != (len(truth.time), 4):
        raise InputError(
            f"{recording.name}: {what} has quaternions {truth.quaternion.shape}; needed are "
            f"({len(truth.time)}, 4), scalar first"
        )
    if not np.isfinite(truth.position).all(axis=1).any():
        raise InputError(f"{recording.name}: the {what} has no valid position")
    start = min(s.gyroscope.time[0] for s in recording.sensors.values())
    stop = max(s.gyroscope.time[-1] for s in recording.sensors.values())
    if not np.isfinite(truth.time).all() or truth.time[-1] < start or truth.time[0] > stop:
        raise InputError(
            f"{recording.name}: the {what} ({truth.time[0]:.2f} to {truth.time[-1]:.2f} s) does not overlap "
            f"the recording ({start:.2f} to {stop:.2f} s); bring them to one time base"
        )
    if (np.diff(truth.time) < 0).any():
        raise InputError(f"{recording.name}: the {what} goes backwards in time; sort it")
