"""Tilt: while the foot stands, the specific force points up, which tells roll and pitch (Zhang, Eq. 19-22).

The error t of the attitude is a small rotation in navigation axes. With f the unit force that the attitude
turned into them, f = (−t_y, t_x, 1) to first order, so that (f_y, −f_x) measures (t_x, t_y), wherever the
walker heads. Roll and pitch, which Zhang takes, need the block

    (δφ, δθ) = [[cos ψ / cos θ, sin ψ / cos θ], [−sin ψ, cos ψ]] (t_x, t_y);

printed (Eq. 29) is the identity, which on the way back, at ψ = 180 degrees, turns the tilt away from the
truth.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.filters import measurements
from pedjax.parameters import leaf, parameters, setting


@parameters
class Tilt:
    """Which rows, and how far they are believed."""

    rows: str = setting(
        "none", choices=("none", "level", "euler", "printed"), source="none: not part of IEZ",
        meaning="How a standing foot's force corrects the tilt: not, in level axes, by roll and pitch, or by "
        "these with the identity that Zhang prints.",
    )  # fmt: skip
    sigma: Array = leaf(
        0.05, unit="rad", low=1e-5, high=10.0, source="kit choice: 0.5 m/s^2 of a standing foot", tune=True,
        meaning="Standard deviation of roll and pitch by the force at a sample; raised, stances correct the "
        "tilt less.",
    )  # fmt: skip


def _step(p: Any, site: Any, state: Any, seen: Seen) -> Measured:
    nav, force = seen.estimate, seen.sample.force
    sigma: Array = p.tilt.sigma
    if p.tilt.rows == "level":
        rows = measurements.level(nav, force, sigma)
    else:
        roll, pitch = rotations.tilt(force)
        rows = measurements.euler(nav, (roll, pitch), sigma, p.tilt.rows == "printed")
    return Measured(state, rows, seen.gates["stance"].weight * jnp.ones_like(rows.innovation[0]))


TILT = Aid(
    name="tilt",
    groups=(("tilt", Tilt),),
    reads=("stance",),
    is_on=lambda p: p.tilt.rows != "none",
    step=_step,
)
"""Roll and pitch of a standing foot by its specific force, as measured."""
