"""Zero-velocity detectors as naive loops. Low statistic means still.

Every statistic is trailing: entry n belongs to the window of samples n-W+1 .. n and is +inf for n < W-1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def shoe(acc: Array, gyr: Array, W: int, sigma_a: float, sigma_w: float, g: float) -> Array:
    """Stance hypothesis optimal estimation (GLRT), dimensionless; acc and g m/s^2, gyr rad/s.

    A window whose mean force is zero has no direction of gravity: +inf.
    """
    out = np.full(len(acc), np.inf)
    for n in range(W - 1, len(acc)):
        mean = np.zeros(3)
        for k in range(n - W + 1, n + 1):
            mean = mean + acc[k] / W
        length = np.linalg.norm(mean)
        if length == 0.0:
            continue
        total = 0.0
        for k in range(n - W + 1, n + 1):
            difference = acc[k] - g * mean / length
            total += difference @ difference / sigma_a**2 + gyr[k] @ gyr[k] / sigma_w**2
        out[n] = total / W
    return out


def ared(gyr: Array, W: int) -> Array:
    """Angular rate energy: mean |w|^2 in (rad/s)^2."""
    out = np.full(len(gyr), np.inf)
    for n in range(W - 1, len(gyr)):
        total = 0.0
        for k in range(n - W + 1, n + 1):
            total += gyr[k] @ gyr[k]
        out[n] = total / W
    return out


def amvd(acc: Array, W: int) -> Array:
    """Acceleration moving variance: mean |a - mean a|^2 in (m/s^2)^2."""
    out = np.full(len(acc), np.inf)
    for n in range(W - 1, len(acc)):
        mean = np.zeros(3)
        for k in range(n - W + 1, n + 1):
            mean = mean + acc[k] / W
        total = 0.0
        for k in range(n - W + 1, n + 1):
            total += (acc[k] - mean) @ (acc[k] - mean)
        out[n] = total / W
    return out


def mag(acc: Array, W: int, sigma_a: float, g: float) -> Array:
    """Acceleration magnitude: mean (|a| - g)^2 / sigma_a^2, dimensionless; all in m/s^2."""
    out = np.full(len(acc), np.inf)
    for n in range(W - 1, len(acc)):
        total = 0.0
        for k in range(n - W + 1, n + 1):
            total += (np.linalg.norm(acc[k]) - g) ** 2
        out[n] = total / (sigma_a**2 * W)
    return out


def mbgtd(acc: Array, W: int) -> Array:
    """Memory-based graph-theoretic detector in m/s^2: the largest weighted distance across a split.

    Max over 0 <= s < t <= W-1 of sum_{i<=s} sum_{j>=t} |a_i - a_j| / ((t - s) (W - t + 1)); needs W >= 2.
    """
    out = np.full(len(acc), np.inf)
    for n in range(W - 1, len(acc)):
        window = acc[n - W + 1 : n + 1]
        best = -np.inf
        for s in range(W - 1):
            for t in range(s + 1, W):
                total = 0.0
                for i in range(s + 1):
                    for j in range(t, W):
                        total += np.linalg.norm(window[i] - window[j])
                best = max(best, total / ((t - s) * (W - t + 1)))
        out[n] = best
    return out


def eps(acc: Array, gyr: Array, W: int) -> Array:
    """(T, 5): Var(E), Var(P), Var(S), Var(w) over the trailing window (ddof 0), and w of the sample itself.

    E = ax^2 + az^2 and P = ax az in (m/s^2)^2, S = ax + az in m/s^2, w = wx^2 + wy^2 in (rad/s)^2.
    All five are +inf while there is no full window.
    """
    out = np.full((len(acc), 5), np.inf)
    for n in range(W - 1, len(acc)):
        series: list[list[float]] = [[], [], [], []]
        for k in range(n - W + 1, n + 1):
            ax, az = acc[k, 0], acc[k, 2]
            wx, wy = gyr[k, 0], gyr[k, 1]
            series[0].append(ax**2 + az**2)
            series[1].append(ax * az)
            series[2].append(ax + az)
            series[3].append(wx**2 + wy**2)
        for c in range(4):
            mean = sum(series[c]) / W
            out[n, c] = sum((x - mean) ** 2 for x in series[c]) / W
        out[n, 4] = abs(series[3][-1])
    return out


def apply_rule(statistic_trailing: Array, W: int, rule: str) -> Array:
    """From one statistic per trailing window to one per sample.

    causal: the window that ends at the sample. any, all: least, largest of the windows that cover the sample
    and lie within the record. block: the window of the block k W .. k W + W-1 that holds the sample; a last
    incomplete block is +inf. NaN counts as +inf (not stationary), and so does a sample no window covers.
    """
    statistic = np.where(np.isnan(statistic_trailing), np.inf, statistic_trailing)
    count = len(statistic)
    out = np.full(count, np.inf)
    for n in range(count):
        covering = [statistic[end] for end in range(n, n + W) if W - 1 <= end < count]
        if rule == "causal":
            out[n] = statistic[n] if n >= W - 1 else np.inf
        elif rule == "any":
            out[n] = min(covering, default=np.inf)
        elif rule == "all":
            out[n] = max(covering, default=np.inf)
        elif rule == "block":
            end = (n // W) * W + W - 1
            out[n] = statistic[end] if end < count else np.inf
        else:
            raise ValueError(f"unknown rule {rule!r}")
    return out


def runs(mask: ArrayLike, value: bool) -> list[tuple[int, int]]:
    """Half-open index ranges (first, end) where ``mask`` equals ``value``."""
    flags = [bool(x) for x in np.asarray(mask)]
    found = []
    first = None
    for n, flag in enumerate([*flags, not value]):
        if flag == value and first is None:
            first = n
        if flag != value and first is not None:
            found.append((first, n))
            first = None
    return found


def clean_stance(mask: Mask, dt: float | Array, merge_s: float, drop_s: float) -> Mask:
    """Merge gaps below ``merge_s`` between stances, then drop stances below ``drop_s`` (both strictly).

    A run of samples lasts the sum of its ``dt``, all in s; a nanosecond of tolerance keeps rounding from
    calling a run shorter than a limit that it equals. What leads and trails the record is no gap.
    """
    out = np.array(mask, dtype=bool)
    count = len(out)
    steps = np.broadcast_to(np.asarray(dt, dtype=float), (count,))
    tolerance = 1e-9
    for first, end in runs(out, False):
        between = first > 0 and end < count
        if between and sum(steps[first:end]) < merge_s - tolerance:
            out[first:end] = True
    for first, end in runs(out, True):
        if sum(steps[first:end]) < drop_s - tolerance:
            out[first:end] = False
    return out


def stance_id(mask: Mask) -> NDArray[np.int64]:
    """Number of the stance, 0, 1, 2, ..., that each sample lies in; -1 outside."""
    out = np.full(len(mask), -1, dtype=np.int64)
    for number, (first, end) in enumerate(runs(mask, True)):
        out[first:end] = number
    return out


def standing_start(
    rate: Array, dt: Array, rate_hz: float, rest_s: float, length: int | None = None
) -> tuple[Array, float, int]:
    """Mean rate (3,) rad/s, spread of the windows' means (rad/s)^2 and number of windows of the leading rest.

    Windows of 0.25 s end to end in the first ``rest_s`` [s]; one rests while the rate's standard deviation is
    below 0.02 rad/s and its mean below 1 deg/s. dt (T,) in s is 0 in padding.
    """
    width = round(0.25 * rate_hz)
    end = len(rate) if length is None else length
    means: list[Array] = []
    while (len(means) + 1) * width <= min(end, rest_s * rate_hz):
        part = slice(len(means) * width, (len(means) + 1) * width)
        if np.any(dt[part] == 0.0):
            break
        mean = sum(rate[part]) / width
        variance = sum(float((x - mean) @ (x - mean)) for x in rate[part]) / width
        if np.sqrt(variance) >= 0.02 or np.linalg.norm(mean) >= np.deg2rad(1.0):
            break
        means.append(mean)
    if not means:
        return np.zeros(3), 0.0, 0
    whole = sum(means) / len(means)
    spread = sum(float((x - whole) @ (x - whole)) for x in means) / (3 * len(means))
    return whole, spread, len(means)
