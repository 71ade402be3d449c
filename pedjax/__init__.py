"""Differentiable pedestrian dead reckoning in JAX."""

from pedjax.errors import InputError
from pedjax.evaluation import landmark_errors, roc
from pedjax.recording import Inertial, Landmarks, Recording, Sensor, Stream, Truth, inertial
from pedjax.running import Track, run
from pedjax.runtime import avoid_wrong_sums, configure
from pedjax.scoring import Score, evaluate
from pedjax.simulation import Scenario, Simulated, simulate
from pedjax.sources import read_any as read
from pedjax.sweeping import Sweep, design, sweep
from pedjax.systems import SYSTEMS, system
from pedjax.tuning import Tuned, TuneSettings, split, tune

__version__ = "0.1.0"

avoid_wrong_sums()

__all__ = [
    "SYSTEMS", "Inertial", "InputError", "Landmarks", "Recording", "Scenario", "Score", "Sensor", "Simulated",
    "Stream", "Sweep", "Track", "Truth", "TuneSettings", "Tuned", "__version__", "configure", "design",
    "evaluate", "inertial", "landmark_errors", "read", "roc", "run", "simulate", "split", "sweep", "system",
    "tune",
]  # fmt: skip
