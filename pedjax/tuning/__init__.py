"""Tuning: the gradient of a landmark error with respect to any parameter, through the whole filter."""

from pedjax.tuning.augment import Augment, disturbed
from pedjax.tuning.loop import Tuned, TuneSettings, tune
from pedjax.tuning.split import refuse_overlap, split

__all__ = ["Augment", "TuneSettings", "Tuned", "disturbed", "refuse_overlap", "split", "tune"]
