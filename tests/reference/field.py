"""Quasi-static field detectors, looks of a foot and a magnetic filter as naive loops, dense, float64.

A look is one field ``field[k]`` (3,) in uT in navigation axes (east, north, up), the yaw ``yaw[k]`` in rad of
the inertial attitude and the time ``time[k]`` in s. Every statistic is trailing: entry k belongs to the looks
k-N .. k, N changes, and is +inf for k < N. Low statistic means quasi-static.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.reference import filter as dense

Array = NDArray[np.float64]


def wrapped(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    while angle <= -np.pi:
        angle += 2 * np.pi
    while angle > np.pi:
        angle -= 2 * np.pi
    return angle


def strength(b: Array) -> float:
    return float(np.linalg.norm(b))


def azimuth(b: Array) -> float:
    """Counter-clockwise from east."""
    return float(np.arctan2(b[1], b[0]))


def inclination(b: Array) -> float:
    """Positive where the field points down."""
    return float(np.arctan2(-b[2], np.hypot(b[0], b[1])))


def summed(y: list[float], form: str) -> float:
    """(sum y)^2 / N, an unknown constant; or sum y^2 / N, the energy."""
    total = 0.0
    if form == "mean":
        for x in y:
            total += x
        return total**2 / len(y)
    for x in y:
        total += x**2
    return total / len(y)


def trailing(
    field: Array, yaw: Array, time: Array, N: int, one: Callable[[Array, Array, Array], float]
) -> Array:
    """``one(field, yaw, time)`` of every window of N + 1 looks."""
    out = np.full(len(field), np.inf)
    for k in range(N, len(field)):
        out[k] = one(field[k - N : k + 1], yaw[k - N : k + 1], time[k - N : k + 1])
    return out


def changes(level: list[float], time: Array, per: str, angle: bool, absolute: bool) -> list[float]:
    """From each look to the next, per step or per second."""
    found = []
    for k in range(1, len(level)):
        y = level[k] - level[k - 1]
        if angle:
            y = wrapped(y)
        if per == "second":
            y /= time[k] - time[k - 1]
        found.append(abs(y) if absolute else y)
    return found


def qsf(field: Array, yaw: Array, time: Array, N: int, sigma: float, form: str, per: str) -> Array:
    """Change of the field's strength; ``form`` mean is QSF, energy is QMD."""

    def one(b: Array, _: Array, t: Array) -> float:
        y = changes([strength(x) for x in b], t, per, False, False)
        return summed(y, form) / sigma**2

    return trailing(field, yaw, time, N, one)


def magyq(
    field: Array, yaw: Array, time: Array, N: int, variance: float, outlier: float
) -> tuple[Array, Array]:
    """Variance of the strength over its limit, and the square of the last one's distance from the mean over
    its limit; quasi-static where both are below one."""
    spread, away = np.full(len(field), np.inf), np.full(len(field), np.inf)
    for k in range(N, len(field)):
        sizes = [strength(b) for b in field[k - N : k + 1]]
        spread[k] = np.var(sizes) / variance
        away[k] = (sizes[-1] - np.mean(sizes)) ** 2 / outlier**2
    return spread, away


def iqsf(
    field: Array,
    yaw: Array,
    time: Array,
    N: int,
    sigma_heading: float,
    sigma_strength: float,
    absolute: bool,
    per: str,
) -> Array:
    """Changes of strength, of the gyroscope's heading and of the magnetic heading."""

    def one(b: Array, psi: Array, t: Array) -> float:
        magnetic = [p - azimuth(x) for p, x in zip(psi, b, strict=True)]
        y = changes([strength(x) for x in b], t, per, False, absolute)
        total = summed(y, "mean") / sigma_strength**2
        for angles in (list(psi), magnetic):
            total += summed(changes(angles, t, per, True, absolute), "mean") / sigma_heading**2
        return total

    return trailing(field, yaw, time, N, one)


def ma(
    field: Array,
    yaw: Array,
    time: Array,
    N: int,
    sigmas: tuple[float, float, float],
    theta: str,
    absolute: bool,
    form: str,
    per: str,
    north: float,
) -> Array:
    """Ma 2018: heading difference, inclination (rad) and strength (uT), with their sigmas."""

    def one(b: Array, psi: Array, t: Array) -> float:
        difference = [(p - azimuth(x)) - p for p, x in zip(psi, b, strict=True)]
        if theta == "rate":
            y_heading = changes(difference, t, per, True, absolute)
        else:
            y_heading = [wrapped(north + d) for d in difference[1:]]
            if absolute:
                y_heading = [abs(y) for y in y_heading]
        y_inclination = changes([inclination(x) for x in b], t, per, False, absolute)
        y_strength = changes([strength(x) for x in b], t, per, False, absolute)
        total = 0.0
        for y, sigma in zip((y_heading, y_inclination, y_strength), sigmas, strict=True):
            total += summed(y, form) / sigma**2
        return total

    return trailing(field, yaw, time, N, one)


def aiez(
    field: Array,
    yaw: Array,
    time: Array,
    variance: Array,
    N: int,
    sigmas: tuple[float, float],
    yaw_variance: bool,
    form: str,
    per: str,
    north: float,
) -> Array:
    """Zhang: the difference of magnetic and inertial heading itself, of the N last looks, each over its own
    sigma and, with ``yaw_variance``, that of the yaw; and the change of strength."""
    out = np.full(len(field), np.inf)
    for k in range(N, len(field)):
        y_heading = []
        for i in range(k - N + 1, k + 1):
            known = sigmas[0] ** 2
            if yaw_variance:
                known += variance[i]
            y_heading.append(wrapped(north - azimuth(field[i])) / np.sqrt(known))
        sizes = [strength(b) for b in field[k - N : k + 1]]
        y_strength = changes(sizes, time[k - N : k + 1], per, False, False)
        out[k] = summed(y_heading, form) + summed(y_strength, form) / sigmas[1] ** 2
    return out


def change_covariance(b: Array, sigma: float, tilt: float, yaw: float) -> Array:
    """Of the difference of two looks at the field ``b`` uT: noise of both, and the turn between them."""
    cross = dense.skew(b)
    return 2 * sigma**2 * np.eye(3) + cross @ np.diag([tilt**2, tilt**2, yaw**2]) @ cross.T


def vector(
    field: Array, yaw: Array, time: Array, N: int, sigma: float, tilt: float, turn: float
) -> tuple[Array, Array]:
    """The largest normalised square of a change in the window, and the variance that no direction exceeds."""
    largest = np.full(len(field), np.nan)
    for k in range(N, len(field)):
        b = field[k - N : k + 1].mean(axis=0)
        largest[k] = 2 * sigma**2 + b @ b * max(tilt, turn) ** 2

    def one(b: Array, _: Array, __: Array) -> float:
        inverse = np.linalg.inv(change_covariance(b.mean(axis=0), sigma, tilt, turn))
        worst = 0.0
        for k in range(1, len(b)):
            difference = b[k] - b[k - 1]
            worst = max(worst, float(difference @ inverse @ difference))
        return worst

    return trailing(field, yaw, time, N, one), largest


def upright(up: Array) -> Array:
    """The least rotation that turns ``up`` to z."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = np.linalg.norm(axis)
    return dense.rotation(axis / sine * np.arctan2(sine, up[2])) if sine > 0 else np.eye(3)


def levelled(C: Array, force: Array, mag: Array, offset: Array, soft: Array, how: str) -> Array:
    """The field in navigation axes, turned upright, with the levelled calibration soft (m - offset) between
    two rotations: to the level body with x ahead, and about up to navigation axes."""
    up = force if how == "force" else C[2]
    ahead = dense.levelled_attitude(up, 0.0)
    flat = ahead @ mag
    flat = np.append(soft @ (flat[:2] - offset), flat[2])
    return upright(C @ up) @ C @ ahead.T @ flat


def twist(C: Array) -> float:
    """The turn about up in a rotation: of its quaternion, what is left of x and y."""
    return float(np.arctan2(C[1, 0] - C[0, 1], C[0, 0] + C[1, 1]))


@dataclass(frozen=True, eq=False)
class MagneticSettings:
    """What is made of the field (uT, rad, s)."""

    update: str = "heading"  # or "anchored", "differential", "none"
    row: str = "full"  # or "simple"
    levelling: str = "force"  # or "attitude"
    per: str = "step"  # or "sample"
    settle: float = 0.06
    dwell: float = 0.06
    gap: float = 0.15
    steps: int = 3
    threshold: float = 170.0
    width: float = 0.0
    sigmas: tuple[float, float, float] = (0.067, 0.054, 0.535)
    north: float = np.pi / 2
    floor: float = np.deg2rad(2.0)
    sigma_field: float = 0.3
    tilt: float = np.deg2rad(0.5)
    oddity: float = 0.0
    tail: float = np.inf
    reference: tuple[float, float] = (48.0, 1.1)  # strength, inclination: of the start, if running
    running: bool = True
    gyroscope_rows: bool = False
    offset: Array = dataclasses.field(default_factory=lambda: np.zeros(2))
    soft: Array = dataclasses.field(default_factory=lambda: np.eye(2))


class Seen(NamedTuple):
    field: Array
    yaw: float
    time: float
    variance: float  # of the yaw


class Foot:
    """When a foot looks at the field: once in each stance, after some stillness, or at every still sample."""

    def __init__(self, settings: MagneticSettings, first: Array):
        self.settings, self.first = settings, first
        self.total, self.seconds, self.stood = np.zeros(3), 0.0, 0.0
        self.moving, self.used, self.time = 0.0, False, 0.0
        self.looks: list[Seen] = []
        self.together = 0  # looks that may be judged together

    def see(self, C: Array, force: Array, mag: Array, dt: float, still: float, variance: float = 0.0) -> bool:
        """One sample, with the variance of the yaw then; whether it looked just now."""
        s = self.settings
        here = levelled(C, force, mag, s.offset, s.soft, s.levelling)
        self.time += dt
        self.moving = 0.0 if still > 0.5 else self.moving + dt
        if self.moving > s.gap + dt / 2:
            self.stood = 0.0
            if s.per == "sample":  # a window of samples lies within one stance
                self.together = 0
        if s.per == "sample" or self.moving > s.gap + dt / 2:
            self.total, self.seconds, self.used = np.zeros(3), 0.0, False
        self.stood += still * dt
        settled = self.stood + dt / 2 >= s.settle
        if settled:
            self.total = self.total + still * dt * here
            self.seconds += still * dt
        if s.per == "sample":
            looks = settled and still > 0.5 and dt > 0
        else:
            looks = self.stood + dt / 2 >= s.settle + s.dwell and not self.used and dt > 0
        if looks:
            place = self.total / self.seconds
            self.looks.append(Seen(place, twist(C @ self.first.T), self.time, variance))
            self.used = True
            self.together += 1
        return looks

    def turn(self, t: Array) -> None:
        """What was seen, with an attitude that the rotation vector ``t`` corrected."""
        yaw = float(t[2])
        R = dense.rotation(np.array([0.0, 0.0, yaw]) if self.settings.levelling == "force" else t)
        self.looks = [Seen(R @ x.field, x.yaw + yaw, x.time, x.variance) for x in self.looks]
        self.total = R @ self.total


def run_magnetic(
    dt: Array,
    specific_force: Array,
    angular_rate: Array,
    magnetic_field: Array,
    weight_zupt: Array,
    settings: dense.Settings,
    magnetic: MagneticSettings,
) -> dict[str, Array]:
    """The filter of ``filter.run`` with what the field adds, which is decided here: ``magnetic_field`` (T, 3)
    uT in body axes. Order within a sample: propagate, zero velocity, look, field update, gyroscope rows.

    Returns also ``look`` (T,) and ``weight`` (T,) of the field update.
    """
    count = len(dt)
    g_n = np.array([0.0, 0.0, -settings.gravity])
    H_zupt = np.zeros((3, 15))
    H_zupt[:, dense.VEL] = np.eye(3)
    x = (
        np.array(settings.initial_C, dtype=float),
        np.array(settings.initial_gyroscope_bias, dtype=float),
        np.array(settings.initial_position, dtype=float),
        np.array(settings.initial_velocity, dtype=float),
        np.array(settings.initial_accelerometer_bias, dtype=float),
    )
    P = dense.initial_covariance(settings)
    foot = Foot(magnetic, x[0])
    strength_0, inclination_0 = magnetic.reference
    quasi, anchor, before = 0.0, np.zeros(3), magnetic_field[0]
    shapes = {"p": (3,), "v": (3,), "C": (3, 3), "b_g": (3,), "b_a": (3,), "P_diag": (15,)}
    out = {name: np.zeros((count, *shape)) for name, shape in shapes.items()}
    out |= {"look": np.zeros(count), "weight": np.zeros(count)}
    for k in range(count):
        step = float(dt[k])
        C, b_g, p, v, b_a = x
        f, w = specific_force[k] - b_a, angular_rate[k] - b_g
        C_old, C = C, dense.next_attitude(C, w, step, settings.attitude_method)
        C_mean = 0.5 * (C_old + C)
        f_n = C_mean @ f
        p = p + v * step + 0.5 * (f_n + g_n) * step**2
        v = v + (f_n + g_n) * step
        b_g = b_g * dense.decay(step, settings.gyroscope_bias_time)
        b_a = b_a * dense.decay(step, settings.accelerometer_bias_time)
        F = dense.transition(
            C_mean, f_n, step, settings.accelerometer_bias_time, settings.gyroscope_bias_time
        )
        P = F @ P @ F.T + dense.process_noise(step, settings)
        P = 0.5 * (P + P.T)
        x = (C, b_g, p, v, b_a)
        if weight_zupt[k] != 0.0:
            R = np.asarray(settings.sigma_zupt) ** 2 * np.eye(3)
            dx, P = dense.weighted_update(P, H_zupt, R, -v, float(weight_zupt[k]))
            x = dense.apply_error(dx, *x)

        still, unsure = float(weight_zupt[k]), float(P[2, 2])
        looked = foot.see(x[0], specific_force[k], magnetic_field[k], step, still, unsure)
        if looked:
            seen = foot.looks[-1]
            now, far = gated(foot, magnetic), 0.0
            if now > 0.5 and quasi <= 0.5:
                anchor = foot.looks[-1 - magnetic.steps].field
            quasi = now
            H, R, z = rows_of(foot, magnetic, anchor, (strength_0, inclination_0))
            far = float(z @ np.linalg.inv(H @ P @ H.T + R) @ z)
            weight = quasi
            if np.isfinite(magnetic.tail):
                weight = min(quasi * (magnetic.tail + len(z)) / (magnetic.tail + far), 1.0)
            if magnetic.update == "none":
                weight = 0.0
            if weight != 0.0:
                dx, P = dense.weighted_update(P, H, R, z, weight)
                x = dense.apply_error(dx, *x)
                foot.turn(dx[dense.PHI])
            out["look"][k], out["weight"][k] = 1.0, weight
            if magnetic.running:
                share = 1.0 / min(len(foot.looks) + 1.0, 50.0)
                strength_0 += share * (strength(seen.field) - strength_0)
                inclination_0 += share * (inclination(seen.field) - inclination_0)
        if magnetic.gyroscope_rows and weight_zupt[k] * quasi > 0 and step > 0:
            m = 0.5 * (before + magnetic_field[k])
            cross = dense.skew(m)
            z = (magnetic_field[k] - before) / step + np.cross(angular_rate[k] - x[1], m)
            sigma_rate = settings.gyroscope / np.sqrt(step)
            R = 2 * (magnetic.sigma_field / step) ** 2 * np.eye(3) + sigma_rate**2 * cross @ cross.T
            H = np.zeros((3, 15))
            H[:, dense.BG] = -cross
            dx, P = dense.weighted_update(P, H, R, z, float(weight_zupt[k]) * quasi)
            x = dense.apply_error(dx, *x)
            foot.turn(dx[dense.PHI])
        before = magnetic_field[k]
        out["C"][k], out["b_g"][k], out["p"][k], out["v"][k], out["b_a"][k] = x
        out["P_diag"][k] = np.diag(P)
    return out


def gated(foot: Foot, s: MagneticSettings) -> float:
    """How far the last looks are quasi-static to Ma's detector, 0 to 1."""
    if foot.together <= s.steps:
        return 0.0
    last = foot.looks[-1 - s.steps :]
    field, yaw, time = (np.array([getattr(x, name) for x in last]) for name in ("field", "yaw", "time"))
    found = ma(field, yaw, time, s.steps, s.sigmas, "rate", True, "mean", "step", s.north)[-1]
    if s.width == 0.0:
        return float(found < s.threshold)
    return float(1 / (1 + (found / s.threshold) ** (1 / s.width)))


def rows_of(
    foot: Foot, s: MagneticSettings, anchor: Array, reference: tuple[float, float]
) -> tuple[Array, Array, Array]:
    """H (m, 15), noise (m, m) and innovation (m,) of the last look."""
    b = foot.looks[-1].field
    if s.update in ("heading", "none"):
        level, H = np.hypot(b[0], b[1]), np.zeros((1, 15))
        if s.row == "simple" or s.levelling == "force":
            H[0, 2] = 1.0
        else:
            H[0, dense.PHI] = [-b[2] * b[0] / level**2, -b[2] * b[1] / level**2, 1.0]
        odd = (strength(b) / reference[0] - 1) ** 2 + (inclination(b) - reference[1]) ** 2
        variance = s.floor**2 + (s.sigma_field / level) ** 2 + (np.tan(inclination(b)) * s.tilt) ** 2
        variance += s.oddity**2 * odd
        return H, np.array([[variance]]), np.array([wrapped(s.north - azimuth(b))])
    against = anchor if s.update == "anchored" or len(foot.looks) < 2 else foot.looks[-2].field
    H = np.zeros((3, 15))
    H[:, dense.PHI] = -dense.skew(b)
    return H, 2 * s.sigma_field**2 * np.eye(3), against - b
