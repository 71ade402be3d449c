"""Munoz Diaz's filter (2017): Euler angles and gyroscope biases, six states.

The angles e = (roll, pitch, yaw) are the state, the rotation only a way to predict them (Eq. 4-7, corrected):

    C(e') = C(e) A,  A = I + (sin σ/σ) B + ((1 − cos σ)/σ²) B²,  B = [(ω − b) dt ×],  σ = |ω − b| dt,
    b' = c b,  c = e^(−dt/τ).

(Printed are B_{k+1} in A, and − cos σ for 1 − cos σ.) F = ∂(e', b')/∂(e, b) comes from the derivative of just
that, and the gyroscope's noise enters through J = ∂e'/∂(rotation of the body). What an aid measures as a
small rotation t in navigation axes is turned into angles by t = T δe.

At a pitch of ±90 degrees roll and yaw are one: from `GIMBAL` on the status says so. A phone in a pocket hangs
at 79 to 89 degrees; `orientation` is this filter for whoever has one.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.filters import covariance
from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Filter, Opening, Sample
from pedjax.filters.first_bias import rest_asked
from pedjax.filters.kalman import Rows
from pedjax.filters.orientation import OrientationParameters, Oriented, levelled_start
from pedjax.filters.orientation import correct as corrected
from pedjax.lanes import dot, eye, matmul, matmul_t, slopes
from pedjax.system import Status

GIMBAL = 1.4835298641951802
"""85 degrees of pitch, beyond which the angles are not trusted."""


def _from(angles: Array) -> Array:
    return rotations.from_euler(angles[0], angles[1], angles[2])


def angle_block(attitude: Array) -> Array:
    """T `(3, 3, *L)` with t = T δ(roll, pitch, yaw): columns are the axes about which each angle turns, seen
    in navigation axes."""
    _, pitch, yaw = rotations.to_euler(attitude)
    cos, sin, none = jnp.cos(yaw), jnp.sin(yaw), 0 * yaw
    return jnp.stack(
        [
            jnp.stack([jnp.cos(pitch) * cos, -sin, none]),
            jnp.stack([jnp.cos(pitch) * sin, cos, none]),
            jnp.stack([-jnp.sin(pitch), none, none + 1]),
        ]
    )


def _start(p: OrientationParameters, opening: Opening) -> tuple[Oriented, Covariance]:
    attitude, bias, deviations = levelled_start(p, opening)
    P = covariance.diagonal({"e": deviations["t"], "g": deviations["g"]})
    return Oriented(attitude, bias, jnp.zeros_like(bias)), P


def _predict(
    p: OrientationParameters, estimate: Oriented, P: Covariance, sample: Sample
) -> tuple[Oriented, Covariance]:
    dt, rate = sample.dt, sample.rate
    angles, bias = rotations.to_euler(estimate.attitude), estimate.gyroscope_bias

    def turned(angles: Array, bias: Array) -> Array:
        return rotations.to_euler(matmul(_from(angles), rotations.exp((rate - bias) * dt)))

    new, by_angles = slopes(lambda e: turned(e, bias), angles)
    _, by_bias = slopes(lambda b: turned(angles, b), bias)
    attitude = _from(new)
    _, J = slopes(lambda u: rotations.to_euler(matmul(attitude, rotations.exp(u))), jnp.zeros_like(new))
    keep = jnp.exp(-dt / p.process.gyroscope_bias_time)
    clean = rate - bias
    spread = p.process.gyroscope**2 + p.process.gyroscope_scale**2 * dot(clean, clean)
    F = {"e": {"e": by_angles, "g": by_bias}, "g": {"g": keep}}
    Q = {"e": spread * dt * matmul_t(J, J), "g": p.process.gyroscope_bias**2 * dt * eye(3, keep)}
    return Oriented(attitude, keep * bias, estimate.position), covariance.predict(P, F, Q)


def _correct(estimate: Oriented, correction: dict[str, Array]) -> Oriented:
    if "e" in correction:
        angles = rotations.to_euler(estimate.attitude) + correction["e"]
        estimate = estimate._replace(attitude=_from(angles))
    return corrected(estimate, correction)


def _rows(estimate: Oriented, rows: Rows) -> Rows:
    """Rows on t as rows on the angles: H_e = H_t T."""
    if "t" not in rows.H:
        return rows
    T, H = angle_block(estimate.attitude), rows.H["t"]
    rest = {s: matrix for s, matrix in rows.H.items() if s != "t"}
    return rows._replace(H={"e": T if H is None else matmul(H, T), **rest})


def _status(estimate: Oriented) -> Array:
    level = jnp.abs(estimate.attitude[2, 0]) < jnp.sin(GIMBAL)
    return jnp.where(level, Status.HEALTHY, Status.GIMBAL)


EULER = Filter(
    name="euler",
    parameters=OrientationParameters,
    opening_s=lambda p: p.initial.levelling_s,
    start=_start,
    predict=_predict,
    correct=_correct,
    states=(("attitude", "e"), ("gyroscope_bias", "g")),
    rest_s=rest_asked,
    rows=_rows,
    status=_status,
)
"""Euler angles and gyroscope biases, as published."""
