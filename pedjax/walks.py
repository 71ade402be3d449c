"""A recording ready for a filter: its sensors on one clock, and where it is scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from pedjax import rotations
from pedjax.errors import InputError
from pedjax.evaluation.landmarks import Reference
from pedjax.recording import (
    Clock,
    Inertial,
    Recording,
    Stream,
    inertial,
    interpolate,
    nearest,
    nominal_rate,
    sampling_rate,
)
from pedjax.system import Need, System

TRUTH_HZ = 10.0
"""Dense truth is scored at this rate while tuning and sweeping; final reports use every sample of it."""

Sensors = str | Mapping[str, str] | None
"""Which sensor plays which role: a name for the first role, or names by role. What is not said plays the role
of its own name."""


@dataclass(frozen=True)
class Walk:
    """A recording ready for a filter.

    `sensors` by role, the first of which gives the clock; `index (K,)` samples at which it is scored,
    `position (K, 3)` m there, NaN for what is unknown, and `attitude (K, 3, 3)` where headings are scored.
    """

    name: str
    sensors: Mapping[str, Inertial]
    index: np.ndarray
    position: np.ndarray
    attitude: np.ndarray | None = None

    @property
    def imu(self) -> Inertial:
        """The first sensor, whose clock all are on."""
        return next(iter(self.sensors.values()))

    @property
    def rate_hz(self) -> float:
        """Sampling rate in whole Hz."""
        return nominal_rate(self.imu)

    def __len__(self) -> int:
        return len(self.imu.time)


def distinct(names: Sequence[str]) -> list[str]:
    """The names, a repeated one with a number: a, b, a__2."""
    seen: dict[str, int] = {}
    found = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name}__{seen[name]}")
    return found


def sensor_names(needs: Sequence[Need], sensors: Sensors = None) -> dict[str, str]:
    """Role to sensor for what a system needs; a role that it does not have is an `InputError`."""
    roles = [need.role for need in needs]
    if isinstance(sensors, str):
        sensors = {roles[0]: sensors}
    given = dict(sensors or {})
    for role in given:
        if role not in roles:
            raise InputError(f"--sensor {role}={given[role]}: the system's roles are {', '.join(roles)}")
    return {role: given.get(role, role) for role in roles}


def walk(
    recording: Recording,
    sensors: Sensors = None,
    clock: Clock | None = None,
    truth_hz: float | None = TRUTH_HZ,
    needs: Sequence[Need] = (Need("foot"),),
    headings: bool = False,
) -> Walk:
    """A recording on the clock of the first sensor needed, with the points that it is scored at: with
    `headings`, where its attitude is known."""
    names = sensor_names(needs, sensors)
    first, *others = (inertial(recording, name, clock) for name in names.values())
    own = next(iter(names.values()))
    beside = [
        _on_clock(recording.name, name, other, first)
        for name, other in zip(list(names.values())[1:], others, strict=True)
    ]
    placed = dict(zip(names, [first, *beside], strict=True))
    if headings:
        return Walk(recording.name, placed, *attitudes_of(recording, first.time, truth_hz, own))
    return Walk(recording.name, placed, *points_of(recording, first.time, truth_hz, own))


_COVERED = 0.5  # s that a further sensor may end before the first, or begin after it


def _on_clock(recording: str, name: str, sensor: Inertial, first: Inertial) -> Inertial:
    """A sensor's samples at the first one's times, by straight lines between them."""
    time = first.time
    lacks = max(sensor.time[0] - time[0], time[-1] - sensor.time[-1])
    if lacks > _COVERED:
        raise InputError(
            f"{recording}: sensor '{name}' lasts from {sensor.time[0]:.2f} to {sensor.time[-1]:.2f} s, the "
            f"first sensor from {time[0]:.2f} to {time[-1]:.2f} s; cut the recording to what both have"
        )

    def at(values: np.ndarray) -> np.ndarray:
        return interpolate(Stream(sensor.time, values), time)

    field = None if sensor.magnetic_field is None else at(sensor.magnetic_field)
    return Inertial(time, first.dt, at(sensor.specific_force), at(sensor.angular_rate), field)


def points_of(
    recording: Recording, stamps: np.ndarray, truth_hz: float | None, sensor: str | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Index `(K,)` among samples at `stamps (T,)` s, and position `(K, 3)`, of the landmarks, or of the
    dense truth (of that sensor, where it has its own) where there are none, thinned to `truth_hz` (None:
    every truth sample). Empty where there is neither."""
    truth = recording.truth_of(sensor)
    if recording.landmarks is not None:
        time, position = recording.landmarks.time, recording.landmarks.position
    elif truth is not None:
        keep = _thinned(truth.time, np.isfinite(truth.position).all(axis=1), stamps, truth_hz)
        time, position = truth.time[keep], truth.position[keep]
    else:
        return np.zeros(0, int), np.zeros((0, 3))
    index, far = _nearest(stamps, time)
    if recording.landmarks is None:  # dense truth: what falls into a gap is left out
        return index[~far], position[~far]
    if far.any():
        raise InputError(
            f"{recording.name}: landmark {int(far.argmax())} at {time[far.argmax()]:.3f} s has no inertial "
            "sample near it (a gap, or a stream that is shorter than the others); remove it"
        )
    return index, position


def attitudes_of(
    recording: Recording, stamps: np.ndarray, truth_hz: float | None, sensor: str | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index `(K,)` among samples at `stamps (T,)` s, and true position `(K, 3)` (NaN where unknown) and
    attitude `(K, 3, 3)`, body to navigation, of the sensor, thinned to `truth_hz`. Empty where no orientation
    is known."""
    truth = recording.truth_of(sensor)
    nothing = np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3, 3))
    if truth is None or truth.quaternion is None:
        return nothing
    keep = _thinned(truth.time, np.isfinite(truth.quaternion).all(axis=1), stamps, truth_hz)
    index, far = _nearest(stamps, truth.time[keep])
    quaternion = truth.quaternion[keep][~far]
    if not len(quaternion):
        return nothing
    turned = np.asarray(rotations.from_quaternion(jnp.asarray(quaternion.T)), float)
    return index[~far], truth.position[keep][~far], np.moveaxis(turned, -1, 0)


def _thinned(time: np.ndarray, good: np.ndarray, stamps: np.ndarray, truth_hz: float | None) -> np.ndarray:
    """Indices of the good samples inside the walk, at about that rate."""
    keep = np.flatnonzero(good)
    keep = keep[(time[keep] >= stamps[0]) & (time[keep] <= stamps[-1])]
    if truth_hz is not None and len(keep) > 1:
        every = max(round((len(keep) - 1) / (time[keep[-1]] - time[keep[0]]) / truth_hz), 1)
        keep = keep[::every]
    return keep


def _nearest(stamps: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the sample nearest to each time, and whether it is too far to be the same moment."""
    if not len(time):
        return np.zeros(0, int), np.zeros(0, bool)
    index = nearest(stamps, time)
    return index, np.abs(stamps[index] - time) > max(2.0 / sampling_rate(np.diff(stamps)), 0.05)


def reference_of(position: np.ndarray, dtype: Any = float, attitude: np.ndarray | None = None) -> Reference:
    """Reference of positions `(K, 3)` and attitudes `(K, 3, 3)` with NaN for what is unknown."""
    known = np.isfinite(position)
    turned = None
    if attitude is not None:
        sure = np.isfinite(attitude).all(axis=(1, 2))
        whole = np.where(sure[:, None, None], attitude, np.eye(3))
        turned = (jnp.asarray(whole, dtype), jnp.asarray(sure, dtype))
    return Reference(
        jnp.asarray(np.where(known, position, 0.0), dtype),
        jnp.asarray(known[:, 0] & known[:, 1], dtype),
        jnp.asarray(known[:, 2], dtype),
        *(turned or (None, None)),
    )


def check_walk(system: System, params: Any, walk: Walk) -> None:
    """Refuse a recording that is too short for a system, or whose magnetometer it cannot do without."""
    for need in system.needs:
        imu = walk.sensors[need.role]
        if not need.field:
            continue
        if imu.magnetic_field is None:
            raise InputError(
                f"{walk.name}: the system '{system.name}' needs a magnetometer and this sensor has none; "
                "choose another --sensor, or another --system (iez)"
            )
        lost = np.isnan(imu.magnetic_field).any(axis=1)
        if lost.all() or (lost.any() and not need.gaps):
            begins = imu.time[lost.argmax()] - imu.time[0]
            raise InputError(
                f"{walk.name}: the magnetometer has no readings for {imu.dt[lost].sum():.1f} s, the "
                f"first time {begins:.1f} s after the start; use another recording, or --system iez"
            )
    seconds, path = system.shortest(params)
    if len(walk) / walk.rate_hz < seconds * (1 - 1e-9):
        raise InputError(
            f"{walk.name}: {len(walk)} samples at {walk.rate_hz:g} Hz are {len(walk) / walk.rate_hz:.3g} s, "
            f"and {path} asks for at least {seconds:.3g} s; record longer, or shorten {path}"
        )
