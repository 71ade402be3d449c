"""Absolute gravity update: where the force is gravity alone, it tells roll and pitch (Munoz Diaz 2017, Eq.
12-14).

The zero-acceleration detector holds | |f| − g | against a threshold. A pocket never rests, but twice a stride
the thigh's acceleration is small. Rows are roll and pitch of the force, with its noise turned into angles by
their derivative, or the force itself, f = Ĉᵀ (I − [t×]) g e_up, which is the same to first order but where
the sensor hangs upside down or pitched by 90 degrees, and there it still holds. (The third number, the length
of the force, says nothing of t.)"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.filters.kalman import Rows
from pedjax.filters.measurements import euler_block
from pedjax.gates import SoftGate, gate, log_positive
from pedjax.lanes import constant, eye, matmul, matmul_t, matvec, norm, slopes, transpose
from pedjax.parameters import leaf, parameters, setting
from pedjax.rotations import skew
from pedjax.system import Gated


@parameters
class ZeroAcceleration(SoftGate):
    """When the force is gravity alone, and how far it is believed then."""

    threshold: Array = leaf(
        0.3, unit="m/s^2", low=1e-3, high=20.0, source="kit choice; Munoz Diaz 2017: not printed", tune=True,
        point=True,
        meaning="How far the force may be from gravity's size and still pass as gravity alone; raised, more "
        "samples level the attitude, and with larger errors.",
    )  # fmt: skip
    sigma: Array = leaf(
        0.3, unit="m/s^2", low=1e-3, high=50.0, tune=True,
        source="kit choice: what the threshold lets through; Munoz Diaz 2017: the accelerometer's noise",
        meaning="Standard deviation along each axis of a force that passed; raised, it levels the attitude "
        "less.",
    )  # fmt: skip
    rows: str = setting(
        "vector", choices=("vector", "angles"), source="angles: Munoz Diaz 2017",
        meaning="Whether the force is held against gravity as a vector, or its roll and pitch against the "
        "attitude's.",
    )  # fmt: skip


def _by_angles(attitude: Array, force: Array, sigma: Array) -> Rows:
    measured, J = slopes(lambda f: jnp.stack(rotations.tilt(f)), force)
    found = rotations.to_euler(attitude)[:2]
    return Rows(rotations.wrap(measured - found), sigma**2 * matmul_t(J, J), {"t": euler_block(attitude)[:2]})


def _by_vector(attitude: Array, force: Array, gravity: Array, sigma: Array) -> Rows:
    up = constant(np.array([0.0, 0.0, 1.0]), force[0]) * gravity + 0 * force
    back = transpose(attitude)
    H = matmul(back, skew(up))
    return Rows(force - matvec(back, up), sigma**2 * eye(3, force[0]), {"t": H})


def _step(p: Any, site: Any, state: Any, seen: Seen) -> Measured:
    q: ZeroAcceleration = p.zero_acceleration
    C = seen.estimate.attitude
    force = seen.sample.force + 0 * C[0]
    ratio = log_positive(jnp.abs(norm(force) - p.gravity)) - jnp.log(q.threshold)
    weight = gate(ratio, q.width, q.straight_through)
    angles = q.rows == "angles"
    rows = _by_angles(C, force, q.sigma) if angles else _by_vector(C, force, p.gravity, q.sigma)
    weight = weight * (seen.sample.dt > 0)
    return Measured(state, rows, weight, Gated(weight, ratio))


GRAVITY_UPDATE = Aid(
    name="gravity_update",
    groups=(("zero_acceleration", ZeroAcceleration),),
    gate="gravity",
    step=_step,
)
"""The force as the direction of up, where it is gravity alone."""
