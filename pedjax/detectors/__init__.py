"""Detectors: statistics over a whole recording in one pass, turned into weights by the one gate."""

from pedjax.detectors.segments import clean_stance, segment_mean, stance_id
from pedjax.detectors.stance import DETECTORS, Detector, StanceParameters
from pedjax.detectors.stance import evidence as stance_evidence
from pedjax.detectors.stance import log_ratio as stance_log_ratio
from pedjax.detectors.stance import statistic as stance_statistic

__all__ = [
    "DETECTORS",
    "Detector",
    "StanceParameters",
    "clean_stance",
    "segment_mean",
    "stance_evidence",
    "stance_id",
    "stance_log_ratio",
    "stance_statistic",
]
