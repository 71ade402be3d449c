"""What a recording is made of: streams, sensors, landmarks and truth (numpy, float64), not yet checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from pedjax.errors import InputError

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


@dataclass(frozen=True)
class Stream:
    """Samples of one instrument on its own clock: `time (T,)` in s, `values (T, D)`."""

    time: np.ndarray
    values: np.ndarray

    def __post_init__(self) -> None:
        _as_floats(self, "time", "values")

    @cached_property
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
class Unchecked:
    """All that is said of one walk. `truths` holds, by sensor, the truth of those beside the one that `truth`
    belongs to, in the same frame. `copy_of` is the fingerprint of the recording of which this is a disturbed
    copy to tune on; empty for all that was recorded."""

    name: str
    sensors: Mapping[str, Sensor]
    landmarks: Landmarks | None = None
    truth: Truth | None = None
    clock: Clock = "stamps"
    format: str = "arrays"
    notes: tuple[str, ...] = ()
    truths: Mapping[str, Truth] = field(default_factory=dict)
    copy_of: str = ""
