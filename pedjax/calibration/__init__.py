"""Magnetometer calibration: hard and soft iron from a turned sensor (3-D) or a walked loop (2-D)."""

from pedjax.calibration.magnetometer import Calibration, apply, uncalibrated

__all__ = ["Calibration", "apply", "uncalibrated"]
