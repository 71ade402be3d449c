"""A magnetometer's hard iron while moving: a small causal Kalman filter in body axes.

    reading = field + offset + noise,    d(field)/dt = −(rate − bias) × field + wandering

The field turns with the board, as the gyroscope tells, and wanders as the board is carried through a room;
the offset stays where it is. At rest the two cannot be told apart, and the filter says so by its sigma;
turning about two axes separates them. When something magnetic is put on, taken off or passed by, the
innovations lean one way. A gate on that opens, and while it is open field and offset become uncertain alike;
the turns that follow tell which of the two it was. No attitude, heading, accelerometer or map is needed. The
gyroscope's bias is a state, because at rest it looks like a slow turn.

Noises are densities (a per-sample deviation s at rate r is s/√r), so that any rate will do.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax import rotations
from pedjax.filters import covariance, kalman
from pedjax.filters.covariance import Covariance
from pedjax.filters.kalman import Rows
from pedjax.gates import SoftGate, gate, log_positive
from pedjax.lanes import add, align, dot, eye, lane_shape, matvec
from pedjax.parameters import leaf, parameters

_KIT = "kit choice"
_REST = "BROAD 02 and 21: density of the readings at rest"
_MOVED = "BROAD 02 and 21: field along the optical truth, 0.4 at 1.5 rad/s and 1.7 at 7 rad/s"


@parameters
class TrackerParameters(SoftGate):
    """Noise of the readings, wandering of field and offset, and the gate.

    The field wanders by `still` and, with the rate ω of turning, by `turning` ω: who turns it also moves it,
    and what is wrong with the gyroscope's scale or the clocks counts as well. After T s of turning the
    offset is known to about that wandering over ω √T: in a room with more iron than that of the trials below
    it takes a larger `still`, and longer. The innovations, each in units of its own spread, are averaged
    over `window`; where that average, normed to a χ² of three degrees of freedom, is above `threshold`,
    field and offset both wander by `jump`.
    """

    noise: Array = leaf(
        0.085, unit="uT/sqrt(Hz)", low=1e-4, high=10.0, source=_REST,
        meaning="White noise of the magnetometer's readings; raised, each reading changes field and "
        "offset less.",
    )  # fmt: skip
    still: Array = leaf(
        0.1, unit="uT/sqrt(s)", low=1e-4, high=100.0, source=_KIT, tune=True,
        meaning="How fast the field wanders, at rest too; raised, changes are put down to the field and "
        "the offset is learnt slower.",
    )  # fmt: skip
    turning: Array = leaf(
        0.3, unit="uT sqrt(s)/rad", low=1e-4, high=10.0, source=_MOVED, tune=True,
        meaning="How fast the field wanders for each rad/s of turning; raised, turns tell less of the "
        "offset.",
    )  # fmt: skip
    offset: Array = leaf(
        0.02, unit="uT/sqrt(s)", low=1e-5, high=10.0, source=_KIT, tune=True,
        meaning="How fast the hard iron may wander; raised, its estimate follows changes sooner and is "
        "noisier.",
    )  # fmt: skip
    bias: Array = leaf(
        1e-5, unit="rad/s^2/sqrt(Hz)", low=1e-9, high=0.1, source=_KIT,
        meaning="How fast the tracker's gyroscope bias may wander; raised, its estimate follows sooner "
        "and is noisier.",
    )  # fmt: skip
    window: Array = leaf(
        0.1, unit="s", low=0.01, high=10.0, source=_KIT,
        meaning="Time over which innovations are averaged to find a jump; raised, smaller jumps are "
        "found, but later.",
    )  # fmt: skip
    threshold: Array = leaf(
        30.0, unit="1", low=1.0, high=1e4, source="kit choice: 1e-6 by chance", tune=True, point=True,
        meaning="Squared size of the averaged innovations above which a jump is assumed; raised, fewer "
        "jumps are found.",
    )  # fmt: skip
    jump: Array = leaf(
        50.0, unit="uT/sqrt(s)", low=1e-3, high=1e4, source="kit choice: a field", tune=True,
        meaning="How fast field and offset wander while a jump is assumed; raised, the old values are "
        "given up sooner.",
    )  # fmt: skip
    initial_field: Array = leaf(
        50.0, unit="uT", low=0.1, high=1e3, source="kit choice: a field",
        meaning="Standard deviation of the first field, which is the first reading; raised, that reading "
        "counts for less.",
    )  # fmt: skip
    initial_offset: Array = leaf(
        0.7, unit="uT", low=0.01, high=1e3, source="kit choice: calibrated before",
        meaning="Standard deviation of the hard iron at the start, zero; raised, the first turns change "
        "it more.",
    )  # fmt: skip
    initial_bias: Array = leaf(
        0.005, unit="rad/s", low=1e-7, high=1.0, source="kit choice: 0.3 deg/s",
        meaning="Standard deviation of the tracker's first gyroscope bias, zero; raised, early readings "
        "change it more.",
    )  # fmt: skip


@parameters
class HardIronParameters(TrackerParameters):
    """The tracker's, and `lag`, the time by which the magnetometer is behind the gyroscope.

    Not accounted for, τ s of it look like an offset of τ ω × field, and 13 ms are enough for false finds on a
    board that turns quickly.
    """

    lag: Array = leaf(
        0.0, unit="s", low=0.0, high=0.2, scale="linear", source="0: none",
        meaning="Time by which the magnetometer is behind the gyroscope; raised, older rates turn the field.",
    )  # fmt: skip


class HardIron(NamedTuple):
    """`offset (T, 3)` µT in body axes after each sample, its standard deviation `sigma (T, 3)`, and how far
    the gate was open, `jump (T,)` in [0, 1]. Lanes of the parameters come last."""

    offset: Array
    sigma: Array
    jump: Array


class State(NamedTuple):
    """Field, offset (µT) and gyroscope bias (rad/s) `(3, *L)`; their covariance `P` by blocks of the states
    `f`, `o` and `b`; the averaged innovation `lean`, and how far the gate is open."""

    field: Array
    offset: Array
    bias: Array
    P: Covariance
    lean: Array
    jump: Array


def start(p: TrackerParameters, reading: Array) -> State:
    """No offset and no bias, and all of the first `reading (3,)` field."""
    shape = lane_shape(p, reading[0])
    none = jnp.zeros(shape, reading.dtype)
    zero = jnp.zeros((3, *shape), reading.dtype)
    deviations = {"f": p.initial_field, "o": p.initial_offset, "b": p.initial_bias}
    P = covariance.diagonal({state: sigma + zero for state, sigma in deviations.items()})
    return State(align(reading, 1, len(shape)) + zero, zero, zero, P, zero, none)


def step(p: TrackerParameters, state: State, rate: Array, reading: Array, dt: Array) -> State:
    """Over `dt` s with `rate (3,)` rad/s to the next `reading (3,)` µT, left out where it is no number. With
    dt = 0, padding, all stays."""
    lanes = state.jump.ndim
    rate, reading, dt = align(rate, 1, lanes), align(reading, 1, lanes), align(dt, 0, lanes)
    one = eye(3, state.jump)
    passes = dt > 0
    read = jnp.all(jnp.isfinite(reading), axis=0) & passes
    reading = jnp.where(read, reading, 0.0)
    weight = read.astype(reading.dtype)

    turned = rate - state.bias
    turn = rotations.exp(-dt * turned)
    field = matvec(turn, state.field)
    lever = -dt * rotations.skew(field)  # of the bias on the field
    jumping = state.jump * p.jump * p.jump
    wandering = p.still * p.still + p.turning * p.turning * dot(turned, turned) + jumping
    F: covariance.Transition = {"f": {"f": turn, "b": lever}, "o": {"o": None}, "b": {"b": None}}
    Q = {
        "f": dt * wandering * one,
        "o": dt * (p.offset * p.offset + jumping) * one,
        "b": dt * p.bias * p.bias * one,
    }
    P = covariance.predict(state.P, F, Q)

    since = jnp.where(passes, dt, 1.0)  # finite, with finite slopes, where nothing is read
    noise = p.noise * p.noise / since * one + jnp.zeros_like(P["ff"])
    rows = Rows(weight * (reading - field - state.offset), noise, {"f": None, "o": None})
    seen = kalman.whiten(P, rows, weight)
    P, correction = kalman.downdate(P, seen, weight)

    share = weight * dt / (dt + p.window)
    lean = (1 - share) * state.lean + share * add(one[:, i] * e for i, e in enumerate(seen.z))
    usual = since / (2 * p.window + since)  # variance of the average of white innovations
    jump = 1 - gate(log_positive(dot(lean, lean) / (usual * p.threshold)), p.width, p.straight_through)
    return State(
        field + correction["f"],
        state.offset + correction["o"],
        state.bias + correction["b"],
        P,
        lean,
        jnp.where(passes, jump, state.jump),
    )


def sigma(state: State) -> Array:
    """Standard deviation `(3, *L)` µT of the offset."""
    return covariance.sigma(state.P, "o")


def delayed(rate: Array, dt: Array, lag: ArrayLike) -> Array:
    """Rates `(T, 3, *L)` as they were `lag (*L)` s before each sample, the first before the first."""
    time = jnp.cumsum(dt)
    lag = jnp.asarray(lag, time.dtype)
    then = align(time, 1, lag.ndim) - lag
    return jnp.stack([jnp.interp(then, time, rate[:, axis]) for axis in range(3)], axis=1)


def track_hard_iron(rate: ArrayLike, field: ArrayLike, dt: ArrayLike, params: HardIronParameters) -> HardIron:
    """Hard iron after each sample from angular rates `rate (T, 3)` rad/s, readings `field (T, 3)` µT and the
    intervals `dt (T,)` s that end at each of them.

    Rows of `field` that are not finite are samples without a reading (not the first). Causal and pure.
    """
    rate, field, dt = jnp.asarray(rate), jnp.asarray(field), jnp.asarray(dt)
    params = jax.tree.map(partial(jnp.asarray, dtype=field.dtype), params)
    late = delayed(rate, dt, params.lag)

    def scanned(state: State, sample: tuple[Array, Array, Array]) -> tuple[State, HardIron]:
        state = step(params, state, *sample)
        return state, HardIron(state.offset, sigma(state), state.jump)

    return jax.lax.scan(scanned, start(params, field[0]), (late, field, dt))[1]


class OffsetStep(NamedTuple):
    """A change of hard iron: when it was found, s, and the offset `(3,)` µT before it and after."""

    time: float
    before: np.ndarray
    after: np.ndarray


def offset_steps(
    time: ArrayLike,
    track: HardIron,
    smallest: float = 2.0,
    sigmas: float = 4.0,
    settled: float = 1.0,
    hold: float = 0.5,
) -> list[OffsetStep]:
    """Changes of hard iron, each told as soon as it is sure; what comes later does not change it.

    An estimate counts where the gate is shut and has been for `hold` s with every sigma below `settled` µT.
    It is a change where it differs from the one before by more than `smallest` µT and more than `sigmas`
    standard deviations of the difference.
    """
    time, shut = np.asarray(time, float), np.asarray(track.jump) < 0.5
    offset, variance = np.asarray(track.offset, float), np.asarray(track.sigma, float) ** 2
    total = variance.sum(axis=1)
    known = np.flatnonzero(shut & (variance < settled**2).all(axis=1)).tolist()
    found: list[OffsetStep] = []
    if not known:
        return found
    reference = since = last = known[0]
    for k in known:
        since = since if k <= last + 1 else k
        last = k
        if time[k] - time[since] < hold:
            continue
        square = (offset[k] - offset[reference]) ** 2
        far = square.sum() > smallest**2
        if far and (square / (variance[k] + variance[reference])).sum() > sigmas**2:
            found.append(OffsetStep(float(time[k]), offset[reference], offset[k]))
            reference = k
        elif total[k] < total[reference]:
            reference = k  # the same offset, better known
    return found
