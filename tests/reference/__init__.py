"""Slow, plain numpy oracles, written from the formulas and sharing no code with the package under test."""
