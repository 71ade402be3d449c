"""Many recordings as one batch: end to end in equal columns, with the points where they are scored."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax.errors import InputError
from pedjax.evaluation.landmarks import Reference
from pedjax.filtering import Packed, Points
from pedjax.recording import Clock, Inertial, Recording, inertial
from pedjax.system import Inputs, System

TRUTH_HZ = 10.0
"""Dense truth is scored at this rate while tuning and sweeping; final reports use every sample of it."""


@dataclass(frozen=True)
class Walk:
    """A recording ready for a filter: its samples on one clock, and where it is scored.

    `index (K,)` samples, `position (K, 3)` m with NaN for what is unknown.
    """

    name: str
    imu: Inertial
    index: np.ndarray
    position: np.ndarray


def points_of(recording: Recording, imu: Inertial, truth_hz: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Sample index `(K,)` and position `(K, 3)` of the landmarks, or of the dense truth where there are
    none, thinned to `truth_hz` (None: every truth sample). Empty where there is neither."""
    if recording.landmarks is not None:
        time, position = recording.landmarks.time, recording.landmarks.position
    elif recording.truth is not None:
        good = np.isfinite(recording.truth.position).all(axis=1)
        time, position = recording.truth.time[good], recording.truth.position[good]
        inside = (time >= imu.time[0]) & (time <= imu.time[-1])
        time, position = time[inside], position[inside]
        if truth_hz is not None and len(time) > 1:
            every = max(round((len(time) - 1) / (time[-1] - time[0]) / truth_hz), 1)
            time, position = time[::every], position[::every]
    else:
        return np.zeros(0, int), np.zeros((0, 3))
    nearest = np.clip(np.searchsorted(imu.time, time), 1, len(imu.time) - 1)
    nearest -= time - imu.time[nearest - 1] < imu.time[nearest] - time
    return nearest, position


def walk(
    recording: Recording, sensor: str = "foot", clock: Clock | None = None, truth_hz: float | None = TRUTH_HZ
) -> Walk:
    """A recording on one clock, with the points it is scored at."""
    imu = inertial(recording, sensor, clock)
    return Walk(recording.name, imu, *points_of(recording, imu, truth_hz))


def reference_of(position: np.ndarray, dtype: Any = float) -> Reference:
    """Reference of `(K, 3)` positions with NaN for what is unknown."""
    known = np.isfinite(position)
    return Reference(
        jnp.asarray(np.where(known, position, 0.0), dtype),
        jnp.asarray(known[:, 0] & known[:, 1], dtype),
        jnp.asarray(known[:, 2], dtype),
    )


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["packed", "reference", "rows", "columns", "closing"],
    meta_fields=["names", "slots"],
)
@dataclass(frozen=True)
class Batch:
    """Recordings packed for `filtering.scan_points`, and how to read its `Points` back.

    `reference` has lanes `(R,)` for R recordings and K rows, padded; `rows (K, R)` and `columns (R,)` say
    where each point comes out; `closing (R,)` is the last chunk of each recording.
    """

    names: tuple[str, ...]
    slots: int
    packed: Packed
    reference: Reference
    rows: Array
    columns: Array
    closing: Array

    @property
    def steps(self) -> int:
        """Filter steps of one run over the batch, padding included."""
        return int(self.packed.slot.size)

    def estimates(self, points: Points) -> Array:
        """Positions at the scored points, `(K, 3, *S, R)` for points with lanes `(*S, C)`."""
        chunks, slots, three, *lanes = points.position.shape
        flat = points.position.reshape(chunks * slots, three, *lanes)
        flat = jnp.moveaxis(flat, -1, 1)[self.rows, self.columns]
        return jnp.moveaxis(flat, 1, -1)

    def healthy(self, points: Points) -> Array:
        """Whether each run stayed finite to its end, `(*S, R)`."""
        return jnp.moveaxis(jnp.moveaxis(points.healthy, -1, 1)[self.closing, self.columns], 0, -1)


@partial(jax.jit, static_argnames=("system", "rate_hz"))
def _prepare(
    system: System, parameters: Any, force: Array, rate: Array, dt: Array, rate_hz: float, length: int
) -> Inputs:
    return system.prepare(parameters, force, rate, dt, rate_hz, length)


def nominal_rate(imu: Inertial) -> float:
    """The sampling rate rounded to whole Hz: what sets the length of windows."""
    return max(float(round(imu.rate)), 1.0)


def bucket(length: int) -> int:
    """The next length of the form m·2ᵉ with m of 8 to 15: few shapes to compile, at most 1/8 of padding."""
    step = 1 << max(length.bit_length() - 4, 0)
    return -(-length // step) * step


def prepare(system: System, parameters: Any, imu: Inertial, dtype: Any, padded: int) -> Inputs:
    """A system's inputs for a recording padded to a length: the last sample repeated with dt = 0."""
    n = len(imu.time)
    extra = bucket(padded) - n

    def pad(x: np.ndarray) -> Array:
        return jnp.asarray(np.concatenate([x, np.repeat(x[-1:], extra, axis=0)]), dtype)

    dt = jnp.asarray(np.concatenate([imu.dt, np.zeros(extra)]), dtype)
    rate_hz = nominal_rate(imu)
    found = _prepare(system, parameters, pad(imu.specific_force), pad(imu.angular_rate), dt, rate_hz, n)
    return found._replace(samples=jax.tree.map(lambda x: x[:padded], found.samples))


def pack(
    system: System, parameters: Any, walks: Sequence[Walk], dtype: Any = float, chunk: int | None = None
) -> Batch:
    """Pack recordings into as few columns as the longest of them allows, each filled evenly."""
    if not walks:
        raise InputError("no recording was given")
    longest = max(len(w.imu.time) for w in walks)
    total = sum(len(w.imu.time) for w in walks)
    chunk = chunk or max(math.isqrt(longest), 1)
    chunks_of = [len(w.imu.time) // chunk + 1 for w in walks]  # at least one padding sample ends each
    count = max(1, -(-total // max(longest, 1)))
    columns: list[list[int]] = [[] for _ in range(count)]
    filled = [0] * count
    for r in sorted(range(len(walks)), key=lambda r: -chunks_of[r]):  # longest first, emptiest column
        c = int(np.argmin(filled))
        columns[c].append(r)
        filled[c] += chunks_of[r]
    chunks = max(filled)
    placed = {}
    for c, members in enumerate(columns):
        at = 0
        for r in members:
            placed[r] = (c, at)
            at += chunks_of[r]
    begin = np.zeros((chunks, count), bool)
    slot = np.full((chunks * chunk, count), -1)
    used = np.zeros((chunks, count), int)
    most = max(max((len(w.index) for w in walks), default=0), 1)
    chunk_of_point = np.zeros((most, len(walks)), int)
    slot_of_point = np.zeros((most, len(walks)), int)
    position = np.zeros((most, 3, len(walks)))
    known = np.zeros((2, most, len(walks)))
    prepared = []
    for r, w in enumerate(walks):
        column, first = placed[r]
        begin[first, column] = True
        sample, inverse = np.unique(first * chunk + w.index, return_inverse=True)
        for s in sample:
            slot[s, column] = used[s // chunk, column]
            used[s // chunk, column] += 1
        k = len(w.index)
        chunk_of_point[:k, r], slot_of_point[:k, r] = sample[inverse] // chunk, slot[sample, column][inverse]
        finite = np.isfinite(w.position)
        position[:k, :, r] = np.where(finite, w.position, 0.0)
        known[0, :k, r], known[1, :k, r] = finite[:, 0] & finite[:, 1], finite[:, 2]
        prepared.append(prepare(system, parameters, w.imu, dtype, chunks_of[r] * chunk))
    slots = max(int(used.max()), 1)
    samples, openings = [], []
    for c, members in enumerate(columns):
        parts = [prepared[r].samples for r in members]
        rest = (chunks - filled[c]) * chunk
        if rest:
            parts.append(jax.tree.map(lambda x, n=rest: _idle(x, n), parts[-1]))
        samples.append(jax.tree.map(lambda *x: jnp.concatenate(x), *parts))
        at_chunk = np.searchsorted([placed[r][1] for r in members], np.arange(chunks), "right") - 1
        stacked = jax.tree.map(lambda *x: jnp.stack(x), *[prepared[r].opening for r in members])
        openings.append(jax.tree.map(lambda x, i=at_chunk: x[i], stacked))
    together = partial(jax.tree.map, lambda *x: jnp.stack(x, axis=-1))
    packed = Packed(together(*samples), together(*openings), jnp.asarray(begin), jnp.asarray(slot))
    return Batch(
        names=tuple(w.name for w in walks),
        packed=packed,
        slots=slots,
        reference=Reference(*(jnp.asarray(x, dtype) for x in (position, *known))),
        rows=jnp.asarray(chunk_of_point * slots + slot_of_point),
        columns=jnp.asarray([placed[r][0] for r in range(len(walks))]),
        closing=jnp.asarray([placed[r][1] + chunks_of[r] - 1 for r in range(len(walks))]),
    )


def _idle(x: Array, n: int) -> Array:
    """Padding after a column's last recording: its last (padding) sample repeated, so that time stands."""
    return jnp.broadcast_to(x[-1:], (n, *x.shape[1:]))
