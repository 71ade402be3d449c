"""Many recordings as one batch: end to end in equal columns, with the points where they are scored."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax.errors import InputError
from pedjax.evaluation.landmarks import Reference
from pedjax.filtering import Packed, Points
from pedjax.preparing import prepare
from pedjax.shapes import bucket, columns_of
from pedjax.system import System
from pedjax.walks import Walk, reference_of


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["packed", "reference", "rows", "columns", "first", "last", "samples"],
    meta_fields=["slots"],
)
@dataclass(frozen=True)
class Batch:
    """Recordings packed for `filtering.scan_points`, and how to read its `Points` back.

    `reference` has lanes `(R,)` for R recordings and K rows, padded; `rows (K, R)` and `columns (R,)` say
    where each point comes out (−1: padding); `first`, `last (R,)` are the chunks in which each recording
    begins and ends, and `samples (R,)` its length. Shapes come in few sizes, so that another recording of
    about the same length compiles nothing. All recordings of a batch have one sampling rate, in whole Hz.
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

    def estimates(self, points: Points) -> dict[str, Array]:
        """What was kept at the scored points, by name: `(K, ..., *S, R)` for points with lanes `(*S, C)`."""

        def at_points(x: Array) -> Array:
            flat = x.reshape(x.shape[0] * x.shape[1], *x.shape[2:])
            found = jnp.moveaxis(jnp.moveaxis(flat, -1, 1)[jnp.maximum(self.rows, 0), self.columns], 1, -1)
            there = (self.rows >= 0).reshape(len(self.rows), *(1,) * (found.ndim - 2), -1)
            return jnp.where(there, found, 0.0)  # a row that no sample has may hold anything

        return {name: at_points(x) for name, x in points.kept.items()}

    def status(self, points: Points) -> Array:
        """Each run's status at its end, `(*S, R)`: 0 healthy, else the first that was not."""
        return jnp.moveaxis(jnp.moveaxis(points.status, -1, 1)[self.last, self.columns], 0, -1)

    def gates(self, points: Points) -> dict[str, Array]:
        """Mean weight of each gate over each recording, `(*S, R)`."""

        def mean(weights: Array) -> Array:
            chunk = jnp.arange(weights.shape[0])[:, None]
            inside = ((chunk >= self.first) & (chunk <= self.last)).astype(weights.dtype)
            return jnp.einsum("cr,c...r->...r", inside, weights[..., self.columns]) / self.samples

        return {name: mean(x) for name, x in points.gates.items()}


class Batches(NamedTuple):
    """Batches of recordings that cannot share one (their sampling rates differ), and the `order (R,)` of all
    recordings among theirs, put end to end."""

    parts: tuple[Batch, ...]
    order: Array

    def joined(self, found: Sequence[Array]) -> Array:
        """What was found of each batch, `(*S, R)`, in the order of the recordings."""
        return jnp.concatenate(found, axis=-1)[..., self.order]


def alike(walks: Sequence[Walk]) -> list[list[int]]:
    """Numbers of the walks that can share a batch: those of one sampling rate, in whole Hz."""
    rates: dict[float, list[int]] = {}
    for r, w in enumerate(walks):
        rates.setdefault(w.rate_hz, []).append(r)
    return list(rates.values())


def pack_all(
    system: System, parameters: Any, walks: Sequence[Walk], dtype: Any = float, site: Any = None
) -> Batches:
    """Recordings of any sampling rates, those of one rate in a batch."""
    groups = alike(walks)
    if not groups:
        raise InputError("no recording was given")
    parts = tuple(pack(system, parameters, [walks[r] for r in g], dtype, site=site) for g in groups)
    order = np.argsort([r for g in groups for r in g], kind="stable")
    return Batches(parts, jnp.asarray(order))


def chunk_of(walks: Sequence[Walk]) -> int:
    """Length of the driver's chunks: the power of two nearest to the root of the longest recording's."""
    return 1 << round(math.log2(max(map(len, walks))) / 2)


def sizes_of(walks: Sequence[Walk], chunk: int) -> list[int]:
    """Chunks that each recording takes; at least one padding sample ends each."""
    return [len(w) // chunk + 1 for w in walks]


def pack(
    system: System,
    parameters: Any,
    walks: Sequence[Walk],
    dtype: Any = float,
    chunk: int | None = None,
    most_columns: int = 8,
    site: Any = None,
) -> Batch:
    """Pack recordings of one sampling rate into up to `most_columns` columns of equal length with little
    padding."""
    if not walks:
        raise InputError("no recording was given")
    if len(alike(walks)) > 1:
        rates = ", ".join(f"{w.name} at {w.rate_hz:g} Hz" for w in walks)
        raise InputError(f"recordings of one batch need one sampling rate: {rates}; take pack_all")
    chunk = chunk or chunk_of(walks)
    sizes = sizes_of(walks, chunk)
    columns = columns_of(sizes, most_columns)
    chunks = bucket(max(sum(sizes[r] for r in members) for members in columns), parts=16)
    first, column = np.zeros(len(walks), int), np.zeros(len(walks), int)
    for c, members in enumerate(columns):
        first[members] = np.cumsum([0, *(sizes[r] for r in members[:-1])])
        column[members] = c
    which = np.full((chunks, len(columns)), -1, np.int32)
    which[first, column] = np.arange(len(walks))
    slot, slots, rows = _slots(walks, first, column, chunk, (chunks * chunk, len(columns)))
    prepared = [prepare(system, parameters, w, dtype, n * chunk) for w, n in zip(walks, sizes, strict=True)]
    samples = []
    for members in columns:
        parts = [prepared[r].samples for r in members]
        rest = (chunks - sum(sizes[r] for r in members)) * chunk
        parts.append(jax.tree.map(lambda x, n=rest: _idle(x, n), parts[-1]))
        samples.append(jax.tree.map(lambda *x: np.concatenate(x), *parts))
    together = partial(jax.tree.map, lambda *x: jnp.asarray(np.stack(x, axis=-1)))
    return Batch(
        slots=slots,
        packed=Packed(
            together(*samples),
            together(*[each.opening for each in prepared]),
            jnp.asarray(which),
            jnp.asarray(slot),
            site,
        ),
        reference=_reference(walks, dtype),
        rows=jnp.asarray(rows),
        columns=jnp.asarray(column),
        first=jnp.asarray(first),
        last=jnp.asarray(first + np.array(sizes) - 1),
        samples=jnp.asarray([len(w) for w in walks], dtype),
    )


def _slots(
    walks: Sequence[Walk], first: np.ndarray, column: np.ndarray, chunk: int, shape: tuple[int, int]
) -> tuple[np.ndarray, int, np.ndarray]:
    """The buffer row of each sample that is scored (−1: none), how many rows a chunk needs, and where in
    the flattened buffers each point comes out, `(K, R)`. Two points on one sample share its row."""
    slot = np.full(shape, -1)
    used = np.zeros((shape[0] // chunk, shape[1]), int)
    most = _rows(walks)
    in_chunk, slot_of = np.zeros((most, len(walks)), int), np.full((most, len(walks)), -1)
    for r, w in enumerate(walks):
        sample, inverse = np.unique(first[r] * chunk + w.index, return_inverse=True)
        for s in sample:
            slot[s, column[r]] = used[s // chunk, column[r]]
            used[s // chunk, column[r]] += 1
        in_chunk[: len(w.index), r] = sample[inverse] // chunk
        slot_of[: len(w.index), r] = slot[sample, column[r]][inverse]
    slots = bucket(max(int(used.max()), 1))
    return slot, slots, np.where(slot_of >= 0, in_chunk * slots + slot_of, -1)


def _reference(walks: Sequence[Walk], dtype: Any) -> Reference:
    """References side by side in lanes `(R,)`, padded to the longest with points that do not count."""
    rows, headings = _rows(walks), any(w.attitude is not None for w in walks)
    found = []
    for w in walks:
        position, attitude = np.full((rows, 3), np.nan), np.full((rows, 3, 3), np.nan)
        position[: len(w.index)] = w.position
        if w.attitude is not None:
            attitude[: len(w.index)] = w.attitude
        found.append(reference_of(position, dtype, attitude if headings else None))
    return jax.tree.map(lambda *x: jnp.stack(x, axis=-1), *found)


def _rows(walks: Sequence[Walk]) -> int:
    return bucket(max(1, *(len(w.index) for w in walks)))


def _idle(x: np.ndarray, n: int) -> np.ndarray:
    """Padding after a column's last recording: its last (padding) sample repeated, so that time stands."""
    return np.broadcast_to(x[-1:], (n, *x.shape[1:]))
