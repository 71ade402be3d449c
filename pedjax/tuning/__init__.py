"""Tuning: the gradient of a landmark error with respect to any parameter, through the whole filter."""

from pedjax.tuning.loop import Tuned, TuneSettings, tune
from pedjax.tuning.split import refuse_overlap, split

__all__ = ["TuneSettings", "Tuned", "refuse_overlap", "split", "tune"]
