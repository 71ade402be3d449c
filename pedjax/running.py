"""One recording through one system: the track."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import filtering, parameters, rotations
from pedjax.detectors.segments import clean_stance, stance_id
from pedjax.detectors.stance import window_samples
from pedjax.errors import InputError
from pedjax.packing import Walk, bucket, nominal_rate, prepare
from pedjax.packing import walk as as_walk
from pedjax.recording import Clock, Recording
from pedjax.system import Inputs, Output, System
from pedjax.systems import system as find_system

_LONG_GAP = 3.0  # s without an update after which an inertial filter has lost its way


@dataclass(frozen=True)
class Track:
    """What a run puts out, numpy, time first.

    `time (T,)` s, `position`, `velocity (T, 3)` m, m/s in ENU from the start at the origin, `attitude
    (T, 3, 3)` body to navigation, `euler (T, 3)` roll, pitch, yaw in rad, `gyroscope_bias`,
    `accelerometer_bias (T, 3)`, `stance (T,)` weight of the zero-velocity update, `log_ratio (T,)` of the
    stance statistic over its threshold, `sigma (T, 15)` standard deviations (attitude, gyroscope bias,
    position, velocity, accelerometer bias), `more` what the system says beside, by name, `(T, ...)`.
    `healthy` is false where the filter left the numbers, or never found the foot still; `warnings` says what
    to look at.
    """

    name: str
    system: str
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    euler: np.ndarray
    gyroscope_bias: np.ndarray
    accelerometer_bias: np.ndarray
    stance: np.ndarray
    log_ratio: np.ndarray
    sigma: np.ndarray
    healthy: bool
    warnings: tuple[str, ...]
    more: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def distance(self) -> float:
        """Horizontal path length in m, from positions 0.1 s apart."""
        step = max(round(0.1 / float(np.median(np.diff(self.time)))), 1)
        path = np.concatenate([self.position[::step, :2], self.position[-1:, :2]])
        return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())

    def stances(self, merge_s: float = 0.05, drop_s: float = 0.08) -> np.ndarray:
        """`(T,)` int: 0, 1, 2, ... in each stance, −1 outside, after gaps shorter than `merge_s` are filled
        and stances shorter than `drop_s` dropped (not causal)."""
        dt = np.diff(self.time, prepend=self.time[0])
        return np.asarray(
            stance_id(clean_stance(jnp.asarray(self.stance > 0.5), jnp.asarray(dt), merge_s, drop_s))
        )


@partial(jax.jit, static_argnames="system")
def _scan(system: System, params: Any, inputs: Inputs) -> Output:
    return filtering.scan(system, params, inputs.samples, system.start(params, inputs.opening))[1]


def check_walk(system: System, params: Any, walk: Walk) -> None:
    """Refuse a recording shorter than the detector's window, or without a sensor that the system needs."""
    window = window_samples(params.stance, nominal_rate(walk.imu))
    if system.magnetic:
        field = walk.imu.magnetic_field
        if field is None:
            raise InputError(
                f"{walk.name}: the system '{system.name}' needs a magnetometer and this sensor has none; "
                "choose another --sensor, or another --system (iez)"
            )
        lost = np.isnan(field).any(axis=1)
        if lost.any():
            begins = walk.imu.time[lost.argmax()] - walk.imu.time[0]
            raise InputError(
                f"{walk.name}: the magnetometer has no readings for {walk.imu.dt[lost].sum():.1f} s, the "
                f"first time {begins:.1f} s after the start; use another recording, or --system iez"
            )
    if len(walk.imu.time) < 2 * window:
        raise InputError(
            f"{walk.name}: {len(walk.imu.time)} samples are too few for a stance window of {window} "
            f"({params.stance.detector}); record longer or shorten stance.{params.stance.detector}.window_s"
        )


def run(
    recording: Recording,
    system: str | System = "iez",
    params: Any = None,
    *,
    sensor: str = "foot",
    clock: Clock | None = None,
) -> Track:
    """Run a system over a recording (`params`: default the published ones) in JAX's current precision."""
    chosen = find_system(system)
    params = chosen.defaults() if params is None else params
    walk = as_walk(recording, sensor, clock)
    check_walk(chosen, params, walk)
    dtype = jnp.result_type(float)
    length = len(walk.imu.time)
    params = parameters.cast(params, dtype)
    inputs = prepare(chosen, params, walk.imu, dtype, bucket(length))
    output = jax.tree.map(lambda x: np.asarray(x)[:length], _scan(chosen, params, inputs))
    nav = output.navigation
    euler = np.asarray(jax.jit(rotations.to_euler)(jnp.moveaxis(jnp.asarray(nav.attitude), 0, -1))).T
    notes = _warnings(walk, output)
    if not sensor.startswith("foot"):
        notes.append(f"sensor '{sensor}' is not on a foot, where alone zero-velocity updates hold")
    return Track(
        name=recording.name,
        system=chosen.name,
        time=walk.imu.time,
        position=nav.position,
        velocity=nav.velocity,
        attitude=nav.attitude,
        euler=euler,
        gyroscope_bias=nav.gyroscope_bias,
        accelerometer_bias=nav.accelerometer_bias,
        stance=output.stance,
        log_ratio=output.log_ratio,
        sigma=np.sqrt(np.maximum(output.variances, 0.0)),
        healthy=bool(output.healthy[-1]) and bool(output.stance.max() > 0.5),
        warnings=tuple(notes),
        more=output.more,
    )


def _warnings(walk: Walk, output: Output) -> list[str]:
    notes = []
    if not output.healthy[-1]:
        first = int(np.argmin(output.healthy))
        notes.append(
            f"the filter left the numbers at {walk.imu.time[first]:.2f} s (not finite, or no covariance)"
        )
    still = output.stance > 0.5
    if not still.any():
        notes.append("no stance at all: raise the detector's threshold, or is the sensor on the foot?")
        return notes
    at = np.flatnonzero(still)
    edges = np.concatenate([[0], at, [len(still) - 1]])
    gaps = np.diff(walk.imu.time[edges])
    if gaps.max() > _LONG_GAP:
        start = walk.imu.time[edges[int(gaps.argmax())]]
        notes.append(f"{gaps.max():.1f} s without stance from {start:.1f} s on: the position drifts there")
    if still.mean() > 0.97:
        notes.append("still almost all the time: lower the detector's threshold, or nobody walked")
    return notes
