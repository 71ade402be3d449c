"""Nine-state Kalman filter for field, hard iron and gyroscope bias: dense matrices, plain loops, float64.

State [m, b, g]: m the field in body axes, reading = m + b, rate = true rate + g. ``dt[k]`` is the interval
that ends at sample k; row k of the result is the state after sample k. Also a board that turns, to run it on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.reference.filter import rotation, skew

Array = NDArray[np.float64]

FIELD = np.array([2.0, 15.0, -41.0])
"""µT, fixed in the room."""


class Settings(NamedTuple):
    """As the parameters of the filter under test."""

    noise: float = 0.085
    still: float = 0.1
    turning: float = 0.3
    offset: float = 0.02
    bias: float = 1e-5
    lag: float = 0.0
    window: float = 0.1
    threshold: float = 30.0
    jump: float = 50.0
    initial_field: float = 50.0
    initial_offset: float = 0.7
    initial_bias: float = 0.005


def run(rate: Array, reading: Array, dt: Array, s: Settings) -> tuple[Array, Array, Array]:
    """Offset (T, 3), its standard deviations (T, 3), and whether the gate was open (T,), with a hard gate."""
    one = np.eye(3)
    time = np.cumsum(dt)
    late = np.stack([np.interp(time - s.lag, time, rate[:, i]) for i in range(3)], axis=1)
    x = np.concatenate([reading[0], np.zeros(6)])
    P = np.diag(np.repeat([s.initial_field, s.initial_offset, s.initial_bias], 3) ** 2)
    H = np.concatenate([one, one, 0 * one], axis=1)
    mean, is_open = np.zeros(3), False
    offsets, sigmas, opened = [], [], []
    for w, y, h in zip(late, reading, dt, strict=True):
        turned = w - x[6:]
        C = rotation(-h * turned)
        x[:3] = C @ x[:3]
        F = np.eye(9)
        F[:3, :3], F[:3, 6:] = C, -h * skew(x[:3])
        extra = s.jump**2 if is_open else 0.0
        q = [s.still**2 + s.turning**2 * (turned @ turned) + extra, s.offset**2 + extra, s.bias**2]
        P = F @ P @ F.T + h * np.diag(np.repeat(q, 3))
        a = h / (h + s.window)
        if np.isfinite(y).all():
            R = s.noise**2 / h * one
            S = H @ P @ H.T + R
            z = y - H @ x
            K = P @ H.T @ np.linalg.inv(S)
            x = x + K @ z
            J = np.eye(9) - K @ H
            P = J @ P @ J.T + K @ R @ K.T
            mean = (1 - a) * mean + a * np.linalg.inv(np.linalg.cholesky(S)) @ z
        is_open = mean @ mean * (2 - a) / a >= s.threshold
        offsets.append(x[3:6])
        sigmas.append(np.sqrt(np.diag(P)[3:6]))
        opened.append(float(is_open))
    return np.array(offsets), np.array(sigmas), np.array(opened)


class Board(NamedTuple):
    """`time`, `dt` (T,); `rate` rad/s and `reading` µT (T, 3), as measured."""

    time: Array
    dt: Array
    rate: Array
    reading: Array


def board(
    seconds: float,
    hz: float,
    seed: int,
    offset: Array,
    *,
    rest: float = 2.0,
    speed: float = 1.0,
    rough: float = 0.3,
    noise: float = 0.085,
    bias: float = 0.003,
    lag: int = 0,
) -> Board:
    """A board turned by hand after `rest` s at about `speed` rad/s about each axis.

    `offset` (T, 3) µT; the field in the room differs by `rough` µT along the path (a few sinusoids, not the
    model's random walk); white `noise` µT/sqrt(Hz); a gyroscope `bias` of that standard deviation in rad/s;
    the magnetometer is `lag` samples late.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds * hz)
    time = np.arange(1, count + 1) / hz
    moving = np.clip(time - rest, 0.0, 1.0)[:, None]
    frequency, phase = rng.uniform(0.1, 0.8, (2, 4, 3)), rng.uniform(0, 2 * np.pi, (2, 4, 3))
    waves = np.sin(2 * np.pi * time[:, None, None, None] * frequency + phase).sum(axis=2) / np.sqrt(2.0)
    rate = speed * moving * waves[:, 0]
    room = FIELD + rough * moving * waves[:, 1]
    attitude, field = np.eye(3), np.empty((count, 3))
    for k in range(count):
        attitude = attitude @ rotation(rate[k] / hz)
        field[k] = attitude.T @ room[k]
    field = field[np.maximum(np.arange(count) - lag, 0)]
    reading = field + offset + rng.normal(0, noise * np.sqrt(hz), (count, 3))
    return Board(time, np.full(count, 1 / hz), rate + rng.normal(0, bias, 3), reading)


def switched(count: int, hz: float, on: float, off: float, offset: Array, takes: float = 1.0) -> Array:
    """An offset `(T, 3)` put on from `on` s and taken off from `off` s on, within `takes` s each."""
    time = np.arange(1, count + 1) / hz
    return (np.clip((time - on) / takes, 0, 1) - np.clip((time - off) / takes, 0, 1))[:, None] * offset
