"""A seeded walk round a room with exact truth: a first recording for everyone.

The foot's path is smooth to the third derivative, and angular rate and specific force are its exact
derivatives. It rocks over heel and toe in stance, so that a still foot is never quite still; the seed sets
speed (a stroll to a brisk walk), route, noise and biases.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth
from pedjax.runtime import double_precision
from pedjax.simulation.gait import ramp

_GRAVITY = 9.8029
_STILL = 2.0  # s before the first and after the last step
_TREMBLE = 0.006  # rad, of the foot at all times
_LEVER = (-0.08, 0.0, 0.06)  # m, sensor seen from the toe, about which the foot rocks


class _Gait(NamedTuple):
    """Footholds `(N, 2)` m and headings `(N,)` rad of one foot, and how it goes from one to the next."""

    footholds: Array
    headings: Array
    stride_s: Array
    stance: Array
    lift: Array
    toe_off: Array
    heel_strike: Array


def _pose(t: Array, gait: _Gait) -> tuple[Array, Array]:
    """Sensor position (3,) in m and Euler angles (3,) in rad at time t."""
    cycle = (t - _STILL) / gait.stride_s
    last = gait.footholds.shape[0] - 2
    step = jnp.clip(jnp.floor(cycle), 0, last).astype(int)
    phase = jnp.clip(cycle - step, 0.0, 1.0)
    # each cycle: late stance (the heel rises into the swing), swing, early stance (the foot comes flat)
    swing, start = 1 - gait.stance, 0.5 * gait.stance

    def between(begin: Array, end: Array) -> Array:
        return ramp((phase - begin) / (end - begin))

    moved = between(start - 0.05, start + swing)
    up = between(start - 0.3 * gait.stance, start + 0.4 * swing) * gait.toe_off
    over = between(start + 0.05 * swing, start + swing) * (gait.toe_off + gait.heel_strike)
    down = between(start + 0.75 * swing, start + swing + 0.15 * gait.stance) * gait.heel_strike
    tremble = _TREMBLE * jnp.sin(2 * jnp.pi * 2.3 * t)
    pitch = up - over + down + tremble
    here, there = gait.footholds[step], gait.footholds[step + 1]
    ground = here + (there - here) * moved
    height = gait.lift * 64 * (moved * (1 - moved)) ** 3
    yaw = gait.headings[step] + (gait.headings[step + 1] - gait.headings[step]) * moved
    euler = jnp.stack([0.0 * yaw, pitch, yaw])
    sensor = rotations.from_euler(*euler) @ jnp.asarray(_LEVER)
    return jnp.concatenate([ground, height[None]]) + sensor, euler


def _signals(t: Array, gait: _Gait) -> tuple[Array, Array, Array]:
    """Position, specific force and angular rate in body axes at time t, by automatic differentiation."""

    def position(t: Array) -> Array:
        return _pose(t, gait)[0]

    def attitude(t: Array) -> Array:
        return rotations.from_euler(*_pose(t, gait)[1])

    acceleration = jax.jacfwd(jax.jacfwd(position))(t)
    c, rate = attitude(t), jax.jacfwd(attitude)(t)
    spin = c.T @ rate
    force = c.T @ (acceleration + jnp.array([0.0, 0.0, _GRAVITY]))
    return position(t), force, jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])


_signals_over_time = jax.jit(jax.vmap(_signals, in_axes=(0, None)))


def _route(rng: np.random.Generator, stride: float, laps: int) -> tuple[np.ndarray, np.ndarray]:
    """Footholds and headings round a rectangle, turning within two steps at the corners."""
    sides = np.tile(rng.integers(5, 9, size=2), 2 * laps)
    point, heading = np.zeros(2), 0.0
    points, headings = [point], [heading]
    turn = rng.choice([-1, 1]) * np.pi / 2
    for steps in sides:
        for k in range(steps):
            bend = turn / 2 if k >= steps - 2 else 0.0
            heading += bend
            length = stride * (0.6 if bend else 1.0) * rng.normal(1.0, 0.03)
            point = point + length * np.array([np.cos(heading), np.sin(heading)])
            points.append(point)
            headings.append(heading)
    return np.array(points), np.array(headings)


def demo_walk(seed: int = 0, rate: float = 200.0, laps: int = 2) -> Recording:
    """A walk of about a minute, the same for the same seed: sensor 'foot', a landmark at every fourth
    foothold, and dense truth (ENU, from the sensor's start)."""
    rng = np.random.default_rng([20, seed])
    speed = rng.uniform(0.0, 1.0)
    points, headings = _route(rng, 1.0 + 0.6 * speed, laps)
    stride_s = 1.35 - 0.45 * speed
    duration = 2 * _STILL + stride_s * (len(points) - 1)
    time = np.arange(int(duration * rate)) / rate
    with double_precision():
        gait = _Gait(
            footholds=jnp.asarray(points),
            headings=jnp.asarray(headings),
            stride_s=jnp.asarray(stride_s),
            stance=jnp.asarray(0.5 - 0.12 * speed),
            lift=jnp.asarray(0.08 + 0.06 * speed),
            toe_off=jnp.asarray(0.85 + 0.3 * speed),
            heel_strike=jnp.asarray(0.25 + 0.2 * speed),
        )
        position, force, spin = (np.asarray(x) for x in _signals_over_time(jnp.asarray(time), gait))
    n = len(time)
    force = force + rng.normal(0, 0.05, (n, 3)) + rng.normal(0, 0.04, 3)
    spin = spin + rng.normal(0, 0.004, (n, 3)) + rng.normal(0, 0.003, 3)
    marks = np.arange(0, len(points), 4)
    mark_time = np.minimum(_STILL + stride_s * marks, time[-1])
    nearest = np.round(mark_time * rate).astype(int)
    truth = position - position[0]
    return Recording(
        name=f"demo:{seed}",
        sensors={"foot": Sensor(Stream(time, force), Stream(time, spin), up="+z")},
        landmarks=Landmarks(time[nearest], truth[nearest]),
        truth=Truth(time, truth),
        format="demo",
    )
