"""Detectors: statistics over a whole recording in one pass, turned into weights by the one gate."""

from pedjax.detectors.field import register_field_detector
from pedjax.detectors.segments import clean_stance, stance_id
from pedjax.detectors.stance import DETECTORS, Detector, StanceParameters, register_stance_detector
from pedjax.detectors.stance import evidence as stance_evidence
from pedjax.detectors.stance import log_ratio as stance_log_ratio
from pedjax.detectors.stance import statistic as stance_statistic

__all__ = [
    "DETECTORS",
    "Detector",
    "StanceParameters",
    "clean_stance",
    "register_field_detector",
    "register_stance_detector",
    "stance_evidence",
    "stance_id",
    "stance_log_ratio",
    "stance_statistic",
]
