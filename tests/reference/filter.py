"""Fifteen-state error-state Kalman filter for a foot-mounted IMU: textbook loops, dense matrices, float64.

Navigation frame: east, north, up, so the gravity vector is (0, 0, -g). ``C`` takes body to navigation.
Error order: [phi, b_g, p, v, b_a], with truth = estimate (+) error: C = exp([phi x]) C_hat and everything
else additive. Measured = true + bias.

Timing: ``dt[k]`` is the interval that ends at sample k; row k of the result is the state after sample k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PHI = slice(0, 3)
BG = slice(3, 6)
POS = slice(6, 9)
VEL = slice(9, 12)
BA = slice(12, 15)


@dataclass(frozen=True, eq=False)
class Settings:
    """Noise, initial spread and method of the filter (SI units, continuous-time densities)."""

    gravity: float = 9.81  # m/s^2
    accelerometer: float = 0.035  # m/s^2/sqrt(Hz)
    gyroscope: float = 6.2e-4  # rad/s/sqrt(Hz)
    accelerometer_bias: float = 1e-4  # m/s^3/sqrt(Hz)
    gyroscope_bias: float = 1e-5  # rad/s^2/sqrt(Hz)
    accelerometer_bias_time: float = np.inf  # s, correlation time; inf is a random walk
    gyroscope_bias_time: float = np.inf  # s
    sigma_zupt: float | Array = 0.01  # m/s, one number or one per sample
    sigma_zaru: float | Array = 0.01  # rad/s, one number or one per sample
    initial_attitude_std: float = np.deg2rad(0.5)  # rad, about the two horizontal navigation axes
    initial_heading_std: float = np.deg2rad(0.1)  # rad, about the vertical axis
    initial_gyroscope_bias_std: float = np.deg2rad(0.3)  # rad/s
    initial_position_std: float = 1e-5  # m
    initial_velocity_std: float = 1e-5  # m/s
    initial_accelerometer_bias_std: float = 0.1  # m/s^2
    initial_C: Array = field(default_factory=lambda: np.eye(3))  # body to navigation
    initial_position: Array = field(default_factory=lambda: np.zeros(3))  # m
    initial_velocity: Array = field(default_factory=lambda: np.zeros(3))  # m/s
    initial_gyroscope_bias: Array = field(default_factory=lambda: np.zeros(3))  # rad/s
    initial_accelerometer_bias: Array = field(default_factory=lambda: np.zeros(3))  # m/s^2
    attitude_method: str = "exponential"  # or "pade", "first_order"


def skew(x: Array) -> Array:
    """Matrix [x x] with [x x] y = x cross y."""
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def rotation(phi: Array) -> Array:
    """exp([phi x]) by Rodrigues' formula; ``phi`` is a rotation vector in rad."""
    angle = float(np.linalg.norm(phi))
    sin_over_angle = np.sinc(angle / np.pi)  # numpy's sinc(x) is sin(pi x)/(pi x), 1 at 0
    half = np.sinc(0.5 * angle / np.pi)
    one_minus_cos_over_square = 0.5 * half * half
    s = skew(phi)
    return np.eye(3) + sin_over_angle * s + one_minus_cos_over_square * (s @ s)


def levelled_attitude(mean_force: Array, heading: float) -> Array:
    """C = Rz(heading) Ry(pitch) Rx(roll) from the mean specific force at rest [m/s^2]; heading in rad."""
    fx, fy, fz = np.asarray(mean_force, dtype=float)
    roll = np.arctan2(fy, fz)
    pitch = np.arctan2(-fx, np.hypot(fy, fz))
    return euler_attitude(roll, pitch, heading)


def euler_attitude(roll: float, pitch: float, heading: float) -> Array:
    """C = Rz(heading) Ry(pitch) Rx(roll), body to navigation; angles in rad."""
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    ch, sh = np.cos(heading), np.sin(heading)
    rx = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    ry = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    rz = np.array([[ch, -sh, 0.0], [sh, ch, 0.0], [0.0, 0.0, 1.0]])
    return rz @ ry @ rx


def next_attitude(C: Array, angular_rate: Array, dt: float, method: str) -> Array:
    """Attitude after ``dt`` [s] at the body rate ``angular_rate`` [rad/s]."""
    omega_dt = skew(angular_rate * dt)
    identity = np.eye(3)
    if method == "exponential":
        return C @ rotation(angular_rate * dt)
    if method == "pade":
        return C @ (2.0 * identity + omega_dt) @ np.linalg.inv(2.0 * identity - omega_dt)
    if method == "first_order":
        rough = C @ (identity + omega_dt)
        return rough - 0.5 * (rough @ rough.T - identity) @ rough
    raise ValueError(f"unknown attitude method {method!r}")


def decay(dt: float, time: float) -> float:
    """First-order Markov factor exp(-dt/time), 1 for an infinite time; both in s."""
    return float(np.exp(-dt / time))


def transition(
    C_mean: Array,
    force_nav: Array,
    dt: float,
    accelerometer_bias_time: float = np.inf,
    gyroscope_bias_time: float = np.inf,
) -> Array:
    """Dense error transition (15, 15): mean attitude of the step, specific force in navigation [m/s^2]."""
    F = np.eye(15)
    F[PHI, BG] = -dt * C_mean
    F[POS, VEL] = dt * np.eye(3)
    F[VEL, PHI] = -dt * skew(force_nav)
    F[VEL, BA] = -dt * C_mean
    F[BG, BG] = decay(dt, gyroscope_bias_time) * np.eye(3)
    F[BA, BA] = decay(dt, accelerometer_bias_time) * np.eye(3)
    return F


def process_noise(dt: float, settings: Settings) -> Array:
    """Dense process noise (15, 15) of one step of ``dt`` [s]: density squared times dt, none on position."""
    Q = np.zeros((15, 15))
    Q[PHI, PHI] = settings.gyroscope**2 * dt * np.eye(3)
    Q[BG, BG] = settings.gyroscope_bias**2 * dt * np.eye(3)
    Q[VEL, VEL] = settings.accelerometer**2 * dt * np.eye(3)
    Q[BA, BA] = settings.accelerometer_bias**2 * dt * np.eye(3)
    return Q


def initial_covariance(settings: Settings) -> Array:
    """Diagonal starting covariance (15, 15)."""
    std = np.zeros(15)
    std[PHI] = [settings.initial_attitude_std, settings.initial_attitude_std, settings.initial_heading_std]
    std[BG] = settings.initial_gyroscope_bias_std
    std[POS] = settings.initial_position_std
    std[VEL] = settings.initial_velocity_std
    std[BA] = settings.initial_accelerometer_bias_std
    return np.diag(std**2)


def weighted_update(P: Array, H: Array, R: Array, z: Array, weight: float) -> tuple[Array, Array]:
    """Error estimate (15,) and covariance after z = H x + noise of information ``weight`` R^-1."""
    S = weight * H @ P @ H.T + R
    K = weight * P @ H.T @ np.linalg.inv(S)
    P_new = P - K @ H @ P
    return K @ z, 0.5 * (P_new + P_new.T)


def run(
    dt: Array,
    specific_force: Array,
    angular_rate: Array,
    weight_zupt: Array,
    weight_zaru: Array,
    settings: Settings,
) -> dict[str, Array]:
    """Filter T samples: dt (T,) s, specific force (T, 3) m/s^2, angular rate (T, 3) rad/s, weights in [0, 1].

    Returns p [m], v [m/s], b_g [rad/s], b_a [m/s^2], each (T, 3), C (T, 3, 3), P_diag (T, 15) and the last
    covariance P (15, 15). Order within a sample: propagate, zero velocity, then zero angular rate.
    """
    count = len(dt)
    g_n = np.array([0.0, 0.0, -settings.gravity])
    sigma_zupt = np.broadcast_to(np.asarray(settings.sigma_zupt, dtype=float), (count,))
    sigma_zaru = np.broadcast_to(np.asarray(settings.sigma_zaru, dtype=float), (count,))
    H_zupt = np.zeros((3, 15))
    H_zupt[:, VEL] = np.eye(3)
    H_zaru = np.zeros((3, 15))
    H_zaru[:, BG] = np.eye(3)

    C = np.array(settings.initial_C, dtype=float)
    p = np.array(settings.initial_position, dtype=float)
    v = np.array(settings.initial_velocity, dtype=float)
    b_g = np.array(settings.initial_gyroscope_bias, dtype=float)
    b_a = np.array(settings.initial_accelerometer_bias, dtype=float)
    P = initial_covariance(settings)

    out = {
        "p": np.zeros((count, 3)),
        "v": np.zeros((count, 3)),
        "C": np.zeros((count, 3, 3)),
        "b_g": np.zeros((count, 3)),
        "b_a": np.zeros((count, 3)),
        "P_diag": np.zeros((count, 15)),
    }
    for k in range(count):
        step = float(dt[k])

        # Strapdown integration, with the biases of the previous sample.
        f = specific_force[k] - b_a
        w = angular_rate[k] - b_g
        C_old = C
        C = next_attitude(C_old, w, step, settings.attitude_method)
        C_mean = 0.5 * (C_old + C)
        f_n = C_mean @ f
        a = f_n + g_n
        p = p + v * step + 0.5 * a * step**2
        v = v + a * step
        b_g = b_g * decay(step, settings.gyroscope_bias_time)
        b_a = b_a * decay(step, settings.accelerometer_bias_time)

        # Covariance.
        F = transition(C_mean, f_n, step, settings.accelerometer_bias_time, settings.gyroscope_bias_time)
        P = F @ P @ F.T + process_noise(step, settings)
        P = 0.5 * (P + P.T)

        # Zero velocity: measured 0, predicted v.
        if weight_zupt[k] != 0.0:
            R = sigma_zupt[k] ** 2 * np.eye(3)
            dx, P = weighted_update(P, H_zupt, R, -v, float(weight_zupt[k]))
            C, b_g, p, v, b_a = apply_error(dx, C, b_g, p, v, b_a)

        # Zero angular rate: the gyroscope reads its bias.
        if weight_zaru[k] != 0.0:
            R = sigma_zaru[k] ** 2 * np.eye(3)
            dx, P = weighted_update(P, H_zaru, R, angular_rate[k] - b_g, float(weight_zaru[k]))
            C, b_g, p, v, b_a = apply_error(dx, C, b_g, p, v, b_a)

        out["p"][k] = p
        out["v"][k] = v
        out["C"][k] = C
        out["b_g"][k] = b_g
        out["b_a"][k] = b_a
        out["P_diag"][k] = np.diag(P)
    out["P"] = P
    return out


def apply_error(
    dx: Array, C: Array, b_g: Array, p: Array, v: Array, b_a: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Truth = estimate (+) dx, in the error order: returns the corrected C, b_g, p, v, b_a."""
    return rotation(dx[PHI]) @ C, b_g + dx[BG], p + dx[POS], v + dx[VEL], b_a + dx[BA]


def observability_rank(F_list: Sequence[Array], H_list: Sequence[Array], tolerance: float = 1e-9) -> int:
    """Rank of the stack H_0, H_1 F_0, H_2 F_1 F_0, ...: how many directions of the first error are seen.

    Rows and columns are scaled to unit length first, which leaves the rank alone and makes ``tolerance``
    (smallest counted singular value over the largest) free of units. A last F beyond the last H is unused.
    """
    n = H_list[0].shape[1]
    product = np.eye(n)
    blocks = []
    for k, H in enumerate(H_list):
        blocks.append(H @ product)
        if k + 1 < len(H_list):
            product = F_list[k] @ product
    stack = np.vstack(blocks)
    for axis in (0, 1):
        length = np.linalg.norm(stack, axis=axis, keepdims=True)
        stack = stack / np.where(length > 0.0, length, 1.0)
    singular = np.linalg.svd(stack, compute_uv=False)
    return int(np.sum(singular > tolerance * singular[0]))
