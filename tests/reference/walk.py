"""Synthetic walk of a foot: truth in closed form, sensors by differencing it over each sample interval."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .filter import euler_attitude

Array = NDArray[np.float64]


class Walk(NamedTuple):
    """Sensors and truth; row k holds for the end of the interval ``dt[k]``, the start is at time 0."""

    dt: Array  # (T,) s
    specific_force: Array  # (T, 3) m/s^2, body
    angular_rate: Array  # (T, 3) rad/s, body
    position: Array  # (T, 3) m, navigation; zero at time 0
    stance: NDArray[np.bool_]  # (T,) the foot is still over the whole interval
    velocity: Array  # (T, 3) m/s, navigation
    attitude: Array  # (T, 3, 3) body to navigation
    initial_attitude: Array  # (3, 3) at time 0


class Swing(NamedTuple):
    """One step of the foot, from one stance to the next."""

    start: float  # s
    duration: float  # s
    place: Array  # (3,) m, where it starts
    move: Array  # (3,) m, to the next stance
    lift: float  # m
    angles: Array  # (3,) rad, roll, pitch and heading where it starts
    turn: Array  # (3,) rad, change of the three


def minimum_jerk(x: float) -> tuple[float, float]:
    """Smooth step from 0 to 1 on [0, 1], and its derivative; constant outside."""
    x = min(max(x, 0.0), 1.0)
    return 10 * x**3 - 15 * x**4 + 6 * x**5, 30 * x**2 * (1 - x) ** 2


def bump(x: float) -> tuple[float, float]:
    """Smooth pulse of height 1 on [0, 1], and its derivative; zero outside."""
    x = min(max(x, 0.0), 1.0)
    return 64 * x**3 * (1 - x) ** 3, 192 * x**2 * (1 - x) ** 2 * (1 - 2 * x)


def walk(
    seconds: float,
    rate: float,
    seed: int,
    gravity: float = 9.81,
    standing: float = 1.0,
    stride_length: float = 1.3,
    stride_time: float = 1.1,
    stance_share: float = 0.45,
) -> Walk:
    """Walk for ``seconds`` [s] sampled at ``rate`` [Hz] after ``standing`` [s] (included) of rest.

    Strides of about 1.3 m and 1.1 s: minimum-jerk progress and a 12 cm lift in the swing, toe-down then
    toe-up foot pitch, gentle turning, a slightly different roll and pitch in every stance.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds * rate)
    step = 1.0 / rate

    swings: list[Swing] = []
    t, place = standing, np.zeros(3)
    angles = np.array([*np.deg2rad(rng.normal(0.0, 2.0, 2)), np.deg2rad(rng.uniform(-180.0, 180.0))])
    first_angles = angles
    while not swings or t < seconds:
        period = stride_time * (1.0 + 0.03 * rng.standard_normal())
        length = stride_length * (1.0 + 0.04 * rng.standard_normal())
        turn = np.deg2rad(6.0 + 8.0 * rng.standard_normal())
        roll, pitch = np.deg2rad(rng.normal(0.0, 2.0, 2))
        next_angles = np.array([roll, pitch, angles[2] + turn])
        direction = angles[2] + 0.5 * turn
        rise = 0.01 * rng.standard_normal() - place[2]
        move = np.array([length * np.cos(direction), length * np.sin(direction), rise])
        lift = 0.12 * (1.0 + 0.1 * rng.standard_normal())
        swings.append(
            Swing(t, (1.0 - stance_share) * period, place, move, lift, angles, next_angles - angles)
        )
        place, angles = place + move, next_angles
        t += period
    starts = [swing.start for swing in swings]

    def truth(time: float) -> tuple[Array, Array, Array, bool]:
        """Position, velocity, attitude and stillness at ``time`` [s]."""
        if time <= standing:
            return np.zeros(3), np.zeros(3), euler_attitude(*first_angles), True
        swing = swings[int(np.searchsorted(starts, time, side="right")) - 1]
        x = (time - swing.start) / swing.duration
        s, ds = minimum_jerk(x)
        h, dh = bump(x)
        up = np.array([0.0, 0.0, swing.lift])
        position = swing.place + s * swing.move + h * up
        velocity = (ds * swing.move + dh * up) / swing.duration
        roll, pitch, heading = swing.angles + s * swing.turn
        pitch += 1.0 * bump(x / 0.6)[0] - 0.4 * bump((x - 0.5) / 0.5)[0]
        return position, velocity, euler_attitude(roll, pitch, heading), x >= 1.0

    g_n = np.array([0.0, 0.0, -gravity])
    force, gyro = np.zeros((count, 3)), np.zeros((count, 3))
    position, velocity = np.zeros((count, 3)), np.zeros((count, 3))
    attitude, stance = np.zeros((count, 3, 3)), np.zeros(count, dtype=bool)
    _, v_old, C_old, still_old = truth(0.0)
    initial_attitude = C_old
    for k in range(count):
        now = (k + 1) * step
        p, v, C, still = truth(now)
        C_middle = truth(now - 0.5 * step)[2]
        force[k] = C_middle.T @ ((v - v_old) / step - g_n)
        gyro[k] = Rotation.from_matrix(C_old.T @ C).as_rotvec() / step
        position[k], velocity[k], attitude[k] = p, v, C
        stance[k] = still_old and still and not np.any(v - v_old)
        v_old, C_old, still_old = v, C, still
    return Walk(np.full(count, step), force, gyro, position, stance, velocity, attitude, initial_attitude)
