"""Differentiable pedestrian dead reckoning in JAX."""

from pedjax.aids import aided, register_aid
from pedjax.detection import roc
from pedjax.detectors import register_field_detector, register_stance_detector
from pedjax.errors import InputError
from pedjax.evaluation import landmark_errors
from pedjax.evaluation.scores import ScoreKind, register_loss
from pedjax.recording import Inertial, Landmarks, Recording, Sensor, Stream, Truth, inertial
from pedjax.running import Track, run
from pedjax.runtime import avoid_wrong_sums, configure
from pedjax.scoring import Score, evaluate
from pedjax.simulation import Scenario, Simulated, simulate
from pedjax.sources import read_any as read
from pedjax.sweeping import Sweep, design, sweep
from pedjax.system import Need, System
from pedjax.systems import SYSTEMS, register_system, system
from pedjax.tuning import Augment, Tuned, TuneSettings, split, tune
from pedjax.version import __version__

avoid_wrong_sums()

__all__ = [
    "SYSTEMS", "Augment", "Inertial", "InputError", "Landmarks", "Need", "Recording", "Scenario", "Score",
    "ScoreKind", "Sensor", "Simulated", "Stream", "Sweep", "System", "Track", "Truth", "TuneSettings",
    "Tuned", "__version__", "aided", "configure", "design", "evaluate", "inertial", "landmark_errors", "read",
    "register_aid", "register_field_detector", "register_loss", "register_stance_detector", "register_system",
    "roc", "run", "simulate", "split", "sweep", "system", "tune",
]  # fmt: skip
