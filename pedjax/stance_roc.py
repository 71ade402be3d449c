"""ROC of a stance detector over recordings, with labels from the true velocity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.detectors import stance
from pedjax.errors import InputError
from pedjax.evaluation.roc import Roc, roc
from pedjax.packing import nominal_rate
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


def detector_roc(
    params: Any, detector: str, samples: Sequence[Inertial], labels: Sequence[np.ndarray]
) -> Roc:
    """ROC of a detector, with the window and sigmas of `params.stance`, over all samples together."""
    chosen = parameters.replace(params, {"stance.detector": detector}).stance
    dtype = jnp.result_type(float)
    found = [
        np.asarray(
            stance.statistic(
                parameters.cast(chosen, dtype),
                jnp.asarray(s.specific_force, dtype),
                jnp.asarray(s.angular_rate, dtype),
                nominal_rate(s),
                params.gravity,
            )
        )
        for s in samples
    ]
    return roc(np.concatenate(found), np.concatenate(labels))
