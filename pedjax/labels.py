"""Stance labels from a reference: still where the true velocity is small."""

from __future__ import annotations

import numpy as np

from pedjax.errors import InputError
from pedjax.recording import Inertial, Recording


def still_labels(
    recording: Recording, imu: Inertial, below: float = 0.1, smooth_s: float = 0.025
) -> np.ndarray:
    """`(T,)` bool: true speed below `below` m/s, from the dense truth's central differences smoothed over
    `smooth_s`. Samples outside the truth are not still."""
    truth = recording.truth
    if truth is None:
        raise InputError(f"{recording.name}: an ROC needs dense truth to label stance; it has none")
    good = np.isfinite(truth.position).all(axis=1)
    time, position = truth.time[good], truth.position[good]
    velocity = np.gradient(position, time, axis=0)
    width = max(round(smooth_s / float(np.median(np.diff(time)))), 1)
    kernel = np.ones(width) / width
    smooth = np.stack([np.convolve(v, kernel, mode="same") for v in velocity.T], axis=1)
    speed = np.interp(imu.time, time, np.linalg.norm(smooth, axis=1), left=np.inf, right=np.inf)
    return speed < below
