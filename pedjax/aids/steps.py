"""Steps of a sensor in a trouser pocket: at the end of each stride of its leg the position moves on.

A stride is a swing of the thigh that is wide enough; it is as long as two steps, in the direction that the
walker faced on the mean of it. The estimate's attitude gives that direction, a model the length. (Munoz Diaz
2015 and Munoz Diaz and Mendiguchia Gonzalez 2014: step detection by the pitch of the thigh, and step length
by its amplitude.)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.detectors import swing
from pedjax.filters.covariance import Covariance, states_of
from pedjax.filters.filter import Opening
from pedjax.gates import SoftGate, gate, log_positive
from pedjax.lanes import align, constant, dot, hypotenuse
from pedjax.parameters import leaf, parameters, setting
from pedjax.system import Gated, Signals

_KIT = "kit choice"
_DEGREE = 0.017453292519943295

AHEAD = ("x", "y", "z", "learned")
"""What may tell which way the walker faces."""

USUAL_SWING = 40 * _DEGREE
"""The swing, rad, at which a step of the affine model is `length` long."""


class Stride(NamedTuple):
    """What the models go by: how far the thigh swung, rad, and the range of the upward force, m/s^2;
    `(*L)`."""

    swing: Array
    bounce: Array


@parameters
class Steps(SoftGate):
    """Which swings of the thigh are strides, how long their steps are, and which way they go."""

    threshold: Array = leaf(
        8 * _DEGREE, unit="rad", low=0.5 * _DEGREE, high=1.5, source=f"{_KIT}: 8 deg", tune=True, point=True,
        meaning="Swing of the thigh, from one side to the other, above which it is a stride; raised, fewer "
        "swings are.",
    )  # fmt: skip
    model: str = setting(
        "constant", choices=("constant", "affine", "weinberg"), source="constant: kit choice",
        meaning="What the length of a step follows: nothing, the swing of the thigh, or the range of the "
        "upward force (Weinberg 2002).",
    )  # fmt: skip
    length: Array = leaf(
        0.7, unit="m", low=0.05, high=3.0, source=_KIT, tune=True, when={"model": ("constant", "affine")},
        meaning="Length of a step, half a stride; with model = affine that of a swing of 40 degrees; raised, "
        "the track is longer.",
    )  # fmt: skip
    per_swing: Array = leaf(
        0.9, unit="m/rad", low=0.0, high=5.0, scale="linear", source=f"{_KIT}: a stiff leg of 0.9 m",
        tune=True, when={"model": "affine"},
        meaning="By how much a step is longer for each radian of swing; raised, wide swings make longer "
        "steps, narrow ones shorter.",
    )  # fmt: skip
    weinberg: Array = leaf(
        0.4, unit="m/(m/s^2)^(1/4)", low=0.02, high=3.0, source=f"{_KIT}: about Weinberg 2002", tune=True,
        when={"model": "weinberg"},
        meaning="Length of a step over the fourth root of the range of the upward force in its stride; "
        "raised, the track is longer.",
    )  # fmt: skip
    ahead: str = setting(
        "x", choices=AHEAD, source="x: Munoz Diaz 2015",
        meaning="Which way the walker faces: along a body axis, projected to level, or at a right angle to "
        "the axis about which the thigh is seen to swing.",
    )  # fmt: skip


LENGTHS: dict[str, Callable[[Steps, Stride], Array]] = {
    "constant": lambda p, stride: p.length + 0.0 * stride.swing,
    "affine": lambda p, stride: jnp.maximum(p.length + p.per_swing * (stride.swing - USUAL_SWING), 0.0),
    "weinberg": lambda p, stride: p.weinberg * jnp.sqrt(jnp.sqrt(stride.bounce + 1e-12)),
}
"""The length `(*L)` of a step, m, by each model."""


class Own(NamedTuple):
    """Of each sample: whether a stride `ends` (0 or 1), and what it was, as in `swing.Cycles`; and the
    `lateral (3, *L)` axis in the body, None where no one asks for it."""

    ends: Array
    stride: Stride
    lateral: Array | None


class State(NamedTuple):
    """The level direction that the walker faced, `(*L)` east and north, summed over the stride so far in s;
    and how many `strides (*L)` there were."""

    east: Array
    north: Array
    strides: Array


def _prepare(p: Any, signals: Signals, dt: Array, rate_hz: float, length: ArrayLike | None) -> Own:
    found = swing.cycles(signals.force, signals.rate, dt, length)
    lateral = found.lateral if p.steps.ahead == "learned" else None
    return Own(found.event, Stride(found.swing, found.bounce), lateral)


def _start(
    p: Any, site: Any, opening: Opening, estimate: Any, P: Covariance
) -> tuple[State, Any, Covariance]:
    like = jnp.zeros_like(estimate.position[0])
    return State(like, like, like), estimate, P


def _ahead(p: Steps, attitude: Array, own: Own) -> tuple[Array, Array]:
    """East and north of the level direction that the walker faces, `(*L)`, of length 1."""
    if own.lateral is not None:
        right = align(own.lateral, 1, attitude.ndim - 2)
        east, north = -dot(attitude[1], right), dot(attitude[0], right)
    else:
        axis = AHEAD.index(p.ahead)
        east, north = attitude[0, axis], attitude[1, axis]
    length = hypotenuse(east, north, small=1e-12)
    return east / length, north / length


def _step(p: Any, site: Any, state: State, seen: Seen) -> Measured:
    q, nav, dt = p.steps, seen.estimate, seen.sample.dt
    lanes = nav.position.ndim - 1
    ends = align(seen.own.ends, 0, lanes) > 0
    stride = Stride(*(align(x, 0, lanes) for x in seen.own.stride))
    log_ratio = jnp.where(ends, jnp.log(q.threshold) - log_positive(stride.swing), 10.0)
    weight = jnp.where(ends, gate(log_ratio, q.width, q.straight_through), 0.0)

    east, north = _ahead(q, nav.attitude, seen.own)
    east, north = state.east + dt * east, state.north + dt * north
    length = hypotenuse(east, north, small=1e-12)
    goes = 2 * weight * LENGTHS[q.model](q, stride)
    nothing = jnp.zeros_like(nav.position)
    correction = dict.fromkeys(states_of(seen.P), nothing)
    correction["p"] = goes / length * (_along(0, east) + _along(1, north)) + nothing

    new = State(jnp.where(ends, 0.0, east), jnp.where(ends, 0.0, north), state.strides + weight)
    more = {"stride_length": goes + 0 * east, "swing": stride.swing + 0 * east, "strides": new.strides}
    gated = Gated(weight + 0 * east, log_ratio + 0 * east)
    return Measured(new, None, None, gated, more, (seen.P, correction))


def _along(axis: int, size: Array) -> Array:
    return constant(np.eye(3)[axis], size) * size


STEPS = Aid(
    name="steps",
    groups=(("steps", Steps),),
    gate="step",
    prepare=_prepare,
    start=_start,
    step=_step,
)
"""Pocket dead reckoning: a stride's length at each swing of the thigh, the way the walker faces."""
