"""What an ideal sensor carried by the walker would measure: exact derivatives of its path."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax.runtime import double_precision
from pedjax.simulation import gait
from pedjax.simulation.gait import Walker

GRAVITY = 9.8029

MOUNTINGS: dict[str, tuple[float, float, float]] = {
    "foot": gait.INSTEP,
    "left_foot": gait.INSTEP,
    "waist": (-0.12, 0.0, 0.05),
    "pocket": (0.08, -0.05, -0.18),
}
"""Where a sensor is, and its lever in m from the ball of the foot (`foot` is the right one), the middle of
the waist, or the hip joint."""


class Motion(NamedTuple):
    """At `time (T,)` s: `position`, `velocity (T, 3)` in m and m/s, `attitude (T, 3, 3)` body to navigation,
    specific force and angular rate `(T, 3)` in m/s^2 and rad/s in body axes."""

    time: Any
    position: Any
    velocity: Any
    attitude: Any
    specific_force: Any
    angular_rate: Any


def _pose(t: Array, walker: Walker, mounting: str, lever: Array) -> tuple[Array, Array]:
    if mounting == "waist":
        return gait.waist(t, walker, lever)
    if mounting == "pocket":
        return gait.thigh(t, walker, lever)
    swings = walker.left if mounting == "left_foot" else walker.right
    return gait.foot(t, swings, walker.sway, walker.lifts, lever)


def _derivative(f: Any, t: Array) -> tuple[Any, Any]:
    """Value and slope of a function of time."""
    return jax.jvp(f, (t,), (jnp.ones_like(t),))


def at(t: Array, walker: Walker, mounting: str, lever: Array, gravity: Array) -> Motion:
    """Everything at one time, by automatic differentiation."""

    def position(t: Array) -> Array:
        return _pose(t, walker, mounting, lever)[0]

    def velocity(t: Array) -> tuple[Array, Array]:
        place, speed = _derivative(position, t)
        return speed, place

    (speed, place), (acceleration, _) = _derivative(velocity, t)
    c, turning = _derivative(lambda t: _pose(t, walker, mounting, lever)[1], t)
    force = c.T @ (acceleration + gravity * jnp.array([0.0, 0.0, 1.0]))
    spin = c.T @ turning
    return Motion(t, place, speed, c, force, jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]]))


@partial(jax.jit, static_argnames="mounting")
def _over_time(time: Array, walker: Walker, mounting: str, lever: Array, gravity: Array) -> Motion:
    return jax.vmap(lambda t: at(t, walker, mounting, lever, gravity))(time)


_BLOCK = 8192


def motion(walker: Walker, time: np.ndarray, mounting: str = "foot", gravity: float = GRAVITY) -> Motion:
    """The motion at all times, in double precision, a block at a time (so that one program serves all)."""
    with double_precision():
        walker = jax.tree.map(jnp.asarray, walker)
        lever, g = jnp.asarray(MOUNTINGS[mounting]), jnp.asarray(gravity, float)
        parts = []
        for first in range(0, len(time), _BLOCK):
            here = time[first : first + _BLOCK]
            padded = np.concatenate([here, np.full(_BLOCK - len(here), here[-1])])
            found = _over_time(jnp.asarray(padded, float), walker, mounting, lever, g)
            parts.append(jax.tree.map(partial(_first, len(here)), found))
        return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def _first(count: int, x: Array) -> np.ndarray:
    return np.asarray(x)[:count]


def standing(walker: Walker, time: np.ndarray, mounting: str = "foot") -> np.ndarray:
    """Whether the sole is flat on the ground, `(T,)`, of the foot that carries the sensor (for the waist and
    the pocket: of either foot)."""
    flat = [_flat(side, time) for side in (walker.left, walker.right)]
    if mounting == "left_foot":
        return flat[0]
    return flat[1] if mounting == "foot" else flat[0] | flat[1]


def _flat(swings: Any, time: np.ndarray) -> np.ndarray:
    border, leaves = np.asarray(swings.border), np.asarray(swings.leaves)
    index = np.clip(np.searchsorted(border, time, side="right") - 1, 0, len(leaves) - 1)
    up = leaves[index] - np.asarray(swings.push)[index]
    down = np.asarray(swings.lands)[index] + np.asarray(swings.settle)[index]
    return (time <= up) | (time >= down)
