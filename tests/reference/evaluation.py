"""Comparison of a track with surveyed points, and detector curves, by search instead of closed forms."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]


def apply_alignment(points: Array, yaw: float, translation: Array) -> Array:
    """Rz(yaw) point + translation for points (N, 3) m; yaw in rad."""
    c, s = np.cos(yaw), np.sin(yaw)
    rz = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.array([rz @ point + translation for point in points])


def align(est: Array, ref: Array, mode: str) -> tuple[Array, float, Array]:
    """Fit est (K, 3) to ref (K, 3), both m: aligned points, yaw [rad], translation (3,) [m].

    A reference coordinate that is NaN is unknown; the horizontal fit takes the points whose x and y are both
    known. none: as it is. yaw: the first such pair of points is put together and the best yaw about it is
    searched; the height is matched at the first known height. yaw_translation: yaw and both translations
    are searched together; the height is matched in the mean over the known heights. Where no height is
    known it stays; where the yaw does not matter (one point) it is 0.
    """
    est = np.asarray(est, dtype=float)
    ref = np.asarray(ref, dtype=float)
    if mode == "none":
        return est.copy(), 0.0, np.zeros(3)
    if mode not in ("yaw", "yaw_translation"):
        raise ValueError(f"unknown mode {mode!r}")
    flat = np.isfinite(ref[:, 0]) & np.isfinite(ref[:, 1])
    high = np.isfinite(ref[:, 2])
    if not flat.any():
        raise ValueError("no reference point with a known horizontal position")
    e, r = est[flat, :2], ref[flat, :2]
    centre, target = e[0], r[0]

    def residuals(x: Array) -> Array:
        c, s = np.cos(x[0]), np.sin(x[0])
        d = e - centre
        rotated = np.stack([c * d[:, 0] - s * d[:, 1], s * d[:, 0] + c * d[:, 1]], axis=1)
        shift = x[1:3] if mode == "yaw_translation" else np.zeros(2)
        return (rotated + target + shift - r).ravel()

    best = np.zeros(3 if mode == "yaw_translation" else 1)
    if len(e) > 1:
        starts = np.linspace(-np.pi, np.pi, 12, endpoint=False)
        costs, candidates = [], []
        for start in starts:
            x0 = np.zeros_like(best)
            x0[0] = start
            fit = least_squares(residuals, x0, jac="cs", ftol=1e-15, xtol=1e-15, gtol=1e-15)
            costs.append(fit.cost)
            candidates.append(fit.x)
        best = candidates[int(np.argmin(costs))]
        spread = np.max(np.abs(e - centre)) * np.max(np.abs(r - target))
        if spread == 0.0:
            best[0] = 0.0
            if mode == "yaw_translation":
                best[1:] = np.mean(r - target - (e - centre), axis=0)
    yaw = float(np.arctan2(np.sin(best[0]), np.cos(best[0])))
    turned_centre = apply_alignment(np.array([[centre[0], centre[1], 0.0]]), yaw, np.zeros(3))[0]
    shift = best[1:3] if mode == "yaw_translation" else np.zeros(2)
    translation = np.zeros(3)
    translation[:2] = target + shift - turned_centre[:2]
    if high.any():
        heights = ref[high, 2] - est[high, 2]
        translation[2] = heights[0] if mode == "yaw" else np.mean(heights)
    return apply_alignment(est, yaw, translation), yaw, translation


def distance_walked(positions: Array) -> float:
    """Sum of the horizontal steps between the given positions (N, 2 or 3), in m."""
    total = 0.0
    for before, after in itertools.pairwise(positions):
        total += float(np.hypot(after[0] - before[0], after[1] - before[1]))
    return total


def percent(error: float, distance: float) -> float:
    """An error as a percentage of the distance walked, both in m."""
    return 100.0 * error / distance


def errors(est: Array, ref: Array, distance: float) -> dict[str, float]:
    """Errors of est (K, 3) against ref (K, 3), m: no alignment is made here.

    rms_2d, mean_2d, max_2d, final_2d and armse (PyShoe's: mean of the root mean square of the two horizontal
    differences) over the points whose x and y are known, final_2d at the last of them; rms_3d over the points
    with all three known, NaN without any; percent_final and percent_rms of ``distance`` [m].
    """
    horizontal, spatial, per_axis = [], [], []
    for a, b in zip(np.asarray(est, dtype=float), np.asarray(ref, dtype=float), strict=True):
        if np.isfinite(b[:2]).all():
            dx, dy = a[0] - b[0], a[1] - b[1]
            horizontal.append(np.sqrt(dx**2 + dy**2))
            per_axis.append(np.sqrt((dx**2 + dy**2) / 2.0))
        if np.isfinite(b).all():
            spatial.append(np.sqrt(np.sum((a - b) ** 2)))
    if not horizontal:
        raise ValueError("no reference point with a known horizontal position")
    rms = float(np.sqrt(np.mean(np.square(horizontal))))
    return {
        "rms_2d": rms,
        "mean_2d": float(np.mean(horizontal)),
        "max_2d": float(np.max(horizontal)),
        "final_2d": float(horizontal[-1]),
        "rms_3d": float(np.sqrt(np.mean(np.square(spatial)))) if spatial else float("nan"),
        "armse": float(np.mean(per_axis)),
        "distance": float(distance),
        "percent_final": percent(horizontal[-1], distance),
        "percent_rms": percent(rms, distance),
    }


def roc(
    statistic: Array, labels: NDArray[np.bool_], thresholds: Array | None = None
) -> dict[str, Array | float]:
    """Curve of a detector that says still where statistic < threshold, against the true ``labels`` (still).

    Thresholds: every different value of the statistic and +inf, or those given (sorted). P_D is the share of
    still samples found, P_FA the share of moving ones taken for still. The area is by trapezoids from (0, 0)
    through the curve to (1, 1), so samples at +inf or NaN, which no threshold takes, count as ties.
    """
    values = np.where(np.isnan(statistic), np.inf, np.asarray(statistic, dtype=float))
    truth = np.asarray(labels, dtype=bool)
    if truth.all() or not truth.any():
        raise ValueError("labels need both still and moving samples")
    levels = np.append(np.unique(values[np.isfinite(values)]), np.inf) if thresholds is None else thresholds
    levels = np.sort(np.asarray(levels, dtype=float))
    detected, false_alarms = [], []
    for level in levels:
        still = values < level
        detected.append(np.sum(still & truth) / np.sum(truth))
        false_alarms.append(np.sum(still & ~truth) / np.sum(~truth))
    x = [0.0, *false_alarms, 1.0]
    y = [0.0, *detected, 1.0]
    area = 0.0
    for i in range(len(x) - 1):
        area += 0.5 * (y[i] + y[i + 1]) * (x[i + 1] - x[i])
    return {
        "threshold": levels,
        "p_d": np.array(detected),
        "p_fa": np.array(false_alarms),
        "auc": float(area),
    }
