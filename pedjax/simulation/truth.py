"""What is known of a made walk."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pedjax.simulation.motion import Motion


class SensorTruth(NamedTuple):
    """What is true of one sensor at each of its samples, before any of its errors: `time (T,)` s, the
    `motion`, its errors `gyroscope_bias` and `accelerometer_bias (T, 3)`, the `magnetic_field (T, 3)` in
    microtesla in navigation axes, the `disturbance (T, 3)` that is not the background's, and whether the foot
    stands, `stance (T,)`."""

    time: np.ndarray
    motion: Motion
    gyroscope_bias: np.ndarray
    accelerometer_bias: np.ndarray
    magnetic_field: np.ndarray
    disturbance: np.ndarray
    stance: np.ndarray
