"""Many recordings as one batch: end to end in equal columns, with the points where they are scored."""

from __future__ import annotations

import heapq
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
from pedjax.recording import Clock, Inertial, Recording, inertial, nearest, sampling_rate
from pedjax.system import Inputs, Signals, System

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


def points_of(
    recording: Recording, stamps: np.ndarray, truth_hz: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Index `(K,)` among samples at `stamps (T,)` s, and position `(K, 3)`, of the landmarks, or of the
    dense truth where there are none, thinned to `truth_hz` (None: every truth sample). Empty where there is
    neither."""
    if recording.landmarks is not None:
        time, position = recording.landmarks.time, recording.landmarks.position
    elif recording.truth is not None:
        good = np.isfinite(recording.truth.position).all(axis=1)
        time, position = recording.truth.time[good], recording.truth.position[good]
        inside = (time >= stamps[0]) & (time <= stamps[-1])
        time, position = time[inside], position[inside]
        if truth_hz is not None and len(time) > 1:
            every = max(round((len(time) - 1) / (time[-1] - time[0]) / truth_hz), 1)
            time, position = time[::every], position[::every]
    else:
        return np.zeros(0, int), np.zeros((0, 3))
    index = nearest(stamps, time)
    far = np.abs(stamps[index] - time) > max(2.0 / sampling_rate(np.diff(stamps)), 0.05)
    if recording.landmarks is None:  # dense truth: what falls into a gap is left out
        return index[~far], position[~far]
    if far.any():
        raise InputError(
            f"{recording.name}: landmark {int(far.argmax())} at {time[far.argmax()]:.3f} s has no inertial "
            "sample near it (a gap, or a stream that is shorter than the others); remove it"
        )
    return index, position


def walk(
    recording: Recording, sensor: str = "foot", clock: Clock | None = None, truth_hz: float | None = TRUTH_HZ
) -> Walk:
    """A recording on one clock, with the points it is scored at."""
    imu = inertial(recording, sensor, clock)
    return Walk(recording.name, imu, *points_of(recording, imu.time, truth_hz))


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
    data_fields=["packed", "reference", "rows", "columns", "first", "last", "samples"],
    meta_fields=["slots"],
)
@dataclass(frozen=True)
class Batch:
    """Recordings packed for `filtering.scan_points`, and how to read its `Points` back.

    `reference` has lanes `(R,)` for R recordings and K rows, padded; `rows (K, R)` and `columns (R,)` say
    where each point comes out; `first`, `last (R,)` are the chunks in which each recording begins and ends,
    and `samples (R,)` its length. Shapes come in few sizes, so that another recording of about the same
    length compiles nothing.
    """

    slots: int
    packed: Packed
    reference: Reference
    rows: Array
    columns: Array
    first: Array
    last: Array
    samples: Array

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
        return jnp.moveaxis(jnp.moveaxis(points.healthy, -1, 1)[self.last, self.columns], 0, -1)

    def stance(self, points: Points) -> Array:
        """Mean weight of the zero-velocity update over each recording, `(*S, R)`."""
        chunk = jnp.arange(points.updates.shape[0])[:, None]
        inside = ((chunk >= self.first) & (chunk <= self.last)).astype(points.updates.dtype)
        total = jnp.einsum("cr,c...r->...r", inside, points.updates[..., self.columns])
        return total / self.samples


@partial(jax.jit, static_argnames=("system", "rate_hz"))
def _prepare(system: System, parameters: Any, signals: Signals, rate_hz: float, length: int) -> Inputs:
    return system.prepare(parameters, signals, rate_hz, length)


def nominal_rate(imu: Inertial) -> float:
    """The sampling rate rounded to whole Hz: what sets the length of windows."""
    return max(float(round(imu.rate)), 1.0)


def bucket(length: int, parts: int = 8) -> int:
    """The next length m·2ᵉ with m from `parts` to twice that: few shapes to compile, 1/`parts` of padding at
    most."""
    step = 1 << max(length.bit_length() - parts.bit_length(), 0)
    return -(-length // step) * step


def prepare(system: System, parameters: Any, imu: Inertial, dtype: Any, padded: int) -> Inputs:
    """A system's inputs for a recording padded to a length: the last sample repeated with dt = 0."""
    n = len(imu.time)
    extra = bucket(padded) - n

    def pad(x: np.ndarray) -> Array:
        return jnp.asarray(np.concatenate([x, np.repeat(x[-1:], extra, axis=0)]), dtype)

    dt = jnp.asarray(np.concatenate([imu.dt, np.zeros(extra)]), dtype)
    rate_hz = nominal_rate(imu)
    field = imu.magnetic_field
    magnetic = pad(field) if system.magnetic and field is not None else None
    signals = Signals(pad(imu.specific_force), pad(imu.angular_rate), dt, magnetic)
    found = _prepare(system, parameters, signals, rate_hz, n)
    return found._replace(samples=jax.tree.map(lambda x: x[:padded], found.samples))


def distinct(names: Sequence[str]) -> list[str]:
    """The names, a repeated one with a number: a, b, a__2."""
    seen: dict[str, int] = {}
    found = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name}__{seen[name]}")
    return found


def columns_of(sizes: Sequence[int], most: int) -> list[list[int]]:
    """Items of those sizes in columns: as many, up to `most`, as cost at most a twentieth more than one."""
    tried = [_fill(sizes, count) for count in range(1, min(most, len(sizes)) + 1)]
    return next(way for way in reversed(tried) if padded(sizes, way) <= 1.05 * sum(sizes))


def padded(sizes: Sequence[int], columns: Sequence[Sequence[int]]) -> int:
    """What items of those sizes take in columns of equal length."""
    return len(columns) * max(sum(sizes[r] for r in members) for members in columns)


def _fill(sizes: Sequence[int], count: int) -> list[list[int]]:
    """The longest first, each into the emptiest column."""
    heap = [(0, c) for c in range(count)]
    columns: list[list[int]] = [[] for _ in range(count)]
    for r in sorted(range(len(sizes)), key=lambda r: -sizes[r]):
        filled, c = heapq.heappop(heap)
        columns[c].append(r)
        heapq.heappush(heap, (filled + sizes[r], c))
    return columns


def chunk_of(walks: Sequence[Walk]) -> int:
    """Length of the driver's chunks: the power of two nearest to the root of the longest recording's."""
    return 1 << round(math.log2(max(len(w.imu.time) for w in walks)) / 2)


def sizes_of(walks: Sequence[Walk], chunk: int) -> list[int]:
    """Chunks that each recording takes; at least one padding sample ends each."""
    return [len(w.imu.time) // chunk + 1 for w in walks]


def pack(
    system: System,
    parameters: Any,
    walks: Sequence[Walk],
    dtype: Any = float,
    chunk: int | None = None,
    most_columns: int = 8,
) -> Batch:
    """Pack recordings into up to `most_columns` columns of equal length with little padding."""
    if not walks:
        raise InputError("no recording was given")
    chunk = chunk or chunk_of(walks)
    sizes = sizes_of(walks, chunk)
    columns = columns_of(sizes, most_columns)
    chunks = bucket(max(sum(sizes[r] for r in members) for members in columns), parts=16)
    first, column = np.zeros(len(walks), int), np.zeros(len(walks), int)
    for c, members in enumerate(columns):
        first[members] = np.cumsum([0, *(sizes[r] for r in members[:-1])])
        column[members] = c
    begin = np.zeros((chunks, len(columns)), bool)
    begin[first, column] = True
    slot, slots, rows = _slots(walks, first, column, chunk, (chunks * chunk, len(columns)))
    prepared = [
        prepare(system, parameters, w.imu, dtype, n * chunk) for w, n in zip(walks, sizes, strict=True)
    ]
    samples, openings = [], []
    for members in columns:
        parts = [prepared[r].samples for r in members]
        rest = (chunks - sum(sizes[r] for r in members)) * chunk
        parts.append(jax.tree.map(lambda x, n=rest: _idle(x, n), parts[-1]))
        samples.append(jax.tree.map(lambda *x: jnp.concatenate(x), *parts))
        current = np.searchsorted(first[members], np.arange(chunks), "right") - 1
        stacked = jax.tree.map(lambda *x: jnp.stack(x), *[prepared[r].opening for r in members])
        openings.append(jax.tree.map(lambda x, i=current: x[i], stacked))
    together = partial(jax.tree.map, lambda *x: jnp.stack(x, axis=-1))
    return Batch(
        slots=slots,
        packed=Packed(together(*samples), together(*openings), jnp.asarray(begin), jnp.asarray(slot)),
        reference=_reference(walks, dtype),
        rows=jnp.asarray(rows),
        columns=jnp.asarray(column),
        first=jnp.asarray(first),
        last=jnp.asarray(first + np.array(sizes) - 1),
        samples=jnp.asarray([len(w.imu.time) for w in walks], dtype),
    )


def _slots(
    walks: Sequence[Walk], first: np.ndarray, column: np.ndarray, chunk: int, shape: tuple[int, int]
) -> tuple[np.ndarray, int, np.ndarray]:
    """The buffer row of each sample that is scored (−1: none), how many rows a chunk needs, and where in
    the flattened buffers each point comes out, `(K, R)`. Two points on one sample share its row."""
    slot = np.full(shape, -1)
    used = np.zeros((shape[0] // chunk, shape[1]), int)
    most = _rows(walks)
    in_chunk, slot_of = np.zeros((most, len(walks)), int), np.zeros((most, len(walks)), int)
    for r, w in enumerate(walks):
        sample, inverse = np.unique(first[r] * chunk + w.index, return_inverse=True)
        for s in sample:
            slot[s, column[r]] = used[s // chunk, column[r]]
            used[s // chunk, column[r]] += 1
        in_chunk[: len(w.index), r] = sample[inverse] // chunk
        slot_of[: len(w.index), r] = slot[sample, column[r]][inverse]
    slots = bucket(max(int(used.max()), 1))
    return slot, slots, in_chunk * slots + slot_of


def _reference(walks: Sequence[Walk], dtype: Any) -> Reference:
    """References side by side in lanes `(R,)`, padded to the longest with points that do not count."""
    known = np.full((len(walks), _rows(walks), 3), np.nan)
    for r, w in enumerate(walks):
        known[r, : len(w.index)] = w.position
    return jax.tree.map(lambda *x: jnp.stack(x, axis=-1), *[reference_of(p, dtype) for p in known])


def _rows(walks: Sequence[Walk]) -> int:
    return bucket(max(1, *(len(w.index) for w in walks)))


def _idle(x: Array, n: int) -> Array:
    """Padding after a column's last recording: its last (padding) sample repeated, so that time stands."""
    return jnp.broadcast_to(x[-1:], (n, *x.shape[1:]))
