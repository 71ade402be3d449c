"""What tells recordings apart: hashes of their samples."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from pedjax.recording import Recording, Stream

_STREAMS = ("accelerometer", "gyroscope", "magnetometer")


def fingerprint(recording: Recording) -> str:
    """A short hash of all that its sensors measured, their names, and when: the same walk under another name,
    or begun at another hour, has the same one."""
    return fingerprint_of(streams(recording))


def walk_fingerprint(recording: Recording) -> str:
    """The fingerprint of the walk: for a disturbed copy that of the recording it was made of."""
    return recording.copy_of or fingerprint(recording)


def streams(recording: Recording) -> dict[str, str]:
    """A short hash of each stream, by 'sensor.kind'; times count from the recording's first sample."""
    given = {
        f"{name}.{kind}": getattr(sensor, kind)
        for name, sensor in sorted(recording.sensors.items())
        for kind in _STREAMS
        if getattr(sensor, kind) is not None
    }
    first = min(float(stream.time[0]) for stream in given.values())
    return {name: _hash(stream, first) for name, stream in given.items()}


def fingerprint_of(found: Mapping[str, str]) -> str:
    """The fingerprint of a recording from the hashes of its `streams`."""
    text = "\n".join(f"{name} {found[name]}" for name in sorted(found))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _hash(stream: Stream, first: float) -> str:
    # values as they are, in float64: files in float32 read to the same float64 every time. Times in whole
    # microseconds, since taking off a start of 1.7e9 s leaves rounding of a tenth of one.
    moments = np.round(1e6 * (stream.time - first)).astype("<i8")
    values = np.ascontiguousarray(stream.values + 0.0, "<f8")  # + 0.0: no sign of zero
    return hashlib.sha256(moments.tobytes() + values.tobytes()).hexdigest()[:16]
