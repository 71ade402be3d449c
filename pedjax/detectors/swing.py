"""Swings of the thigh: the strides of a leg with a sensor in its trouser pocket, each with how far it swung.

The largest rotation in a pocket need not be the stride's: a phone turns about its long axis as the walker
turns. So the angular rate is levelled first, by a direction of up that the gyroscope carries along and the
force pulls at, and its part about up is taken off. What is left is the rate about level axes, seen by the
body. It is integrated and kept to the frequencies of walking in one filter, component by component, and the
axis about which the angle varies most is the lateral one, from hip to hip. That axis turns with the body, so
it needs no heading; and it is found among all directions of the body, so no axis of the phone may be upright
where it must not, and however the phone lies in the pocket the strides are the same.

About the lateral axis the angle swings once in two steps. A stride is a fall of the angle below zero and its
rise above it, or no rise for long. Small swings are strides here, too: a threshold on `swing` parts them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax.lanes import add, dot, norm
from pedjax.rotations import exp

LOWEST_HZ, HIGHEST_HZ = 0.3, 5.0
"""The frequencies that count as walking: slow strides are at 0.5 Hz, a stride's sharpest parts below 5 Hz."""

LEVELLING_S = 2.0
"""Over how many seconds the force tells up: two strides, so that their accelerations cancel."""

LEARNING_S = 10.0
"""Over how many seconds the lateral axis is learnt: some ten strides."""

SHARE = 0.25
"""Of the angle's recent deviation (RMS): the angle is above or below zero when it is so far from it."""

LEAST = 0.0175
"""And at least so far, rad (1 degree): more than a standing leg sways in that band."""

RESTS_S = 1.5
"""So many seconds on one side of zero, and the walker stands: the last stride is over."""

_DAMPING = 2**0.5  # of Butterworth filters of second order
_NOTHING = 1e-12  # rad^2, below which there is no axis


class Cycles(NamedTuple):
    """The strides of one leg, time first; `event (T,)` is 1 at the sample that ends one, else 0.

    There, and 0 elsewhere, `swing (T,)` rad is how far the thigh swung in it from one side to the other,
    `seconds (T,)` how long it took, and `bounce (T,)` m/s^2 the range of the upward force. `angle (T,)` rad
    is the angle of the thigh all the time, and `lateral (T, 3)` the lateral axis in the body, of length 1:
    to the walker's right, as far as is known so far; zero before anything moved.
    """

    event: Array
    swing: Array
    seconds: Array
    bounce: Array
    angle: Array
    lateral: Array


class _Filter(NamedTuple):
    """The two integrators of a filter of second order."""

    first: Array
    second: Array


class _Axis(NamedTuple):
    """The mean of the angle's products `(3, 3)` rad^2, their principal direction `(3,)`, and the mean cube of
    the rate about it in rad^3/s^3."""

    moment: Array
    direction: Array
    cube: Array


class _Cycle(NamedTuple):
    """`side` of zero (1, -1, or 0: the walker stands), and for how many seconds it is on it, `waited`; the
    cycle's `seconds` so far; and the highest and lowest of the angle in rad, and of the upward force in
    m/s^2, in it."""

    side: Array
    waited: Array
    seconds: Array
    high: Array
    low: Array
    up_most: Array
    up_least: Array


class _State(NamedTuple):
    time: Array
    gravity: Array
    smooth: _Filter
    angle: _Filter
    axis: _Axis
    cycle: _Cycle


def cycles(force: Array, rate: Array, dt: Array, length: ArrayLike | None = None) -> Cycles:
    """Of a sensor on the thigh, in any attitude: `force`, `rate (T, 3)` in m/s^2 and rad/s and `dt (T,)` s.

    Causal; samples from `length` on, and those with dt = 0, change nothing.
    """
    counts = dt > 0 if length is None else (dt > 0) & (jnp.arange(dt.shape[0]) < length)
    dt = jnp.where(counts, dt, 0.0)
    fast, slow = (jnp.tan(jnp.pi * jnp.minimum(hz * dt, 0.45)) for hz in (HIGHEST_HZ, LOWEST_HZ))
    back = jnp.moveaxis(exp(-(dt[:, None] * rate).T), -1, 0)
    none, still = jnp.zeros_like(dt[0]), jnp.zeros_like(force[0])
    four = jnp.zeros_like(force, shape=(4,))
    first = _State(
        none,
        force[0],
        _Filter(four, four),
        _Filter(still, still),
        _Axis(still[:, None] * still, still, none),
        _Cycle(*(none,) * 7),
    )

    def step(state: _State, row: Any) -> tuple[_State, Cycles]:
        is_real, *sample = row
        new, found = _step(state, *sample)
        return jax.tree.map(lambda a, b: jnp.where(is_real, a, b), new, state), found

    _, found = jax.lax.scan(step, first, (counts, force, rate, back, dt, fast, slow))
    at = (found.event > 0) & counts
    event, swing, seconds, bounce = (jnp.where(at, x, 0.0) for x in found[:4])
    return Cycles(event, swing, seconds, bounce, found.angle, found.lateral)


def _step(
    state: _State, force: Array, rate: Array, back: Array, dt: Array, fast: Array, slow: Array
) -> tuple[_State, Cycles]:
    gravity = jnp.sum(back * state.gravity, axis=1)  # as the body turned since, up turns back in it
    gravity = gravity + _share(dt, state.time, LEVELLING_S) * (force - gravity)
    up = gravity / norm(gravity, small=1e-12)
    level_rate = rate - dot(up, rate) * up
    smooth, (_, _, low) = _filtered(state.smooth, jnp.concatenate([level_rate, dot(up, force)[None]]), fast)
    held, (quick, middle, _) = _filtered(state.angle, low[:3], slow)
    angle = middle / (2 * jnp.pi * LOWEST_HZ)  # what the filter passes of the rate's integral
    axis = _learnt(state.axis, angle, quick, _share(dt, state.time, LEARNING_S))
    swung = dot(axis.direction, angle)
    usual = norm(jnp.sum(axis.moment * axis.direction, axis=1)) ** 0.5
    cycle, found = _followed(state.cycle, swung, low[3], jnp.maximum(SHARE * usual, LEAST), dt)
    right = jnp.where(axis.cube < 0, -1.0, 1.0) * axis.direction
    return _State(state.time + dt, gravity, smooth, held, axis, cycle), Cycles(*found, swung, right)


def _share(dt: Array, time: Array, over_s: float) -> Array:
    """What a sample counts in a mean: the plain mean at first, later one that forgets over those seconds."""
    return dt / (dt + jnp.minimum(time, over_s) + 1e-12)


def _filtered(state: _Filter, x: Array, warped: Array) -> tuple[_Filter, tuple[Array, Array, Array]]:
    """A filter of second order, by trapezoids: what is above its corner, about it and below it. `warped` is
    the tangent of half the angle that the corner turns in a sample."""
    above = (x - (_DAMPING + warped) * state.first - state.second) / (1 + _DAMPING * warped + warped**2)
    about = state.first + warped * above
    below = state.second + warped * about
    return _Filter(about + warped * above, below + warped * about), (above, about, below)


def _learnt(axis: _Axis, angle: Array, rate: Array, share: Array) -> _Axis:
    """With one more sample of the level angle `(3,)` rad and of its rate in rad/s.

    One step of the power method at each sample follows the principal direction, and never turns it round.
    Which way is right the rate tells: the thigh comes forward more quickly than it goes back, and forward it
    turns to the right by the rule of the right hand.
    """
    moment = axis.moment + share * (angle[:, None] * angle - axis.moment)
    size = add(moment[k, k] for k in range(3))
    some, known = size > _NOTHING, dot(axis.direction, axis.direction) > 0
    towards = jnp.sum(moment / jnp.where(some, size, 1.0) * axis.direction, axis=1)
    towards = jnp.where(known, towards + 1e-3 * axis.direction, angle)
    length = norm(towards)
    direction = jnp.where(some & (length > 0), towards / jnp.where(length > 0, length, 1.0), axis.direction)
    about = dot(direction, rate)
    return _Axis(moment, direction, axis.cube + share * (about**3 - axis.cube))


def _followed(
    cycle: _Cycle, angle: Array, up: Array, band: Array, dt: Array
) -> tuple[_Cycle, tuple[Array, Array, Array, Array]]:
    """The cycle with one more sample, and event, swing, seconds and bounce of what it ends."""
    rises, falls = (angle > band) & (cycle.side <= 0), (angle < -band) & (cycle.side >= 0)
    waited = jnp.where(rises | falls, 0.0, cycle.waited + dt)
    rests = waited > RESTS_S + 0.5 * dt  # a border between samples: the same one in any precision
    ends = (cycle.side < 0) & (rises | rests)
    side = jnp.where(rises, 1.0, jnp.where(falls, -1.0, jnp.where(rests, 0.0, cycle.side)))
    seconds = cycle.seconds + dt
    high, low = jnp.maximum(cycle.high, angle), jnp.minimum(cycle.low, angle)
    most, least = jnp.maximum(cycle.up_most, up), jnp.minimum(cycle.up_least, up)
    begins = ends | (cycle.side == 0)
    now = (
        jnp.where(begins, a, b)
        for a, b in ((0 * dt, seconds), (angle, high), (angle, low), (up, most), (up, least))
    )
    return _Cycle(side, waited, *now), (ends.astype(dt.dtype), high - low, seconds, most - least)
