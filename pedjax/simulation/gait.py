"""How a foot, a waist and a thigh move, as smooth functions of time whose derivatives are exact.

A walk is a list of swings of each foot (`Swings`), made by `footsteps`. Between two swings the foot stands:
its ball stays where it landed, but for a slip of a millimetre or two; the sole trembles; with the swing the
heel rises about the ball, and after it the toe comes down about the heel. Every transition is a ramp with
three derivatives zero at both ends, so that acceleration and jerk are continuous. Waist and thigh follow
from the two feet: the waist is their mean over a stride, lower the further they are apart; the thigh points
at its foot.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations

SOLE = 0.17
"""From heel to ball, m: the foot rolls over these two."""

INSTEP = (-0.12, 0.0, 0.05)
"""Where a foot sensor sits, seen from the ball, m (forward, left, up)."""

LEG = 0.92
"""From hip to sole, m."""

_BLOW_HZ, _BLOW_RISES, _BLOW_FADES = 25.0, 0.02, 0.08
"""Of the blow at heel strike: its frequency in Hz, and how long it rises and fades, s."""

_WOBBLE, _WOBBLE_HZ = 0.3, (13.0, 17.0)
"""Of soft tissue in the swing: its size in parts of the blow's, and its frequencies up and forward in Hz."""


class Swings(NamedTuple):
    """N swings of one foot, with the foot's axes forward, left, up; each array is `(N, ...)`.

    `border (N + 1,)` s parts the cycles, in the middle of each stance; `leaves` and `lands` s are toe-off and
    heel strike; `start`, `end (N, 3)` m where the ball stands before and after; `heading`, `turn` rad before
    it and by how much it changes; `lift`, `aside` m how far the foot is raised and swung out; `toe_off`,
    `heel_strike` rad the pitches it leaves and lands with (both positive) and `roll` rad by which it tips
    over on the way; `push`, `settle` s how long the heel rises before and the toe falls after; `steepest`,
    `toe_up`, `highest` shares of a swing at which the heel is highest over the ball, the toe over the heel,
    and the foot over the ground; `shock` m of the blow at heel strike; `slip (N, 3)` m while it settles, so
    that the next swing starts from `end + slip`; `rest_before`, `rest (N, 2)` rad roll and pitch of the sole
    in the stances before and after, `unrest_before`, `unrest` rad how much it sways there.
    """

    border: Array
    leaves: Array
    lands: Array
    start: Array
    end: Array
    heading: Array
    turn: Array
    lift: Array
    aside: Array
    toe_off: Array
    heel_strike: Array
    roll: Array
    push: Array
    settle: Array
    steepest: Array
    toe_up: Array
    highest: Array
    shock: Array
    slip: Array
    rest_before: Array
    rest: Array
    unrest_before: Array
    unrest: Array


class Sway(NamedTuple):
    """A sole that is never quite still: sums of sines in roll and pitch, `(2, K)` each: share, rad/s, rad."""

    share: Array
    frequency: Array
    phase: Array


class Walker(NamedTuple):
    """Both feet, how they tremble, and what carries the walker: `lifts (E, 3)`, start s, end s, rise m."""

    left: Swings
    right: Swings
    sway: Sway
    lifts: Array


def ramp(u: Array) -> Array:
    """0 to 1 over 0 <= u <= 1, with three derivatives zero at both ends."""
    u = jnp.clip(u, 0.0, 1.0)
    return u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)


def stride_forward(u: Array) -> Array:
    """0 to 1 over 0 <= u <= 1 like `ramp`, at a more even speed (at most 1.52 times the mean), as a foot."""
    x = 2 * jnp.clip(u, 0.0, 1.0) - 1
    return 0.5 + 0.5 * (x - 0.6 * x**5 + x**9 / 3 - x**13 / 13) / (1 - 0.6 + 1 / 3 - 1 / 13)


def _lifted(u: Array, highest: Array) -> Array:
    """0 to 1 at u = `highest` and back to 0 at u = 1."""
    return ramp(u / highest) * (1 - ramp((u - highest) / (1 - highest)))


def _cycle(t: Array, swings: Swings) -> Swings:
    """The swing whose cycle holds time t."""
    index = jnp.clip(jnp.searchsorted(swings.border, t, side="right") - 1, 0, swings.leaves.shape[0] - 1)
    one = Swings(*(x if name == "border" else x[index] for name, x in swings._asdict().items()))
    return one


def ball(t: Array, swings: Swings) -> tuple[Array, Array]:
    """The ball of the foot `(3,)` in m, without the toe-up part of its landing, and the heading in rad."""
    s = _cycle(t, swings)
    u = (t - s.leaves) / (s.lands - s.leaves)
    moved = stride_forward(u)
    slipped = ramp((t - s.lands) / s.settle)
    heading = s.heading + s.turn * moved
    across = jnp.stack([-jnp.sin(heading), jnp.cos(heading), 0.0 * heading])
    raised = (jnp.array([0.0, 0.0, 1.0]) * s.lift + across * s.aside) * _lifted(u, s.highest)
    return s.start + (s.end - s.start) * moved + s.slip * slipped + raised, heading


def foot(t: Array, swings: Swings, sway: Sway, lifts: Array, lever: Array) -> tuple[Array, Array]:
    """Position `(3,)` m and attitude `(3, 3)` of a sensor on the foot, `lever (3,)` m from its ball."""
    s = _cycle(t, swings)
    place, heading = ball(t, swings)
    flight = s.lands - s.leaves
    u, since = (t - s.leaves) / flight, t - s.lands
    heel_up = ramp((t - s.leaves + s.push) / (s.push + s.steepest * flight))
    toe_up = stride_forward((u - s.steepest) / (s.toe_up - s.steepest))
    flat = ramp((t - s.leaves - s.toe_up * flight) / ((1 - s.toe_up) * flight + s.settle))
    raised = s.heel_strike * (toe_up - flat)  # toe up, about the heel
    pitched = s.toe_off * (heel_up - toe_up) - raised
    ringing = ramp(since / _BLOW_RISES) * (1 - ramp((since - _BLOW_RISES) / _BLOW_FADES))
    blow = s.shock * ringing * jnp.sin(2 * jnp.pi * _BLOW_HZ * since)
    moving = ramp((t - s.leaves + s.push) / s.push) * (1 - ramp(since / s.settle))
    wobble = moving * _WOBBLE * s.shock * jnp.sin(2 * jnp.pi * jnp.array(_WOBBLE_HZ) * t + sway.phase[0, 0])
    moved = ramp(u)
    ground = s.rest_before + (s.rest - s.rest_before) * moved
    size = s.unrest_before + (s.unrest - s.unrest_before) * moved
    still = size * jnp.sum(sway.share * jnp.sin(sway.frequency * t + sway.phase), axis=-1)
    rolled = s.roll * (ramp(0.5 * u / s.steepest) - ramp((u - 2 * s.steepest) / (1 - 2 * s.steepest)))
    attitude = rotations.from_euler(rolled + ground[0] + still[0], ground[1] + still[1] + pitched, heading)
    forward = jnp.stack([jnp.cos(heading), jnp.sin(heading), 0.0 * heading])
    upward = jnp.array([0.0, 0.0, 1.0])
    over_heel = SOLE * ((jnp.cos(raised) - 1) * forward + jnp.sin(raised) * upward)
    up_and_on = (blow + wobble[0] + carried(t, lifts)) * upward + (wobble[1] - 0.4 * blow) * forward
    position = place + over_heel + up_and_on
    return position + attitude @ lever, attitude


def carried(t: Array, lifts: Array) -> Array:
    """Height in m gained in elevators."""
    return jnp.sum(lifts[:, 2] * ramp((t - lifts[:, 0]) / (lifts[:, 1] - lifts[:, 0])))


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_STRIDE = 1.1  # s over which the trunk averages the feet


def waist(t: Array, walker: Walker, lever: Array) -> tuple[Array, Array]:
    """Position `(3,)` m and attitude `(3, 3)` of a sensor on the waist, `lever (3,)` m from its middle."""
    times = t + 0.5 * _STRIDE * jnp.asarray(_NODES)
    places, yaws = [], []
    for side in (walker.left, walker.right):
        place, yaw = jax.vmap(ball, in_axes=(0, None))(times, side)
        places.append(place)
        yaws.append(yaw)
    weights = 0.25 * jnp.asarray(_WEIGHTS)  # mean over time and over the two feet
    middle = jnp.sum(weights[:, None] * (places[0] + places[1]), axis=0)
    yaw = jnp.sum(weights * (yaws[0] + yaws[1]))
    left, right = ball(t, walker.left)[0], ball(t, walker.right)[0]
    forward = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)])
    apart = jnp.sum((left - right)[:2] * forward)
    height = LEG - 0.6 * (LEG - jnp.sqrt(LEG**2 - 0.25 * jnp.minimum(apart**2, LEG**2)))
    twist = jnp.deg2rad(6.0) * jnp.tanh(-apart / 0.7)  # the hip of the leg in front is in front
    list_ = jnp.deg2rad(3.0) * jnp.tanh((left - right)[2] / 0.1)
    attitude = rotations.from_euler(-list_, jnp.deg2rad(4.0) + 0.0 * yaw, yaw + twist)
    position = middle + jnp.array([0.0, 0.0, 1.0]) * (height + carried(t, walker.lifts))
    return position + attitude @ lever, attitude


def thigh(t: Array, walker: Walker, lever: Array) -> tuple[Array, Array]:
    """Position `(3,)` m and attitude `(3, 3)` of a sensor in the right trouser pocket, `lever (3,)` m from
    the hip joint; z points up the thigh."""
    hip, pelvis = waist(t, walker, jnp.array([0.0, -0.1, -0.05]))
    yaw = jnp.arctan2(pelvis[1, 0], pelvis[0, 0])
    forward = jnp.stack([jnp.cos(yaw), jnp.sin(yaw), 0.0 * yaw])
    sole, _ = ball(t, walker.right)
    ahead = jnp.sum((sole - hip) * forward) / LEG
    s = _cycle(t, walker.right)
    raised = s.lift * _lifted((t - s.leaves) / (s.lands - s.leaves), s.highest)
    swing = -jnp.arctan(ahead) - 1.2 * raised  # the knee bends as the foot is raised
    attitude = rotations.from_euler(0.0 * yaw, swing, yaw)
    return hip + attitude @ lever, attitude
