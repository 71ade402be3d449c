"""Swings of the thigh by loops over samples, with filters as difference equations."""

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation


def second_order(x, hz, rate_hz):
    """Above, about and below a corner: Butterworth of second order, by the bilinear transform."""
    k = np.tan(np.pi * hz / rate_hz)
    bottom = [1 + np.sqrt(2) * k + k * k, 2 * (k * k - 1), 1 - np.sqrt(2) * k + k * k]
    tops = ([1, -2, 1], [k, 0, -k], [k * k, 2 * k * k, k * k])
    return [lfilter(np.array(top), bottom, x, axis=0) for top in tops]


def upward(force, rate, step):
    """Up in the body: the mean of the force, carried along with the body, forgetting over 2 s."""
    mean, found = force[0], []
    for k in range(len(force)):
        mean = Rotation.from_rotvec(-step * rate[k]).apply(mean)
        mean = mean + step / (step + min(k * step, 2.0) + 1e-12) * (force[k] - mean)
        found.append(mean / np.linalg.norm(mean))
    return np.array(found)


def cycles(force, rate, rate_hz):
    """Sample, swing, seconds and bounce of each stride; the angle, and the axis to the right, of each sample.

    `force`, `rate (T, 3)` in m/s^2 and rad/s at an even rate.
    """
    step = 1 / rate_hz
    up = upward(force, rate, step)
    upright = np.sum(up * rate, axis=1, keepdims=True)
    _, _, low = second_order(rate - upright * up, 5.0, rate_hz)
    _, _, lift = second_order(np.sum(up * force, axis=1), 5.0, rate_hz)
    quick, middle, _ = second_order(low, 0.3, rate_hz)
    angles = middle / (2 * np.pi * 0.3)

    moment, axis, cube = np.zeros((3, 3)), None, 0.0
    side, changed, strides, swung, right = "rest", -1, [], [], []
    since, sway = None, []
    for k, angle in enumerate(angles):
        share = step / (step + min(k * step, 10.0) + 1e-12)
        moment = (1 - share) * moment + share * np.outer(angle, angle)
        size = np.trace(moment)
        if size > 1e-12:
            axis = angle if axis is None else moment @ axis / size + 1e-3 * axis
            axis = axis / np.linalg.norm(axis)
        about = np.zeros(3) if axis is None else axis
        cube += share * ((about @ quick[k]) ** 3 - cube)
        s = about @ angle
        swung.append(s)
        right.append(about if cube >= 0 else -about)

        band = max(0.25 * np.sqrt(np.linalg.norm(moment @ about)), 0.0175)
        before = side
        if s > band and before != "above":
            side, changed = "above", k
        elif s < -band and before != "below":
            side, changed = "below", k
        elif k - changed > 1.5 * rate_hz + 0.5:
            side = "rest"
        sway.append((s, lift[k]))
        if before == "below" and side != "below":
            spread = np.ptp(sway, axis=0)
            strides.append((k, spread[0], (k - since) * step, spread[1]))
        if (before == "below" and side != "below") or before == "rest":
            since, sway = k, [(s, lift[k])]
    return np.array(strides), np.array(swung), np.array(right)
