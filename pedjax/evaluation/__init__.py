"""Evaluation: landmark errors after alignment, heading errors, ROC and how sure it is."""

from pedjax.evaluation.landmarks import ALIGNMENTS, Errors, Reference, align, landmark_errors
from pedjax.evaluation.resampling import Banded, Interval, Labelled, compare, difference
from pedjax.evaluation.roc import Roc, roc

__all__ = [
    "ALIGNMENTS", "Banded", "Errors", "Interval", "Labelled", "Reference", "Roc", "align", "compare",
    "difference", "landmark_errors", "roc",
]  # fmt: skip
