"""A heading beside a known disturbance: the triangle of earth, disturbance and what is measured (Wang 2018).

Of a disturbance that was found at the start, and that is taken to be where the foot now is,

- `magnitude` (Eq. 7-8) trusts the length δ of its level part alone. Earth H, disturbance δ and the measured M
  make a triangle, so that the undisturbed field lies on either side of the measured one by

      acos K,   K = (M² + H² − δ²)/(2 H M).

  Both sides explain the data; the gyroscope says which, by how likely each innovation is: a choice of the
  nearer one is the limit of `softness` 0. (Printed are arc sines, which keep one side and lose the quadrant:
  right in a quarter of all cases.)
- `vector` trusts its direction, too: what is to be seen is earth and disturbance together.

With the disturbance of the own alignment `vector` is the plain compass, exactly, because that alignment had
turned the disturbed field to north; it has content where the first yaw comes from elsewhere. Neither holds
where the disturbance is another one, as it is a few metres on.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.gates import SoftGate, gate, log_positive
from pedjax.lanes import hypotenuse, root
from pedjax.parameters import leaf, parameters, setting

_WANG = "Wang 2018"
_KIT = "kit choice"


@parameters
class Compensation(SoftGate):
    """What of the start's disturbance is taken off."""

    mode: str = setting(
        "none", choices=("none", "magnitude", "vector"), source="none; magnitude: Wang 2018",
        meaning="What of the disturbance at the start a later heading allows for: nothing, the size of its "
        "level part, or all of it.",
    )  # fmt: skip
    softness: Array = leaf(
        1.0, unit="1", low=1e-3, high=100.0, source=f"{_KIT}: by likelihood", tune=True,
        when={"mode": "magnitude"},
        meaning="How far the side of the triangle that the gyroscope finds less likely counts; towards 0 the "
        "nearer side alone does, raised both count alike.",
    )  # fmt: skip
    least: Array = leaf(
        0.1, unit="1", low=1e-3, high=1.0, source=f"{_KIT}: below it is worse than none",
        when={"mode": "magnitude"},
        meaning="Disturbance over the earth's level field below which nothing is compensated; raised, only "
        "large ones are.",
    )  # fmt: skip


def sides(measured: Array, earth: Array, disturbance: Array, sigma: Array) -> tuple[Array, Array]:
    """acos K `(*L)` rad, and its variance rad² for noise of `sigma` µT in the measured length.

    The slope of acos is unbounded where the triangle closes, K = ±1. There the variance goes over to that of
    √(2 |1 − K|), and where noise opens it, |K| > 1, it grows with what is missing; the angle is 0 or π.
    """
    measured = jnp.maximum(measured, 1e-6)
    k = (measured**2 + earth**2 - disturbance**2) / (2 * earth * measured)
    inside = 1 - k * k
    angle = jnp.arctan2(root(inside), k)
    slope = (measured**2 - earth**2 + disturbance**2) / (2 * earth * measured**2)
    of_k = hypotenuse(slope * sigma, small=1e-18)
    missing = jnp.maximum(jnp.abs(k) - 1, 0.0)
    return angle, of_k * of_k / (jnp.maximum(inside, 0.0) + of_k) + 2 * missing


def chosen(
    p: Compensation, innovation: Array, variance: Array, level: tuple[Array, Array, Array], sigma: Array
) -> tuple[Array, Array]:
    """The innovation of a heading beside a disturbance, and the variance rad² that the choice adds.

    `innovation (*L)` rad is the plain compass's, `variance` of it and of the filter's yaw together; `level`
    are the horizontal lengths in µT of what is measured, of the earth's field and of the disturbance, with
    noise of `sigma` µT in the first.
    """
    measured, earth, disturbance = level
    angle, own = sides(measured, earth, disturbance, sigma)
    left, right = rotations.wrap(innovation - angle), rotations.wrap(innovation + angle)
    far = (left * left - right * right) / (2 * (variance + own))
    of_right = jax.nn.sigmoid(far / p.softness)
    apart = right - left  # not twice the angle: sides that are half a turn away meet there
    moved = left + of_right * apart
    between = of_right * (1 - of_right) * apart * apart
    ratio = log_positive(disturbance / jnp.maximum(earth, 1e-6))
    on = gate(jnp.log(p.least) - ratio, p.width, p.straight_through)
    by = rotations.wrap(moved - innovation)
    return rotations.wrap(innovation + on * by), on * (own + between)
