"""Stance detectors against labels from the true velocity."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.detection.bands import Labelled
from pedjax.detection.curves import Roc, Wanted
from pedjax.detection.judged import Judged
from pedjax.detection.points import Reached, is_searched, moved
from pedjax.detectors import stance
from pedjax.detectors.stance import DETECTORS
from pedjax.errors import InputError
from pedjax.recording import Clock, Inertial, Recording, inertial, nominal_rate


class Labels(NamedTuple):
    """`still (T,)` bool, and `known (T,)` bool: whether there is truth to tell."""

    still: np.ndarray
    known: np.ndarray


def still_labels(
    recording: Recording,
    imu: Inertial,
    below: float = 0.1,
    smooth_s: float = 0.025,
    sensor: str | None = None,
) -> Labels:
    """Still where the true speed of the sensor is below `below` m/s, from central differences of
    its dense truth smoothed over `smooth_s`. Unknown outside the truth and in its gaps."""
    truth = recording.truth_of(sensor)
    if truth is None:
        raise InputError(f"{recording.name}: an ROC needs dense truth to label stance; it has none")
    good = np.isfinite(truth.position).all(axis=1) & (np.diff(truth.time, prepend=-np.inf) > 0)
    time, position = truth.time[good], truth.position[good]
    step = float(np.median(np.diff(truth.time)))
    velocity = np.gradient(position, time, axis=0)
    kernel = np.ones(max(round(smooth_s / step), 1))
    share = np.convolve(np.ones(len(time)), kernel, mode="same")  # fewer samples count at the ends
    smooth = np.stack([np.convolve(v, kernel, mode="same") / share for v in velocity.T], axis=1)
    speed = np.interp(imu.time, time, np.linalg.norm(smooth, axis=1))
    after = np.clip(np.searchsorted(time, imu.time), 1, len(time) - 1)
    in_gap = time[after] - time[after - 1] > 3.5 * step
    inside = (imu.time >= time[0]) & (imu.time <= time[-1])
    return Labels(speed < below, inside & ~in_gap)


def statistics(params: Any, detector: str, samples: Sequence[Inertial]) -> list[np.ndarray]:
    """A detector's statistic at each sample, with the window and sigmas of `params.stance`."""
    chosen = parameters.replace(params, {"stance.detector": detector}).stance
    dtype = jnp.result_type(float)
    return [
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


def labelled(
    params: Any, detectors: Sequence[str], samples: Sequence[Inertial], labels: Sequence[Labels]
) -> Labelled:
    """The statistics of detectors at all samples with truth."""
    found = {
        name: [x[y.known] for x, y in zip(statistics(params, name, samples), labels, strict=True)]
        for name in detectors
    }
    still = [y.still[y.known] for y in labels]
    return Labelled(found, still, {"all": [np.full(len(y), True) for y in still]})


def at_point(params: Any, detector: str, curve: Roc, wanted: Wanted) -> Reached:
    """A detector at an operating point of its ROC, as far as its bounds let it."""
    own, prefix = getattr(params.stance, detector), f"stance.{detector}"
    if is_searched(own, detector):
        raise InputError(f"stance detector '{detector}': its operating points cannot be searched for")
    threshold = curve.at(wanted)
    values = moved(own, detector, threshold, float(DETECTORS[detector].threshold(own)))
    inside = parameters.within(params, {f"{prefix}.{path}": x for path, x in values.items()})
    if len(inside) == 1:
        threshold = next(iter(inside.values()))
    reached = curve.detection_at(threshold), curve.false_alarm_at(threshold)
    return Reached({"stance.detector": detector, **inside}, *reached)


def judge_stance(
    params: Any,
    recordings: Sequence[Recording],
    detectors: Sequence[str] | None = None,
    *,
    sensor: str = "foot",
    clock: Clock | None = None,
    still_below: float = 0.1,
) -> Judged:
    """Stance detectors (None: all) on recordings with dense truth: the foot is still below `still_below` m/s.

    `params` are a system's, with the windows and sigmas of `params.stance`.
    """
    names = tuple(DETECTORS) if detectors is None else detectors
    samples = [inertial(r, sensor, clock) for r in recordings]
    labels = [
        still_labels(r, i, still_below, sensor=sensor) for r, i in zip(recordings, samples, strict=True)
    ]
    entries = [
        {
            "duration_s": r.duration,
            "labelled_fraction": float(x.known.mean()),
            "still_fraction": float(x.still[x.known].mean()),
        }
        for r, x in zip(recordings, labels, strict=True)
    ]
    return Judged(
        params,
        recordings,
        labelled(params, names, samples, labels),
        entries,
        {"still_below_m_per_s": still_below},
        partial(at_point, params),
    )
