"""Evaluation: landmark errors after alignment, heading errors, the table of scores."""

from pedjax.evaluation.landmarks import ALIGNMENTS, Errors, Reference, align, landmark_errors

__all__ = ["ALIGNMENTS", "Errors", "Reference", "align", "landmark_errors"]
