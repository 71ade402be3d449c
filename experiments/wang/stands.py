"""Made stands: attitudes and mountings at random, sway, noise as in Table 1, biases, iron, and disturbances
that stay, pass or fade."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.wang.made import EARTH
from pedjax import parameters
from pedjax.calibration.attitude import Align, Earth, Stand

RATE = 100.0
SWAY = np.radians(0.15)  # of each of three sways
NOISE = {"force": 80e-6 * 9.81 * 10, "rate": np.radians(0.01) * 10, "field": 0.05}  # of a sample at 100 Hz
GYRO_BIAS = np.radians(0.2)
STRENGTH, DIP = EARTH["compass.strength"], EARTH["compass.inclination"]

Disturbance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""`(time (n,), direction (3, N)) -> (n, 3, N)` µT."""


def constant(size: float) -> Disturbance:
    return lambda t, way: size * np.ones((len(t), 1, 1)) * way


def passing(size: float, width: float = 0.6) -> Disturbance:
    return lambda t, way: size * np.exp(-0.5 * ((t - t[-1] / 2) / width) ** 2)[:, None, None] * way


def until(size: float, end: float) -> Disturbance:
    return lambda t, way: size * (t < end)[:, None, None] * way


def last(size: float, seconds: float) -> Disturbance:
    return lambda t, way: size * (t > t[-1] - seconds)[:, None, None] * way


class Made(NamedTuple):
    """A `stand` of N attitudes side by side, the true `attitude (N, 3, 3)` in its middle, and what was felt
    of the `disturbance (3, N)` at its end, µT."""

    stand: Stand
    attitude: np.ndarray
    earth: Earth
    disturbance: np.ndarray


def made(
    seed: int,
    count: int,
    disturbance: Disturbance | None = None,
    seconds: float = 5.0,
    force_bias: float = 0.03,
    iron: float = 0.3,
    direction: np.ndarray | None = None,
    each_axis: bool = True,
) -> Made:
    """`count` stands; `force_bias` m/s² and `iron` µT are standard deviations along each axis, or lengths in
    any direction; the direction of a disturbance is any, unless given `(3, N)`."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng([59, seed])
    n = round(seconds * RATE)
    time = np.arange(1, n + 1) / RATE
    middle = Rotation.random(count, rng=rng).as_matrix()
    hertz, phase = rng.uniform(0.5, 2.0, (3, count)), rng.uniform(0, 2 * np.pi, (3, count))
    angle = 2 * np.pi * hertz * time[:, None, None] + phase
    lean, speed = SWAY * np.sin(angle), SWAY * 2 * np.pi * hertz * np.cos(angle)
    small = Rotation.from_rotvec(lean.transpose(0, 2, 1).reshape(-1, 3)).as_matrix()
    attitude = np.einsum("nkij,kjl->nkil", small.reshape(n, count, 3, 3), middle)

    def in_body(x: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("nkji,njk->nik", attitude, np.broadcast_to(x, (n, 3, count))))

    north = np.array([0.0, STRENGTH * np.cos(DIP), -STRENGTH * np.sin(DIP)])[:, None]
    way = rng.normal(size=(3, count))
    way = way / np.linalg.norm(way, axis=0) if direction is None else direction
    felt = np.zeros((n, 3, 1)) if disturbance is None else disturbance(time, way)

    def drawn(size: float) -> np.ndarray:
        x = rng.normal(size=(3, count))
        return size * (x if each_axis else x / np.linalg.norm(x, axis=0))

    noise = {key: rng.normal(0, sigma, (n, 3, count)) for key, sigma in NOISE.items()}
    force = in_body(np.array([0.0, 0.0, 9.81])[:, None]) + drawn(force_bias)
    rate = in_body(speed) + rng.normal(0, GYRO_BIAS, (3, count))
    field = in_body(north + felt) + drawn(iron)
    stand = Stand(
        jnp.full((n, count), 1 / RATE),
        jnp.asarray(force + noise["force"]),
        jnp.asarray(rate + noise["rate"]),
        jnp.asarray(field + noise["field"]),
    )
    earth = Earth(*(jnp.full(count, x) for x in (STRENGTH, DIP, np.pi / 2)))
    return Made(stand, middle, earth, np.broadcast_to(felt[-1], (3, count)))


def random_attitudes(seed: int, count: int) -> jax.Array:
    """`(3, 3, N)`."""
    from scipy.spatial.transform import Rotation

    found = Rotation.random(count, rng=np.random.default_rng([61, seed])).as_matrix()
    return jnp.asarray(np.moveaxis(found, 0, -1))


def align(**changes: float | str) -> Align:
    """The alignment's defaults with changes, as arrays."""
    return parameters.cast(parameters.replace(Align(), changes), float)


def errors(made: Made, attitude: jax.Array) -> tuple[np.ndarray, np.ndarray]:
    """Of tilt and heading, deg `(N,)` both, heading signed, counter-clockwise."""
    found = np.moveaxis(np.asarray(attitude), -1, 0)
    up = np.einsum("kj,kj->k", found[:, 2], made.attitude[:, 2])
    turn = np.einsum("kij,klj->kil", found, made.attitude)
    heading = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    return np.degrees(np.arccos(np.clip(up, -1, 1))), np.degrees(heading)
