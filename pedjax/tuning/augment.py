"""Disturbed copies to tune on: the same walks with magnets beside the sensor that nobody carried.

A person meets few magnets in a walk, so that numbers tuned on a few walks fit those few magnets. Copies with
other magnets, as many as one likes, show a system more of what may come.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pedjax.errors import InputError
from pedjax.identity import walk_fingerprint
from pedjax.recording import Recording, Sensor, Stream

_SWING = 0.4  # of each of the two swings of a magnet that comes by hand: together up to 53 degrees to a side
_PERIOD = (4.0, 12.0)  # s, of a swing
_BEFORE = 10.0  # magnets before the recording begins, after which it may begin beside one


@dataclass(frozen=True)
class Augment:
    """What the copies of a recording that is tuned on are disturbed by. Off by default.

    `copies` of each recording beside it (0: none), each of which costs as much time as the recording; `low`
    and `high` bounds of a magnet's field at the sensor, at its strongest, in microtesla (drawn evenly on a
    log scale); `on` mean time that a magnet stays and `off` mean time between two, in s, each from half-way
    up or down to the next; `rise` time that it takes to come, and to go, in s; `iron` standard deviation
    along each axis of a copy's constant hard iron, in microtesla; `bias` the same of a constant bias added to
    each gyroscope, in rad/s; `seed` of all that is drawn.
    """

    copies: int = 0
    low: float = 15.0
    high: float = 150.0
    on: float = 4.0
    off: float = 10.0
    rise: float = 0.5
    iron: float = 9.0
    bias: float = 0.0
    seed: int = 0


_LIMITS = (
    ("copies", 0, 1000), ("low", 1e-3, 1000), ("high", 1e-3, 1000), ("on", 0.1, 1e4), ("off", 0.1, 1e4),
    ("rise", 0, 100), ("iron", 0, 100), ("bias", 0, 0.5), ("seed", 0, 2**63),
)  # fmt: skip


def check(augment: Augment) -> None:
    """Refuse settings that make no magnets."""
    for name, low, high in _LIMITS:
        value = getattr(augment, name)
        whole = name in ("copies", "seed")
        if not isinstance(value, int if whole else int | float) or not low <= value <= high:
            number = "a whole number " if whole else ""
            raise InputError(f"tune.augment.{name} = {value!r} must be {number}between {low:g} and {high:g}")
    if augment.low > augment.high:
        raise InputError(
            f"tune.augment.low = {augment.low:g} must not be above tune.augment.high = {augment.high:g}"
        )
    if augment.rise > min(augment.on, augment.off):
        raise InputError(
            f"tune.augment.rise = {augment.rise:g} must not be longer than tune.augment.on = {augment.on:g} "
            f"and tune.augment.off = {augment.off:g}"
        )


def disturbed(recording: Recording, augment: Augment, copy_number: int) -> Recording:
    """A copy of the recording, `NAME+magnets1`, whose magnetometers also measure magnets and hard iron.

    Such a magnet is one that moves with the body, at the sensor's own place: each has a random direction and
    strength, comes within `rise` s, stays a while and goes. Half of them are fixed to the body, as when a
    phone slides to a clasp in its pocket; the direction of the others turns slowly, as when a hand holds
    headphones near it. Each sensor has its own. A copy may begin beside a magnet. What it is not: the iron of
    a building, which stays where it is while the walk passes it (what the recording met of that is still in
    the copy), nor a magnetometer at the end of its range.

    Truth, landmarks, times and gaps stay, and so does all that is inertial, but for a `bias` that was asked
    for. The same seed, name and number give the same copy to the bit, another number an independent one.
    The copy knows whose it is (`copy_of`): it counts as the same walk where recordings are held back.
    """
    check(augment)
    if all(sensor.magnetometer is None for sensor in recording.sensors.values()):
        raise InputError(
            f"{recording.name}: there is no magnetometer to put magnets beside; leave the recording out, or "
            "set tune.augment.copies = 0"
        )
    name = f"{recording.name}+magnets{copy_number}"
    sensors = {
        key: _disturbed(sensor, augment, _generator(augment.seed, copy_number, recording.name, key))
        for key, sensor in recording.sensors.items()
    }
    note = f"{name}: its field has magnets and hard iron that nobody measured"
    try:
        return replace(
            recording,
            name=name,
            sensors=sensors,
            notes=(*recording.notes, note),
            copy_of=walk_fingerprint(recording),
        )
    except InputError as error:
        raise InputError(
            f"{error} (a copy made by tune.augment: lower its high, its iron or its bias)"
        ) from None


def copies_of(recordings: Sequence[Recording], augment: Augment) -> list[Recording]:
    """The disturbed copies of all recordings: all of the first one, then those of the next."""
    numbers = range(1, augment.copies + 1)
    return [disturbed(recording, augment, number) for recording in recordings for number in numbers]


def with_copies(part: Iterable[int], count: int, augment: Augment) -> list[int]:
    """Numbers of some of `count` recordings and of their copies, where `copies_of` follow the recordings."""
    part, each = list(part), augment.copies
    return part + [count + i * each + c for i in part for c in range(each)]


def _generator(seed: int, copy_number: int, name: str, sensor: str) -> np.random.Generator:
    text = "\n".join((str(seed), str(copy_number), name, sensor))
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:16], "little"))


def _disturbed(sensor: Sensor, augment: Augment, rng: np.random.Generator) -> Sensor:
    iron = augment.iron * rng.normal(size=3)
    bias = augment.bias * rng.normal(size=3)  # drawn in any case: the magnets do not depend on it
    if augment.bias > 0:
        gyroscope = sensor.gyroscope
        sensor = replace(sensor, gyroscope=Stream(gyroscope.time, gyroscope.values + bias))
    if sensor.magnetometer is None:
        return sensor
    time, values = sensor.magnetometer.time, sensor.magnetometer.values
    return replace(sensor, magnetometer=Stream(time, values + iron + magnets(time, augment, rng)))


def magnets(time: np.ndarray, augment: Augment, rng: np.random.Generator) -> np.ndarray:
    """The field `(T, 3)` of magnets that come and go, in body axes, at ascending `time (T,)` s."""
    field = np.zeros((len(time), 3))
    half = 0.5 * augment.rise
    end = float(time[0]) - _BEFORE * (augment.on + augment.off)
    while True:
        begin = end + augment.rise + rng.exponential(augment.off - augment.rise)
        end = begin + augment.rise + rng.exponential(augment.on - augment.rise)
        if begin - half >= time[-1]:
            return field
        first, last = np.searchsorted(time, [begin - half, end + half])
        now = time[first:last]  # empty for those that were gone before
        strength = augment.low * (augment.high / augment.low) ** rng.uniform()
        rises = _ramp(now - begin, augment.rise) * _ramp(end - now, augment.rise)
        field[first:last] += (strength * rises)[:, None] * _directions(now - begin, rng)


def _ramp(since: np.ndarray, rise: float) -> np.ndarray:
    """From 0 to 1, smooth, half-way up at 0 s."""
    part = np.clip(since / max(rise, 1e-9) + 0.5, 0.0, 1.0)
    return part * part * (3.0 - 2.0 * part)


def _directions(since: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Unit vectors `(T, 3)` to a magnet: one and the same, or a smooth path around it."""
    middle, *swings = (v / np.linalg.norm(v) for v in rng.normal(size=(3, 3)))
    periods, phases = rng.uniform(*_PERIOD, size=2), rng.uniform(0.0, 2 * np.pi, size=2)
    by_hand = rng.uniform() < 0.5
    path = np.tile(middle, (len(since), 1))
    if by_hand:
        for swing, period, phase in zip(swings, periods, phases, strict=True):
            path += _SWING * np.sin(2 * np.pi * since / period + phase)[:, None] * swing
    return path / np.linalg.norm(path, axis=1, keepdims=True)
