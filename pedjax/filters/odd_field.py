"""How odd a reading of the magnetic field is, as one soft weight with a memory.

    L = ((|m − h| − |B|)/level)⁴ + ((vertical − B_z)/vertical)⁴ + (NIS/innovation)² + (recent range/range)⁴
    memory ← max(L, memory e^(−dt/hold)),  W = 1/(1 + memory)

with m − h the reading without hard iron, its vertical part by the attitude, NIS the innovation against its
own spread, per axis, with a noise of its own, and the range of |m − h| over the last half a second or so. A
magnet that comes near is odd before it turns the heading by much; the memory lets nothing in between the
swings of a leg, at which its field happens to be of the usual size.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from pedjax.filters import kalman
from pedjax.filters.covariance import Covariance
from pedjax.filters.kalman import Rows
from pedjax.lanes import eye, norm
from pedjax.parameters import leaf, parameters

_KIT = "kit choice"
_RECENT = 0.5  # s


@parameters
class OddField:
    """What is odd, and for how long it is remembered."""

    level: Array = leaf(
        16.0, unit="uT", low=0.1, high=500.0, source=_KIT, tune=True,
        meaning="Deviation of the strength that halves a reading's weight; raised, stronger and weaker "
        "fields count more.",
    )  # fmt: skip
    vertical: Array = leaf(
        20.0, unit="uT", low=0.1, high=500.0, source=_KIT, tune=True,
        meaning="Deviation of the vertical part that halves a reading's weight; raised, fields of another "
        "dip count more.",
    )  # fmt: skip
    innovation: Array = leaf(
        1.2, unit="1", low=1e-2, high=100.0, source=_KIT, tune=True,
        meaning="Squared innovation in units of its spread, per axis, that halves a reading's weight; "
        "raised, unexpected fields count more.",
    )  # fmt: skip
    innovation_sigma: Array = leaf(
        4.0, unit="uT", low=1e-2, high=100.0, source=_KIT, tune=True,
        meaning="Noise with which an innovation is judged; raised, it is odd later.",
    )  # fmt: skip
    range: Array = leaf(
        20.0, unit="uT", low=0.1, high=500.0, source=_KIT, tune=True,
        meaning="Recent range of the strength that halves a reading's weight; raised, fields that change "
        "count more.",
    )  # fmt: skip
    hold: Array = leaf(
        0.3, unit="s", low=1e-3, high=100.0, source=_KIT, tune=True,
        meaning="For how long an odd field is remembered; raised, readings come back later.",
    )  # fmt: skip


class Oddness(NamedTuple):
    """The recent `high` and `low (*L)` of the strength, µT, the `memory (*L)` of what was odd, and whether
    anything was `seen (*L)`."""

    high: Array
    low: Array
    memory: Array
    seen: Array


def start(like: Array) -> Oddness:
    """Nothing seen; `like (*L)` is zeros."""
    return Oddness(like, like, like, like)


def judged(
    q: OddField,
    before: Oddness,
    P: Covariance,
    rows: Rows,
    reading: Array,
    field: Array,
    attitude: Array,
    dt: Array,
    known: Array,
) -> tuple[Oddness, Array, Array]:
    """The memory, the weight W `(*L)` and log(memory) of a `reading (3, *L)` without hard iron, beside the
    `field (3, *L)` that is expected in navigation axes; `rows` are those of the reading, as the filter takes
    them. Where there is no reading (`known` 0), nothing changes but time."""
    size = norm(reading, small=1e-12)
    first = before.seen < 0.5
    high, low = (jnp.where(first, size, x) for x in (before.high, before.low))
    share = 1 - jnp.exp(-dt / _RECENT)
    high = jnp.maximum(size, high + (size - high) * share)
    low = jnp.minimum(size, low + (size - low) * share)
    judging = rows._replace(noise=q.innovation_sigma**2 * eye(3, size) + 0 * rows.noise)
    nis = kalman.normalised_innovation(P, judging) / 3
    upward = jnp.sum(attitude[2] * reading, axis=0)
    odd = (
        ((size - norm(field, small=1e-12)) / q.level) ** 4
        + ((upward - field[2]) / q.vertical) ** 4
        + (nis / q.innovation) ** 2
        + ((high - low) / q.range) ** 4
    )
    faded = before.memory * jnp.exp(-dt / q.hold)
    is_known = known > 0
    memory = jnp.where(is_known, jnp.maximum(odd, faded), faded)
    kept = Oddness(
        jnp.where(is_known, high, before.high),
        jnp.where(is_known, low, before.low),
        memory,
        jnp.where(is_known, 1.0, before.seen),
    )
    return kept, 1 / (1 + memory), jnp.log(memory + 1e-12)
