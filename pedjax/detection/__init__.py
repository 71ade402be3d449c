"""Detectors against what is true: ROC of stance, field and straight-walking detectors, and how sure it is;
sigmas of field detectors from recordings."""

from pedjax.detection.bands import Banded, Interval, Labelled, compare, difference
from pedjax.detection.curves import Roc, Wanted, roc
from pedjax.detection.field import judge_field, looks_at_field
from pedjax.detection.judged import Judged
from pedjax.detection.points import Reached
from pedjax.detection.sigmas import FieldSigmas, field_sigmas
from pedjax.detection.stance import judge_stance
from pedjax.detection.straight import counts_strides, judge_straight

__all__ = [
    "Banded", "FieldSigmas", "Interval", "Judged", "Labelled", "Reached", "Roc", "Wanted", "compare",
    "counts_strides", "difference", "field_sigmas", "judge_field", "judge_stance", "judge_straight",
    "looks_at_field", "roc",
]  # fmt: skip
