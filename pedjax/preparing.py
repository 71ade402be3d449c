"""From a walk to a system's inputs: padded to few lengths, and prepared once for all parameter sets."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax.recording import Inertial
from pedjax.shapes import bucket
from pedjax.system import Inputs, Signals, System
from pedjax.walks import Walk


@partial(jax.jit, static_argnames=("system", "rate_hz"))
def _prepare(
    system: System, parameters: Any, sensors: dict[str, Signals], dt: Array, rate_hz: float, length: int
) -> Inputs:
    return system.prepare(parameters, sensors, dt, rate_hz, length)


def prepare(system: System, parameters: Any, walk: Walk, dtype: Any, padded: int) -> Inputs:
    """A system's inputs for a walk padded to a length, in the host's memory, where cutting them and putting
    them together compiles nothing: the last sample repeated with dt = 0."""
    n = len(walk)
    extra = bucket(padded, parts=2) - n  # compiling costs more than preparing what is thrown away

    def pad(x: np.ndarray) -> Array:
        return jnp.asarray(np.concatenate([x, np.repeat(x[-1:], extra, axis=0)]), dtype)

    def signals(imu: Inertial, magnetic: bool) -> Signals:
        field = pad(imu.magnetic_field) if magnetic and imu.magnetic_field is not None else None
        return Signals(pad(imu.specific_force), pad(imu.angular_rate), field)

    dt = jnp.asarray(np.concatenate([walk.imu.dt, np.zeros(extra)]), dtype)
    sensors = {need.role: signals(walk.sensors[need.role], need.field) for need in system.needs}
    found = _prepare(system, parameters, sensors, dt, walk.rate_hz, n)
    samples, opening = jax.tree.map(np.asarray, (found.samples, found.opening))
    return Inputs(jax.tree.map(lambda x: x[:padded], samples), opening)
