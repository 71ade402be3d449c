"""When a foot looks at the magnetic field, and how well it then knows its heading.

A foot looks once in each stance, when it has stood for a moment (or, as an option, at every still sample),
and keeps the last N + 1 looks. Everything is causal, and a state of fixed size.

The field is levelled by the least rotation that turns what should be up, the specific force or the attitude's
own up, to where it is: no Euler angle is taken, so that no mounting is special. Levelled by the force, an
error t of the attitude is left with its part about up alone, and the row of the heading is [0, 0, 1], as Ma
means it. (Of the Euler yaw, which a tilt changes too, it would be [tan θ cos ψ, tan θ sin ψ, 1].)

The force is taken as measured (Ma 2018, Eq. 3-5), without the filter's bias of the accelerometer: zero
velocities, told as more certain than they are while a foot begins to lift, drive that bias to 0.1 m/s² and
more, which in a steep field is degrees of heading. And the first moments of a stance are left out: the jolt
of landing tilts the force by some degrees.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.calibration.magnetometer import AXES, Calibration, corrected
from pedjax.detectors.clock import StanceClock, started, tick
from pedjax.detectors.field import Look, Window, inclination
from pedjax.lanes import constant, dot, matvec
from pedjax.parameters import groups_of, leaf, parameters, setting

_KIT = "kit choice"
_MA = "Ma 2018"
_DEGREE = 0.017453292519943295


@parameters
class Level:
    """Calibration of the levelled field by a walked loop (Ma 2018, Eq. 6-12): W (m − o), W symmetric."""

    ahead: str = setting(
        "x", choices=tuple(AXES), source=f"{_KIT}: x",
        meaning="Body axis whose level direction is the x of the levelled field; any that does not point up "
        "or down.",
    )  # fmt: skip
    offset_x: Array = leaf(
        0.0, unit="uT", low=-200.0, high=200.0, scale="linear", source="0: calibrated",
        meaning="Offset along x, subtracted from the levelled field.",
    )  # fmt: skip
    offset_y: Array = leaf(
        0.0, unit="uT", low=-200.0, high=200.0, scale="linear", source="0: calibrated",
        meaning="Offset along y, subtracted from the levelled field.",
    )  # fmt: skip
    xx: Array = leaf(
        1.0, unit="1", low=0.1, high=10.0, source="1: calibrated",
        meaning="Element xx of W: how much of the levelled field's x is in the corrected x.",
    )  # fmt: skip
    xy: Array = leaf(
        0.0, unit="1", low=-3.0, high=3.0, scale="linear", source="0: calibrated",
        meaning="Elements xy and yx of W: how much of the levelled field's y is in x, and of its x in y.",
    )  # fmt: skip
    yy: Array = leaf(
        1.0, unit="1", low=0.1, high=10.0, source="1: calibrated",
        meaning="Element yy of W: how much of the levelled field's y is in the corrected y.",
    )  # fmt: skip


@parameters
class Body:
    """Calibration of the magnetometer in body axes, K (m − b): the hard iron b, and the rows of K."""

    hard_x: Array = leaf(
        0.0, unit="uT", low=-1e3, high=1e3, scale="linear", source="0: calibrated",
        meaning="Hard iron along x, subtracted from the reading.",
    )  # fmt: skip
    hard_y: Array = leaf(
        0.0, unit="uT", low=-1e3, high=1e3, scale="linear", source="0: calibrated",
        meaning="Hard iron along y, subtracted from the reading.",
    )  # fmt: skip
    hard_z: Array = leaf(
        0.0, unit="uT", low=-1e3, high=1e3, scale="linear", source="0: calibrated",
        meaning="Hard iron along z, subtracted from the reading.",
    )  # fmt: skip
    xx: Array = leaf(
        1.0, unit="1", low=-10.0, high=10.0, scale="linear", source="1: calibrated",
        meaning="Element xx of the matrix K: how much of the reading's x is in the calibrated x.",
    )  # fmt: skip
    xy: Array = leaf(
        0.0, unit="1", low=-10.0, high=10.0, scale="linear", source="0: calibrated",
        meaning="Element xy of the matrix K: how much of the reading's y is in the calibrated x.",
    )  # fmt: skip
    xz: Array = leaf(
        0.0, unit="1", low=-10.0, high=10.0, scale="linear", source="0: calibrated",
        meaning="Element xz of the matrix K: how much of the reading's z is in the calibrated x.",
    )  # fmt: skip
    yx: Array = leaf(
        0.0, unit="1", low=-10.0, high=10.0, scale="linear", source="0: calibrated",
        meaning="Element yx of the matrix K: how much of the reading's x is in the calibrated y.",
    )  # fmt: skip
    yy: Array = leaf(
        1.0, unit="1", low=-10.0, high=10.0, scale="linear", source="1: calibrated",
        meaning="Element yy of the matrix K: how much of the reading's y is in the calibrated y.",
    )  # fmt: skip
    yz: Array = leaf(
        0.0, unit="1", low=-10.0, high=10.0, scale="linear", source="0: calibrated",
        meaning="Element yz of the matrix K: how much of the reading's z is in the calibrated y.",
    )  # fmt: skip
    zx: Array = leaf(
        0.0, unit="1", low=-10.0, high=10.0, scale="linear", source="0: calibrated",
        meaning="Element zx of the matrix K: how much of the reading's x is in the calibrated z.",
    )  # fmt: skip
    zy: Array = leaf(
        0.0, unit="1", low=-10.0, high=10.0, scale="linear", source="0: calibrated",
        meaning="Element zy of the matrix K: how much of the reading's y is in the calibrated z.",
    )  # fmt: skip
    zz: Array = leaf(
        1.0, unit="1", low=-10.0, high=10.0, scale="linear", source="1: calibrated",
        meaning="Element zz of the matrix K: how much of the reading's z is in the calibrated z.",
    )  # fmt: skip


def in_body(p: Body, mag: Array) -> Array:
    """The calibrated field `(3, *L)` in body axes."""
    rows = ((p.xx, p.xy, p.xz), (p.yx, p.yy, p.yz), (p.zx, p.zy, p.zz))
    return jnp.stack(corrected((mag[0], mag[1], mag[2]), (p.hard_x, p.hard_y, p.hard_z), rows))


def calibrated_by(params: Any, calibration: Calibration) -> dict[str, Any]:
    """A calibration as parameters: paths to values, for every group of a tree that is one; empty where none
    is."""
    hard, matrix = np.asarray(calibration.hard_iron, float), np.asarray(calibration.matrix, float)
    offset, level = np.asarray(calibration.level_offset, float), np.asarray(calibration.level_matrix, float)
    body = {f"hard_{a}": float(hard[i]) for i, a in enumerate(AXES)}
    body |= {f"{a}{b}": float(matrix[i, j]) for i, a in enumerate(AXES) for j, b in enumerate(AXES)}
    flat: dict[str, Any] = {"offset_x": float(offset[0]), "offset_y": float(offset[1])}
    flat |= {"xx": float(level[0, 0]), "xy": float(level[0, 1]), "yy": float(level[1, 1])}
    flat |= {"ahead": AXES[calibration.level_ahead]}
    return {
        f"{path}.{name}": value
        for kind, values in ((Body, body), (Level, flat))
        for path in groups_of(params, kind)
        for name, value in values.items()
    }


@parameters
class Looking:
    """When the field is looked at, and what levels it."""

    per: str = setting(
        "step", choices=("step", "sample"), source=_MA,
        meaning="Whether the field is looked at once in each step, while the foot stands, or at every "
        "still sample.",
    )  # fmt: skip
    settle_s: float = setting(
        0.06, source=f"{_KIT}: the jolt of landing",
        meaning="First part of a stance, which its look leaves out; longer, less of the landing's jolt tilts "
        "the field, but short stances have no look.",
    )  # fmt: skip
    dwell_s: float = setting(
        0.06, source=f"{_KIT}: stillness that a look averages",
        meaning="How long the foot must stand after that before its look; longer, more readings are "
        "averaged, but short stances have none.",
    )  # fmt: skip
    gap_s: float = setting(
        0.15, source=f"{_KIT}: movement that ends a stance",
        meaning="How long the foot must move to end a stance; longer, a short gap in a stance does not "
        "bring a second look.",
    )  # fmt: skip
    levelling: str = setting(
        "force", choices=("force", "attitude"), source=f"{_MA}: Eq. 3-5; attitude: kit",
        meaning="What levels the field for a heading: the specific force as measured, or the filter's "
        "attitude.",
    )  # fmt: skip


class Looks(NamedTuple):
    """What is remembered: the `total (3, *L)` µT s of the field in this stance so far, and the `seconds (*L)`
    of it that count, the `clock` of stances, the last looks in `window`, how `many` there were, how many of
    them `follow` each other (at every still sample: in one stance), and the `first` attitude `(3, 3, *L)`,
    from which yaw is counted."""

    total: Array
    seconds: Array
    clock: StanceClock
    window: Window
    many: Array
    follow: Array
    first: Array


def first(attitude: Array, steps: int) -> Looks:
    """Nothing seen yet, by a foot of that `attitude (3, 3, *L)`."""
    like = jnp.zeros_like(attitude[0, 0])
    none = Look(jnp.zeros_like(attitude[0]), like, like, like)
    return Looks(none.field, like, started(like), (none,) * (steps + 1), like, like, attitude)


def levelled(attitude: Array, up: Array, mag: Array, level: Level) -> Array:
    """The field `mag (3, *L)` of a body in navigation axes: turned by its `attitude (3, 3, *L)` and then by
    the least rotation that makes what it takes for `up (3, *L)`, of any length, vertical; with the levelled
    calibration in between. In navigation axes `up` must not point down."""
    x, y, z = rotations.level_axes(up, AXES.index(level.ahead))
    rows = ((level.xx, level.xy), (level.xy, level.yy))
    ahead, left = corrected((dot(x, mag), dot(y, mag)), (level.offset_x, level.offset_y), rows)
    vertical = constant(np.array([0.0, 0.0, 1.0]), mag[0])
    leaning = matvec(attitude, z)
    bend = (leaning + vertical) / jnp.maximum(1 + leaning[2], 1e-6)
    x, y = matvec(attitude, x), matvec(attitude, y)
    return ahead * (x - x[2] * bend) + left * (y - y[2] * bend) + dot(z, mag) * vertical


class Foot(NamedTuple):
    """What a foot is told at a sample of `dt (*L)` s: its `attitude (3, 3, *L)`, the `variance (*L)` rad² of
    its yaw, the `force (3, *L)` that the accelerometer reads, the field `mag (3, *L)` in body axes, and how
    far it is `still (*L)`."""

    attitude: Array
    variance: Array
    force: Array
    mag: Array
    dt: Array
    still: Array


def look(p: Looking, level: Level, state: Looks, foot: Foot) -> tuple[Looks, Array]:
    """Gather the field while the foot is still; returns the state and whether it looked just now `(*L)`, 0 or
    1."""
    attitude, variance, force, mag, dt, still = foot
    always = p.per == "sample"
    here = levelled(attitude, force if p.levelling == "force" else attitude[2], mag, level)
    clock, (over, now) = tick(state.clock, still, dt, p.settle_s + p.dwell_s, p.gap_s, always)
    settled = clock.seconds + 0.5 * dt >= p.settle_s
    now = jnp.where(settled, now, 0.0)
    part = jnp.where(settled, still * dt, 0.0)
    anew = over | always
    total = jnp.where(anew, 0.0, state.total) + part * here
    seconds = jnp.where(anew, 0.0, state.seconds) + part
    seen = Look(total / jnp.maximum(seconds, 1e-6), _yaw(attitude, state.first), clock.time, variance)
    shifted = (*state.window[1:], seen)
    window = tuple(
        Look(*(jnp.where(now > 0, new, old) for new, old in zip(a, b, strict=True)))
        for a, b in zip(shifted, state.window, strict=True)
    )
    follow = (jnp.where(over, 0.0, state.follow) if always else state.follow) + now
    return Looks(total, seconds, clock, window, state.many + now, follow, state.first), now


def _yaw(attitude: Array, first: Array) -> Array:
    """The turn about up `(*L)` rad from one attitude to another: twist, which has no gimbal."""
    across = dot(attitude[1], first[0]) - dot(attitude[0], first[1])
    along = dot(attitude[0], first[0]) + dot(attitude[1], first[1])
    return jnp.arctan2(across, along + 1e-12)


def turned(state: Looks, correction: Array, how: str) -> Looks:
    """The same looks seen with an attitude corrected by `correction (3, *L)` rad, so that the next change is
    the gyroscope's alone. What was levelled by the force turns about up only."""
    yaw = correction[2]
    if how == "force":
        correction = yaw * constant(np.array([0.0, 0.0, 1.0]), yaw)
    turn = rotations.exp(correction)
    window = tuple(x._replace(field=matvec(turn, x.field), yaw=x.yaw + yaw) for x in state.window)
    return state._replace(window=window, total=matvec(turn, state.total))


@parameters
class HeadingNoise:
    """How far a magnetic heading is trusted: (σ_m/H)² for the sensor, (tan I · σ_tilt)² for the tilt, the
    floor, and what an odd field adds: where strength or inclination are not the reference's, neither is the
    direction. Ma prints no heading noise."""

    floor: Array = leaf(
        2 * _DEGREE, unit="rad", low=1e-4, high=3.2, source=_KIT, tune=True, when={"update": "heading"},
        meaning="Least standard deviation of a heading, however good its field; raised, headings turn "
        "the track less.",
    )  # fmt: skip
    field: Array = leaf(
        0.3, unit="uT", low=1e-4, high=100.0, source=_KIT, tune=True,
        meaning="Noise of the field along each axis; raised, whatever the field measures counts for less.",
    )  # fmt: skip
    tilt: Array = leaf(
        0.5 * _DEGREE, unit="rad", low=1e-6, high=1.0, source=_KIT, when={"update": "heading"},
        meaning="Error of tilt in a levelled field; raised, headings count for less, most where the "
        "field is steep.",
    )  # fmt: skip
    oddity: Array = leaf(
        0.0, unit="1", low=0.0, high=100.0, scale="linear", source="0: published",
        when={"update": "heading"},
        meaning="Weight of odd strength and inclination in a heading's noise; raised, odd fields turn "
        "the track less.",
    )  # fmt: skip


def heading_sigma(p: HeadingNoise, field: Array, reference: Array) -> Array:
    """Standard deviation `(*L)` rad of the heading of a field `(3, *L)`, finite where there is none.

    `reference (2, *L)` is the strength in µT and the inclination in rad of an undisturbed field.
    """
    level = field[0] ** 2 + field[1] ** 2 + 1e-6
    size = level + field[2] ** 2
    steep = field[2] ** 2 / level
    odd = (jnp.sqrt(size) / reference[0] - 1) ** 2 + (inclination(field) - reference[1]) ** 2
    square = p.floor**2 + p.field**2 / level + steep * p.tilt**2 + p.oddity**2 * odd
    return jnp.sqrt(square)


def offset_variance(attitude: Array, field: Array, covariance: Array) -> Array:
    """Variance `(*L)` rad² of the heading of a field `(3, *L)` in navigation axes for the `covariance
    (3, 3, *L)` in µT² of an offset in body axes: of its part across the horizontal field."""
    level = field[0] ** 2 + field[1] ** 2 + 1e-6
    across = (attitude[1] * field[0] - attitude[0] * field[1]) / level  # d azimuth / d offset
    return dot(across, matvec(covariance, across))
