"""Pictures: each function draws one matplotlib figure and returns it."""

from pedjax.plots.recordings import raw_signals
from pedjax.plots.results import field_changes, roc_curves, tuning_history
from pedjax.plots.tracks import gate_over_signals, trajectory

__all__ = ["field_changes", "gate_over_signals", "raw_signals", "roc_curves", "trajectory", "tuning_history"]
