"""A pocket goes where its walker goes: about a steady pace its velocity stays bounded.

What is integrated is the force less gravity. A tilt makes it grow without bound, a swinging leg does not: the
pseudo-measurement v = 0, of a wide and known noise at all times, therefore levels the attitude, without a
detector, and with the noise as a density at any sampling rate alike. (The walker's own speed, which is
constant along the way, is part of that noise.) It is for the filter `bounded`."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.filters.kalman import Rows
from pedjax.lanes import eye
from pedjax.parameters import leaf, parameters


@parameters
class Bounded:
    """How near zero the velocity stays."""

    level: Array = leaf(
        1.0, unit="m/s/sqrt(Hz)", low=1e-3, high=100.0, source="kit choice", tune=True,
        meaning="Noise density of the level velocity about zero; raised, the force levels the attitude less.",
    )  # fmt: skip
    vertical: Array = leaf(
        0.3, unit="m/s/sqrt(Hz)", low=1e-3, high=100.0, source="kit choice", tune=True,
        meaning="Noise density of the vertical velocity about zero; raised, its error is taken off less.",
    )  # fmt: skip


def _step(p: Any, site: Any, state: Any, seen: Seen) -> Measured:
    v, dt = seen.estimate.velocity, seen.sample.dt
    moves = dt > 0
    step = jnp.where(moves, dt, 1.0)
    one = eye(3, v[0])
    level, vertical = (x * x / step + 0 * v[0] for x in (p.bounded.level, p.bounded.vertical))
    noise = level * one.at[2, 2].set(0.0) + vertical * one.at[:2].set(0.0)
    return Measured(state, Rows(-v, noise, {"v": None}), moves + 0 * v[0])


BOUNDED_VELOCITY = Aid(name="bounded_velocity", wants=("v",), groups=(("bounded", Bounded),), step=_step)
"""The velocity stays near zero, with a noise as wide as a pocket moves."""
