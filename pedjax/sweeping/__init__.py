"""Sweeping: thousands of parameter sets side by side."""

from pedjax.sweeping.designs import DESIGNS, design
from pedjax.sweeping.engine import Sweep, sweep

__all__ = ["DESIGNS", "Sweep", "design", "sweep"]
