"""Walks that the package makes itself."""

from pedjax.simulation.scenarios import Scenario
from pedjax.simulation.world import Simulated, simulate

__all__ = ["Scenario", "Simulated", "simulate"]
