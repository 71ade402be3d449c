"""The clock of stances: when one begins and ends, and the moment in each at which something is done once."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


class StanceClock(NamedTuple):
    """`seconds` of this stance so far, for how long the foot has been `moving`, whether this stance has been
    `used`, and the `time` since the start; `(*L)` each."""

    seconds: Array
    moving: Array
    used: Array
    time: Array


class Tick(NamedTuple):
    """What a sample is to the stances, `(*L)` each: whether the one before is `over` (bool), and whether this
    is the moment to act in it, `now` (0 or 1)."""

    over: Array
    now: Array


def started(like: Array) -> StanceClock:
    """Nothing seen yet; `like (*L)` is zeros."""
    return StanceClock(like, like, like, like)


def tick(
    clock: StanceClock, still: Array, dt: Array, dwell_s: ArrayLike, gap_s: ArrayLike, always: bool = False
) -> tuple[StanceClock, Tick]:
    """Causal, over a sample of `dt` s with a weight of stance `still (*L)` in [0, 1].

    A stance is over when the foot has moved for `gap_s`; it is time to act once in each, when the foot has
    stood for `dwell_s`; or, with `always`, at every still sample. With dt = 0 nothing is done.
    """
    moving = jnp.where(still > 0.5, 0.0, clock.moving + dt)
    half = 0.5 * dt  # borders between samples, not on them: the same moments in any precision
    ended = moving > gap_s + half
    seconds = jnp.where(ended, 0.0, clock.seconds) + still * dt
    used = jnp.where(ended | always, 0.0, clock.used)
    enough = (still > 0.5) if always else (seconds + half >= dwell_s)
    now = jnp.where(enough & (used < 0.5) & (dt > 0), 1.0, 0.0)
    return StanceClock(seconds, moving, jnp.maximum(used, now), clock.time + dt), Tick(ended, now)
