"""A standing foot's first attitude, headings beside a disturbance, noises that adapt: naive loops, float64.

One foot, one number at a time, from the formulas. C takes body to navigation axes (east, north, up); fields
in uT, angles in rad; ``north`` is the azimuth of the undisturbed level field, counter-clockwise from east.
A quaternion ``q`` is q1..q4, scalar first, of C_n^b; its axes have magnetic north along x and z up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.reference import filter as dense
from tests.reference.field import inclination, strength, wrapped

Array = NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])


class Earth(NamedTuple):
    strength: float
    inclination: float
    north: float

    def field(self) -> Array:
        level = self.strength * np.cos(self.inclination)
        down = self.strength * np.sin(self.inclination)
        return np.array([level * np.cos(self.north), level * np.sin(self.north), -down])


class Stand(NamedTuple):
    """Steps ``dt`` (n,), ``force``, ``rate`` and ``field`` (n, 3) in body axes."""

    dt: Array
    force: Array
    rate: Array
    field: Array


def unit(x: Array) -> Array:
    return x / np.linalg.norm(x)


def mean(x: Array, weights: Array) -> Array:
    total, some = np.zeros(x.shape[1:]), 0.0
    for value, w in zip(x, weights, strict=True):
        if w > 0:
            total, some = total + w * value, some + w
    return total / some


def triad(up: Array, field: Array, earth: Earth) -> Array:
    """T_n T_b^T with t1 along up, t2 along up x field, t3 = t1 x t2."""

    def axes(a: Array, b: Array) -> Array:
        t1, t2 = unit(a), unit(np.cross(a, b))
        return np.column_stack([t1, t2, np.cross(t1, t2)])

    return axes(UP, earth.field()) @ axes(up, field).T


def dip(up: Array, field: Array) -> float:
    """Below the level: the angle between up and the field, less a quarter turn."""
    return float(np.arccos(unit(up) @ unit(field)) - np.pi / 2)


def purity(stand: Stand, earth: Earth, sigma_strength: float, sigma_dip: float) -> Array:
    up, found = mean(stand.force, stand.dt), np.zeros(len(stand.dt))
    for k, (dt, m) in enumerate(zip(stand.dt, stand.field, strict=True)):
        odd = (np.linalg.norm(m) - earth.strength) / sigma_strength
        steep = (dip(up, m) - earth.inclination) / sigma_dip
        found[k] = dt / (1 + odd**2 + steep**2) ** 2
    return found / found.sum()


def product(a: Array, b: Array) -> Array:
    """Of quaternions."""
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *vector])


def matrix(q: Array) -> Array:
    """C_n^b."""
    q1, q2, q3, q4 = q
    return np.array(
        [
            [1 - 2 * (q3**2 + q4**2), 2 * (q2 * q3 + q1 * q4), 2 * (q2 * q4 - q1 * q3)],
            [2 * (q2 * q3 - q1 * q4), 1 - 2 * (q2**2 + q4**2), 2 * (q3 * q4 + q1 * q2)],
            [2 * (q2 * q4 + q1 * q3), 2 * (q3 * q4 - q1 * q2), 1 - 2 * (q2**2 + q3**2)],
        ]
    )


def quaternion(C: Array) -> Array:
    """Of a rotation C_b^n: the eigenvector of the largest eigenvalue of Davenport's matrix."""
    K = np.zeros((4, 4))
    K[0, 0] = np.trace(C)
    K[1:, 1:] = C + C.T - np.trace(C) * np.eye(3)
    K[0, 1:] = K[1:, 0] = [C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]]
    return np.linalg.eigh(K)[1][:, -1]


def mismatch(q: Array, f: Array, b: Array, m: Array) -> Array:
    """h (6,) of the unit force ``f``, the field ``b`` and its reference ``m`` = (m_x, 0, m_z)."""
    q1, q2, q3, q4 = q
    x, z = m[0], m[2]
    return np.array(
        [
            2 * (q2 * q4 - q1 * q3) - f[0],
            2 * (q1 * q2 + q3 * q4) - f[1],
            2 * (0.5 - q2**2 - q3**2) - f[2],
            2 * x * (0.5 - q3**2 - q4**2) + 2 * z * (q2 * q4 - q1 * q3) - b[0],
            2 * x * (q2 * q3 - q1 * q4) + 2 * z * (q1 * q2 + q3 * q4) - b[1],
            2 * x * (q1 * q3 + q2 * q4) + 2 * z * (0.5 - q2**2 - q3**2) - b[2],
        ]
    )


def jacobian(q: Array, m: Array) -> Array:
    """J (6, 4)."""
    q1, q2, q3, q4 = 2 * q
    x, z = m[0], m[2]
    return np.array(
        [
            [-q3, q4, -q1, q2],
            [q2, q1, q4, q3],
            [0, -2 * q2, -2 * q3, 0],
            [-z * q3, z * q4, -2 * x * q3 - z * q1, -2 * x * q4 + z * q2],
            [-x * q4 + z * q2, x * q3 + z * q1, x * q2 + z * q4, -x * q1 + z * q3],
            [x * q3, x * q4 - 2 * z * q2, x * q1 - 2 * z * q3, x * q2],
        ]
    )


def printed_mismatch(q: Array, f: Array, b: Array, m: Array) -> Array:
    """As published: q1 q2 where q1 q3 belongs, twice."""
    h = mismatch(q, f, b, m)
    wrong = 2 * (q[0] * q[2] - q[0] * q[1])
    h[0] += wrong
    h[3] += m[2] * wrong
    return h


def printed_jacobian(q: Array, m: Array) -> Array:
    """As published: q3 where q4 belongs."""
    J = jacobian(q, m)
    J[3, 3] += 4 * m[0] * (q[3] - q[2])
    return J


def gradient(q: Array, f: Array, b: Array, m: Array) -> Array:
    return jacobian(q, m).T @ mismatch(q, f, b, m)


def reference(earth: Earth, seen: Array, how: str) -> Array:
    """Of unit strength, with magnetic north along x: as known (``fixed``), or as steep as it is ``seen``."""
    if how == "fixed":
        return np.array([np.cos(earth.inclination), 0.0, -np.sin(earth.inclination)])
    return np.array([np.hypot(seen[0], seen[1]), 0.0, seen[2]])


def turn(angle: float) -> Array:
    """About up."""
    return dense.rotation(angle * UP)


def seeded(stand: Stand, earth: Earth, seconds: float = 0.2) -> Array:
    """TRIAD of the first samples."""
    early = np.where(np.cumsum(stand.dt) - stand.dt / 2 < seconds, stand.dt, 0.0)
    return triad(mean(stand.force, early), mean(stand.field, early), earth)


def descent(
    stand: Stand,
    earth: Earth,
    first: Array,
    gain: float,
    decay: float,
    softness: float,
    how: str,
    adaptive: bool,
    along: Array | None = None,
) -> Array:
    """The attitude (n, 3, 3) after each sample: Madgwick's steps, or AGDA's; a stand of less than 5 s has a
    shorter decay, in proportion. With `along` (n, 3, 3) each step
    begins where the one before it ended there: steps of fixed length zigzag, and multiply what rounding
    leaves."""
    q, time, found = quaternion(turn(earth.north).T @ first), 0.0, []
    decay = decay * min(stand.dt.sum() / 5.0, 1.0)
    bias = mean(stand.rate, stand.dt)
    for k, (dt, force, rate, field) in enumerate(zip(*stand, strict=True)):
        if along is not None and k > 0:
            q = quaternion(turn(earth.north).T @ along[k - 1])
        time += dt
        if dt > 0:
            f, b = unit(force), field / earth.strength
            slope = gradient(q, f, b, reference(earth, matrix(q).T @ b, how))
            down = slope / np.sqrt(slope @ slope + softness**2)  # none where there is no slope
            turning = 0.5 * product(q, np.array([0.0, *(rate - bias)]))
            beta = gain / (1 + (time / decay) ** 2)
            if adaptive:
                d = abs(np.linalg.norm(b) - 1)
                moves = d / (1 + d) * turning - 1 / (1 + d) * beta * down
            else:
                moves = turning - beta * down
            q = unit(q + moves * dt)
        found.append(turn(earth.north) @ matrix(q).T)
    return np.array(found)


def gauss_newton(stand: Stand, earth: Earth, first: Array, weight: float, how: str) -> Array:
    """The attitude (n, 3, 3) after each sample. What is seen, a, should be b: the small turn x that is wanted
    is the least-squares solution of x × b = b − a, with a hint of x = 0."""
    C, time, found, root = turn(earth.north).T @ first, 0.0, [], np.sqrt(weight)
    for dt, force, _, field in zip(*stand, strict=True):
        time += dt
        if dt > 0:
            up, seen = C @ unit(force), C @ field / earth.strength
            wanted = reference(earth, seen, how)
            A, y = [-dense.skew(UP), np.sqrt(1e-9) * np.eye(3)], [UP - up, np.zeros(3)]
            if how == "fixed":
                A.append(-root * dense.skew(wanted))
                y.append(root * (wanted - seen))
            else:  # yaw alone
                A.append(root * wanted[0] * UP[None])
                y.append(np.array([-root * seen[1]]))
            x = np.linalg.lstsq(np.vstack(A), np.concatenate(y), rcond=None)[0]
            C = dense.rotation(max(1 / (1 + 10 * time), dt) * x) @ C
        found.append(turn(earth.north) @ C)
    return np.array(found)


def nearest(C: Array) -> Array:
    """The rotation nearest to a matrix."""
    u, _, v = np.linalg.svd(C)
    return u @ v


def last_second(dt: Array) -> Array:
    middles = np.cumsum(dt) - dt / 2
    return np.where(middles > dt.sum() - 1.0, dt, 0.0)


def middle(attitudes: Array, dt: Array) -> Array:
    """Of the last second."""
    return nearest(mean(attitudes, last_second(dt)))


def angle(C: Array) -> float:
    """By how much a rotation turns."""
    axial = 0.5 * np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
    return float(np.arctan2(np.linalg.norm(axial), 0.5 * (np.trace(C) - 1)))


def vector(C: Array) -> Array:
    """Rotation vector, of less than half a turn."""
    axial = 0.5 * np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
    length = np.linalg.norm(axial)
    return axial if length < 1e-12 else angle(C) / length * axial


def spread(attitudes: Array, final: Array, dt: Array) -> tuple[float, float]:
    """RMS of tilt and heading about the final attitude, in the last second."""
    away = np.array([vector(C @ final.T) ** 2 for C in attitudes])
    x, y, z = mean(away, last_second(dt))
    return float(np.sqrt(x + y)), float(np.sqrt(z))


def variance(x: Array, weights: Array) -> float:
    """Of vectors about their mean, along an axis."""
    middle = mean(x, weights)
    return float(mean((x - middle) ** 2, weights).sum() / 3)


def heading_variance(field: Array, earth: Earth, tilt: float, unrest: float) -> float:
    """Of the azimuth of a field (3,): tan^2 of its dip for the tilt, noise over its level length, and half of
    what is odd in it."""
    level = np.hypot(field[0], field[1])
    odd = (strength(field) - earth.strength) ** 2
    odd += (strength(field) * (inclination(field) - earth.inclination)) ** 2
    return float(tilt * (field[2] / level) ** 2 + (unrest + odd / 2) / level**2)


def left_over(field: Array, C: Array, disturbance: Array, earth: Earth) -> float:
    return float(np.linalg.norm(earth.field()) - np.linalg.norm(field - C.T @ disturbance))


def oddity(up: Array, field: Array, earth: Earth) -> float:
    size = np.linalg.norm(field)
    return float(np.hypot(size - earth.strength, size * (dip(up, field) - earth.inclination)))


def converged(attitudes: Array, time: Array, final: Array, within: float) -> float:
    """When all from there on are within."""
    for k in range(len(time)):
        if all(angle(C @ final.T) <= within for C in attitudes[k:]):
            return float(time[k])
    return np.inf


def triangle(measured: float, earth: float, disturbance: float) -> float:
    """The angle between the measured and the earth's level field of those lengths."""
    K = (measured**2 + earth**2 - disturbance**2) / (2 * earth * measured)
    return float(np.arccos(np.clip(K, -1.0, 1.0)))


def density(x: float, variance: float) -> float:
    return float(np.exp(-0.5 * x * x / variance) / np.sqrt(2 * np.pi * variance))


def expected(innovation: float, turned: float, variance: float) -> tuple[float, float]:
    """Mean and variance of the yaw error where it is ``innovation`` ± ``turned``, by how likely either is."""
    sides = [wrapped(innovation - turned), wrapped(innovation + turned)]
    likely = [density(x, variance) for x in sides]
    share = [x / sum(likely) for x in likely]
    middle = sum(s * x for s, x in zip(share, sides, strict=True))
    return middle, sum(s * (x - middle) ** 2 for s, x in zip(share, sides, strict=True))


def printed_heading(x: float, y: float, earth: float, disturbance: float) -> float:
    """As published: the direction of the earth's field in a level frame, by arc sines."""
    measured = np.hypot(x, y)
    K = (measured**2 + earth**2 - disturbance**2) / (2 * earth * measured)
    return float(np.arcsin(np.clip(K, -1, 1)) - np.arcsin(x / measured))


class Noise:
    """A law's α, look by look: of innovations z (m,), H P H^T and R (m, m)."""

    def __init__(self, law: str, scale: float = 1.0, window: int = 10, signed: bool = False):
        self.law, self.scale, self.window = law, scale, window
        self.least = -np.inf if signed else 0.0
        self.outer: list[Array] = []

    def see(self, z: Array, HPH: Array, R: Array, now: bool = True) -> float:
        """α, without softness (``signed``: what it is made of); only a look that is ``now`` is remembered."""
        m = len(z)
        if self.law == "innovation":
            return self.scale * max(self.least, float(z @ np.linalg.solve(HPH + R, z)) / m - 1)
        if now:
            self.outer = [*self.outer, np.outer(z, z)][-self.window :]
        many = len(self.outer)
        total = sum(self.outer, np.zeros((m, m)))
        if self.law == "windowed":
            inverse = np.linalg.inv(R)
            usual = np.trace(inverse @ total) / max(many, 1)
            return self.scale * max(self.least, (usual - np.trace(inverse @ HPH)) / m - 1)
        usual = total / max(many - 1, 1)
        return self.scale * abs(float(np.trace(np.outer(z, z)) - np.trace(usual)))


def softened(x: float, softness: float) -> float:
    """max(0, x), smooth."""
    return float(softness * np.logaddexp(0.0, x / softness))
