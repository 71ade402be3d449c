"""Evaluation: landmark errors after alignment, heading errors, ROC."""

from pedjax.evaluation.landmarks import ALIGNMENTS, Errors, Reference, align, landmark_errors
from pedjax.evaluation.roc import Roc, roc

__all__ = ["ALIGNMENTS", "Errors", "Reference", "Roc", "align", "landmark_errors", "roc"]
