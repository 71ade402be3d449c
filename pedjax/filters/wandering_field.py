"""The field as a state: a field of the place that wanders, and with it what the magnetometer adds.

    reading = h + Cᵀ (B + d) + noise

B `m` is the field in navigation axes, which may walk at random; d `d`, if wanted, a deviation from it that
comes back, of a standard deviation and a correlation time (Gauss-Markov: steel that is passed by); h `h`, if
wanted, the hard iron of whatever hangs in the same pocket, in body axes. They are states of the filter's own
covariance, beside attitude and bias, so that all that is not known of a reference is told to it: this form
alone of the three is honest where the field changes along the way.

Munoz Diaz (2017) has no such state; the prototype of both lies in Afzal's quasi-static fields.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.filters import covariance
from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Opening
from pedjax.filters.kalman import Rows
from pedjax.lanes import align, constant, eye, hypotenuse, matmul, matmul_t, matvec, transpose
from pedjax.parameters import group, leaf, parameters, setting
from pedjax.rotations import skew

_KIT = "kit choice"


def _along(axis: str) -> Any:
    return leaf(
        0.0, unit="uT", low=-2000.0, high=2000.0, scale="linear", source="0: nothing is known",
        meaning=f"First hard iron along the body's {axis}; raised, as much more of the reading is taken off.",
    )  # fmt: skip


@parameters
class Iron:
    """Hard iron in body axes, as it is known before the walk."""

    x: Array = _along("x")
    y: Array = _along("y")
    z: Array = _along("z")


@parameters
class Wandering:
    """How the field of the place, its deviation and the hard iron may change, and how they begin."""

    sigma: Array = leaf(
        5.0, unit="uT", low=1e-3, high=200.0, source=_KIT, tune=True,
        meaning="Standard deviation of the first field along each axis; raised, early readings change it "
        "more.",
    )  # fmt: skip
    walk: Array = leaf(
        1e-3, unit="uT/sqrt(s)", low=1e-6, high=100.0, source=_KIT, tune=True,
        meaning="How fast the field of the place wanders; raised, it follows what is passed, and holds the "
        "heading less.",
    )  # fmt: skip
    deviates: bool = setting(
        True, source=_KIT,
        meaning="Whether there is a deviation from the field of the place, which comes back to zero.",
    )  # fmt: skip
    deviation: Array = leaf(
        1.5, unit="uT", low=1e-3, high=200.0, source=_KIT, tune=True, when={"deviates": True},
        meaning="Standard deviation of what steel along the way adds to the field; raised, each reading "
        "holds the heading less.",
    )  # fmt: skip
    deviation_time: Array = leaf(
        3.0, unit="s", low=0.05, high=1e4, source=_KIT, tune=True, when={"deviates": True},
        meaning="For how long a deviation of the field lasts; raised, readings of the same seconds count as"
        " one.",
    )  # fmt: skip
    iron: bool = setting(
        False, source=_KIT,
        meaning="Whether the hard iron of the sensor's surroundings is estimated, too.",
    )  # fmt: skip
    iron_sigma: Array = leaf(
        10.0, unit="uT", low=1e-3, high=1000.0, source=_KIT, tune=True, when={"iron": True},
        meaning="Standard deviation of the first hard iron along each axis; raised, early readings change "
        "it more.",
    )  # fmt: skip
    iron_walk: Array = leaf(
        1e-2, unit="uT/sqrt(s)", low=1e-6, high=100.0, source=_KIT, when={"iron": True},
        meaning="How fast the hard iron may change; raised, its estimate follows sooner and is noisier.",
    )  # fmt: skip
    iron_prior: Iron = group(Iron, when={"iron": True})
    start: str = setting(
        "first", choices=("first", "expected"), source=_KIT,
        meaning="The first field: that of the levelling stretch, or the one looked up for the place, to "
        "which the yaw is turned once a reading is like it.",
    )  # fmt: skip
    level: Array = leaf(
        22.5, unit="uT", low=0.1, high=100.0, source=f"{_KIT}: Grenoble", when={"start": "expected"},
        meaning="Horizontal part of the field that is expected, to the north; raised, a first reading must "
        "have more of it.",
    )  # fmt: skip
    down: Array = leaf(
        38.0, unit="uT", low=-100.0, high=100.0, scale="linear", source=f"{_KIT}: Grenoble",
        when={"start": "expected"},
        meaning="Downward part of the field that is expected; raised, a first reading must have more of it.",
    )  # fmt: skip
    tolerance: Array = leaf(
        8.0, unit="uT", low=0.1, high=100.0, source=_KIT, when={"start": "expected"},
        meaning="How far level and downward parts of a reading may be from the expected ones to set the yaw; "
        "raised, it is set sooner.",
    )  # fmt: skip
    yaw_sigma: Array = leaf(
        0.02, unit="rad", low=1e-4, high=3.0, source=_KIT, when={"start": "expected"},
        meaning="Standard deviation of the yaw once it is set, beside that of the field; raised, next "
        "readings turn it more.",
    )  # fmt: skip


class Fields(NamedTuple):
    """Estimates: the `field (3, *L)` of the place, µT in navigation axes, its `deviation (3, *L)`, the `iron
    (3, *L)`, µT in body axes, both zero where they are not wanted, and `aligned (*L)`, 1 once the yaw goes by
    it."""

    field: Array
    deviation: Array
    iron: Array
    aligned: Array


def start(q: Wandering, opening: Opening, attitude: Array, P: Covariance) -> tuple[Fields, Covariance]:
    """The first estimates, and P with their states."""
    zero = jnp.zeros_like(attitude[0])
    iron = zero
    deviations = {"m": q.sigma + zero}
    if q.deviates:
        deviations["d"] = q.deviation + zero
    if q.iron:
        iron = jnp.stack([x + zero[0] for x in (q.iron_prior.x, q.iron_prior.y, q.iron_prior.z)])
        deviations["h"] = q.iron_sigma + zero
    if q.start == "expected":
        field = jnp.stack([zero[0], q.level + zero[0], zero[0] - q.down])
        aligned = zero[0]
    else:
        reading, known = _first_reading(opening, zero)
        field = matvec(attitude, reading - iron)
        aligned = known + zero[0]
    return Fields(field, zero, iron, aligned), covariance.extended(P, deviations)


def _first_reading(opening: Opening, zero: Array) -> tuple[Array, Array]:
    """Mean over the levelling samples that have one, and whether any has."""
    assert opening.field is not None
    known = (opening.still > 0)[:, None] & jnp.isfinite(opening.field).all(axis=1, keepdims=True)
    count = jnp.sum(known, axis=0)
    mean = jnp.sum(jnp.where(known, opening.field, 0.0), axis=0) / jnp.maximum(count, 1)
    lanes = zero.ndim - 1
    some = align((count[0] > 0).astype(zero.dtype), 0, lanes)
    return align(mean, 1, lanes) + zero, some


def evolved(q: Wandering, fields: Fields, P: Covariance, dt: Array) -> tuple[Fields, Covariance]:
    """Over `dt` s."""
    one = eye(3, dt)
    F: dict[str, Any] = {}
    Q = {"m": q.walk**2 * dt * one}
    if q.deviates:
        keep = jnp.exp(-dt / q.deviation_time)
        F["d"], Q["d"] = {"d": keep}, q.deviation**2 * (1 - keep * keep) * one
        fields = fields._replace(deviation=keep * fields.deviation)
    if q.iron:
        Q["h"] = q.iron_walk**2 * dt * one
    return fields, covariance.predict(P, F, Q)


def rows(q: Wandering, fields: Fields, attitude: Array, reading: Array, sigma: Array) -> Rows:
    """The `reading (3, *L)` µT of standard deviation `sigma (*L)` against h + Ĉᵀ (B + d).

    The slope on t has B alone: d is in the axes of the attitude as it is estimated. All its directions are
    alike, so that it may be, and an estimate of d, which comes and goes, cannot pass for a direction that
    tells of the yaw: with B + d a filter at a pole believed in a bias that was wrong by a hundred sigmas.
    """
    field = fields.field + fields.deviation
    back = transpose(attitude)
    H: dict[str, Array | None] = {"t": matmul(back, skew(fields.field)), "m": back}
    if q.deviates:
        H["d"] = back
    if q.iron:
        H["h"] = None
    z = reading - fields.iron - matvec(back, field)
    return Rows(z, sigma * sigma * eye(3, sigma), H)


def corrected(fields: Fields, correction: dict[str, Array]) -> Fields:
    """With what a correction says of them."""

    def added(x: Array, letter: str) -> Array:
        return x + correction[letter] if letter in correction else x

    return Fields(
        added(fields.field, "m"), added(fields.deviation, "d"), added(fields.iron, "h"), fields.aligned
    )


def begun(fields: Fields, attitude: Array, reading: Array, known: Array) -> Fields:
    """Where there was no reading to start from, the first one there is gives the field of the place."""
    now = (known > 0) & (fields.aligned < 0.5)
    field = jnp.where(now, matvec(attitude, reading - fields.iron), fields.field)
    return fields._replace(field=field, aligned=jnp.where(now, 1.0, fields.aligned))


def aligning(
    q: Wandering, fields: Fields, attitude: Array, P: Covariance, reading: Array, known: Array
) -> tuple[Fields, Covariance, Array]:
    """Where the yaw is not set and the reading is as expected, the turn `(3, *L)` about up that sets it, and
    P after it: errors of attitude and velocity are in navigation axes and turn with them, and the yaw is as
    sure as the settings say and owes nothing to any other state."""
    seen = matvec(attitude, reading - fields.iron)
    level = hypotenuse(seen[0], seen[1], small=1e-12)
    wanted = hypotenuse(fields.field[0], fields.field[1], small=1e-12)
    near = (jnp.abs(level - wanted) < q.tolerance) & (jnp.abs(seen[2] - fields.field[2]) < q.tolerance)
    now = near & (known > 0) & (fields.aligned < 0.5)
    turn = jnp.arctan2(fields.field[1], fields.field[0] + 1e-12) - jnp.arctan2(seen[1], seen[0] + 1e-12)
    angle = jnp.where(now, rotations.wrap(turn), 0.0)
    up = constant(np.array([0.0, 0.0, 1.0]), angle)
    U, tilt = rotations.exp(angle * up), 1.0 - up
    own = "e" if "ee" in P else "t"
    mended = {}
    for name, block in P.items():
        new = block
        for side, letter in enumerate(name):
            if letter in "tv":
                new = matmul(U, new) if side == 0 else matmul_t(new, U)
        for side, letter in enumerate(name):
            if letter == own:
                new = new * (tilt[:, None] if side == 0 else tilt[None, :])
        if name == 2 * own:
            new = new + q.yaw_sigma**2 * up[:, None] * up[None, :]
        mended[name] = jnp.where(now, new, block)
    return fields._replace(aligned=jnp.where(now, 1.0, fields.aligned)), mended, angle * up
