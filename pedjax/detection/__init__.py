"""Detectors against what is true: ROC of stance and of field detectors, and how sure it is; sigmas of field
detectors from recordings."""

from pedjax.detection.bands import Banded, Interval, Labelled, compare, difference
from pedjax.detection.curves import Roc, Wanted, roc
from pedjax.detection.field import judge_field, looks_at_field
from pedjax.detection.judged import Judged
from pedjax.detection.points import Reached
from pedjax.detection.sigmas import FieldSigmas, field_sigmas
from pedjax.detection.stance import judge_stance

__all__ = [
    "Banded", "FieldSigmas", "Interval", "Judged", "Labelled", "Reached", "Roc", "Wanted", "compare",
    "difference", "field_sigmas", "judge_field", "judge_stance", "looks_at_field", "roc",
]  # fmt: skip
