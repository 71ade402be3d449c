"""Walks that the package makes itself."""

from pedjax.simulation.demo import demo_walk

__all__ = ["demo_walk"]
