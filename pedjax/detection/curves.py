"""Receiver operating characteristic of a statistic: all thresholds at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pedjax.errors import InputError


class Wanted(NamedTuple):
    """An operating point: which probability to `keep`, "detection" (no less) or "false_alarm" (no more)."""

    probability: float
    keep: str = "false_alarm"


class Roc(NamedTuple):
    """`threshold (N,)` ascending, probability of detection `p_detection (N,)` and of false alarm
    `p_false_alarm (N,)` when still is declared below the threshold, and the area under the curve."""

    threshold: np.ndarray
    p_detection: np.ndarray
    p_false_alarm: np.ndarray
    auc: float

    def at_false_alarm(self, probability: float) -> float:
        """The largest threshold whose false-alarm probability does not exceed this."""
        count = int(np.searchsorted(self.p_false_alarm, probability, "right"))
        return float(self.threshold[count - 1] if count else np.nextafter(self.threshold[0], -np.inf))

    def detection_at(self, threshold: float) -> float:
        """Probability of detection with this threshold."""
        at = int(np.searchsorted(self.threshold, threshold, "right")) - 1
        return float(self.p_detection[at]) if at >= 0 else 0.0

    def at_detection(self, probability: float) -> float:
        """The smallest threshold that detects with at least this probability."""
        at = int(np.searchsorted(self.p_detection, probability, "left"))
        return float(self.threshold[min(at, len(self.threshold) - 1)])

    def false_alarm_at(self, threshold: float) -> float:
        """Probability of false alarm with this threshold."""
        at = int(np.searchsorted(self.threshold, threshold, "right")) - 1
        return float(self.p_false_alarm[at]) if at >= 0 else 0.0

    def at(self, wanted: Wanted) -> float:
        """The threshold at an operating point, a little above the statistic's own value, so that rounding
        changes no decision."""
        if wanted.keep == "detection":
            threshold = self.at_detection(wanted.probability)
        else:
            threshold = self.at_false_alarm(wanted.probability)
        after = int(np.searchsorted(self.threshold, threshold, "right"))
        room = np.append(self.threshold, np.inf)[after] - threshold
        return threshold + float(min(room / 2, 1e-5 * abs(threshold)))


def roc(statistic: np.ndarray, still: np.ndarray) -> Roc:
    """ROC of `statistic (T,)` (small means still) against labels `still (T,)` bool.

    The thresholds lie just above each distinct value of the statistic, so the curve is exact; its area is
    the probability that a still sample has the smaller statistic, ties counted half.
    """
    statistic, still = np.asarray(statistic, float), np.asarray(still, bool)
    if statistic.shape != still.shape or statistic.ndim != 1:
        raise ValueError(f"statistic {statistic.shape} and labels {still.shape} must both be (T,)")
    if still.all() or not still.any():
        raise InputError(
            "an ROC needs both still and moving (of a field: same and changed) samples among its labels; "
            "change the limit that labels them (--still-below; --same-field, --same-heading)"
        )
    statistic = np.where(np.isnan(statistic), np.inf, statistic)
    order = np.argsort(statistic, kind="stable")
    ordered, labels = statistic[order], still[order]
    last_of_value = np.append(np.flatnonzero(ordered[1:] > ordered[:-1]), len(ordered) - 1)
    detected = np.cumsum(labels)[last_of_value] / labels.sum()
    false_alarm = np.cumsum(~labels)[last_of_value] / (~labels).sum()
    threshold = np.nextafter(ordered[last_of_value], np.inf)
    auc = np.trapezoid(np.append(0.0, detected), np.append(0.0, false_alarm))
    return Roc(threshold, detected, false_alarm, float(auc))
