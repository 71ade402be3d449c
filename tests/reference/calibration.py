"""Magnetometer calibration in plain numpy and scipy, float64: by other routes than the package's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig
from scipy.optimize import least_squares

Array = NDArray[np.float64]


def turn(roll: float, pitch: float, yaw: float) -> Array:
    """C = Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp, cy, sy = (
        np.cos(roll),
        np.sin(roll),
        np.cos(pitch),
        np.sin(pitch),
        np.cos(yaw),
        np.sin(yaw),
    )
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1.0]])
    ry = np.array([[cp, 0, sp], [0, 1.0, 0], [-sp, 0, cp]])
    rx = np.array([[1.0, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return rz @ ry @ rx


def attitudes(rng: np.random.Generator, count: int) -> Array:
    """Random rotations `(count, 3, 3)`."""
    q, r = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None]
    return q * np.linalg.det(q)[:, None, None]


def earth(declination: float, inclination: float, strength: float) -> Array:
    """The field in ENU."""
    level = strength * np.cos(inclination)
    return np.array(
        [level * np.sin(declination), level * np.cos(declination), -strength * np.sin(inclination)]
    )


def ellipse(angles: Array, axes: tuple[float, float], eta: float, offset: Array) -> Array:
    """Points `(K, 2)` with the long axis at eta."""
    c, s = np.cos(eta), np.sin(eta)
    local = np.stack([axes[0] * np.cos(angles), axes[1] * np.sin(angles)])
    return (np.array([[c, -s], [s, c]]) @ local).T + offset


def ma(points: Array, arc_sine: bool = False) -> tuple[Array, float, float, Array]:
    """Ma 2018, Eq. 6-12: offset, eta, tau and matrix; `arc_sine` as Eq. 8 is printed."""
    offset = (points.max(axis=0) + points.min(axis=0)) / 2
    m = points - offset
    r = np.hypot(*m.T)
    x, y = m[r.argmax()]
    eta = np.arcsin(y / r.max()) if arc_sine else np.arctan2(y, x)
    tau = r.min() / r.max()
    rotation = np.array([[np.cos(eta), np.sin(eta)], [-np.sin(eta), np.cos(eta)]])
    return offset, float(eta), float(tau), rotation.T @ np.diag([tau, 1.0]) @ rotation


def conic(points: Array) -> tuple[Array, Array]:
    """Least-squares conic about the points' mean: centre and W, by the pseudo-inverse."""
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    p = np.linalg.pinv(np.stack([x * x, x * y, y * y, x, y], axis=1)) @ np.ones(len(x))
    a = np.array([[p[0], p[1] / 2], [p[1] / 2, p[2]]])
    centre = np.linalg.solve(-2 * a, p[3:])
    return centre + middle, a / (1 + centre @ a @ centre)


def quadric(points: Array) -> tuple[Array, Array]:
    """Least-squares quadric of value one about the points' mean: centre and W."""
    middle = points.mean(axis=0)
    x, y, z = (points - middle).T
    design = np.stack([x * x, y * y, z * z, y * z, x * z, x * y, x, y, z], axis=1)
    p = np.linalg.lstsq(design, np.ones(len(x)), rcond=None)[0]
    q = np.array([[p[0], p[5] / 2, p[4] / 2], [p[5] / 2, p[1], p[3] / 2], [p[4] / 2, p[3] / 2, p[2]]])
    centre = np.linalg.solve(-2 * q, p[6:])
    return centre + middle, q / (1 + centre @ q @ centre)


def _general(points: Array, constraint: Array, order: list[tuple[int, int]]) -> tuple[Array, Array]:
    """The quadric of the constrained problem, by the unsymmetric eigenproblem of the papers."""
    x = np.column_stack([points, np.ones(len(points))])
    design = np.stack([x[:, i] * x[:, j] for i, j in order], axis=1)
    gram, n = design.T @ design, len(constraint)
    below = np.linalg.solve(gram[n:, n:], gram[n:, :n])
    values, vectors = eig(gram[:n, :n] - gram[:n, n:] @ below, constraint)
    vectors = vectors.real
    positive = [k for k in range(n) if vectors[:, k] @ constraint @ vectors[:, k] > 0]
    assert len(positive) == 1, values
    head = vectors[:, positive[0]]
    p = np.concatenate([head, -below @ head])
    full = np.zeros((4, 4))
    for (i, j), value in zip(order, p, strict=True):
        full[i, j] += value / 2
        full[j, i] += value / 2
    if np.trace(full[:3, :3]) < 0:
        full = -full
    q, u, d = full[:3, :3], full[:3, 3], full[3, 3]
    centre = -np.linalg.solve(q, u)
    return centre, q / (centre @ q @ centre - d)


def _scaled(points: Array) -> tuple[Array, Array, float]:
    middle = points.mean(axis=0)
    size = float(np.abs(points - middle).max())
    return (points - middle) / size, middle, size


def fang(points: Array) -> tuple[Array, Array]:
    """CLSEF: 4 a1 a3 - a2² = 1 on the x-y section."""
    order = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2), (0, 3), (1, 3), (2, 3), (3, 3)]
    x, middle, size = _scaled(points)
    centre, w = _general(x, np.array([[0, 0, 2.0], [0, -1.0, 0], [2.0, 0, 0]]), order)
    return middle + size * centre, w / size**2


def li_griffiths(points: Array, k: float = 4.0) -> tuple[Array, Array]:
    """k J - I² = 1, in plain monomials: J = ab + bc + ca - f² - g² - h², I = a + b + c."""
    order = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1), (0, 3), (1, 3), (2, 3), (3, 3)]
    c = np.zeros((6, 6))
    c[:3, :3] = k / 2 - 1
    c[np.diag_indices(3)] = -1.0
    c[3:, 3:] = -k / 4 * np.eye(3)  # the monomial yz carries 2 f
    x, middle, size = _scaled(points)
    centre, w = _general(x, c, order)
    return middle + size * centre, w / size**2


def geometric(points: Array, centre: Array, w: Array) -> tuple[Array, Array]:
    """Least squares in |K (x - b)| - F with scipy, from a start: centre and W, over a full symmetric K."""
    values, vectors = np.linalg.eigh(w)
    size = float(1 / np.sqrt(values.mean()))
    start = (vectors * np.sqrt(values)) @ vectors.T * size
    pick = np.triu_indices(3)

    def matrix(p: Array) -> Array:
        k = np.zeros((3, 3))
        k[pick] = p[3:]
        return np.triu(k) + np.triu(k, 1).T

    def residual(p: Array) -> Array:
        return np.linalg.norm((points - p[:3] * size) @ matrix(p).T / size, axis=1) - 1

    found = least_squares(
        residual, np.concatenate([centre / size, start[pick]]), xtol=1e-15, ftol=1e-15, gtol=1e-15
    ).x
    k = matrix(found) / size
    return found[:3] * size, k.T @ k
