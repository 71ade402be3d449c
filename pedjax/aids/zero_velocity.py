"""Zero velocity: while the foot stands, its velocity is zero (ZUPT).

A stance detector, the gate that turns its statistic into a weight, and three rows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.detectors import stance
from pedjax.filters import adaptive, measurements
from pedjax.filters.adaptive import Adaptive
from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Opening
from pedjax.gates import SoftGate, gate
from pedjax.lanes import align
from pedjax.parameters import group, leaf, parameters, setting
from pedjax.system import Gated, Signals

_KIT = "kit choice"
_FAR = 10.0  # log units beyond which a statistic says nothing more: bounds a missing window's influence


@parameters
class Gate(SoftGate):
    """How the stance statistic becomes a weight, and how far its stance is believed.

    `fixed` is the published test against one threshold. `adaptive` is causal and follows the gait: the log
    threshold moves by `follow` times the recent level of the log statistic (a first-order average over
    `follow_time`), so that a runner's foot, never as still as a stroller's, is found still too; and the
    standard deviation of the zero velocity grows as (1 + statistic/(threshold e^floor))^growth, since a foot
    that turns also moves. follow = 0 and growth = 0 is `fixed`.

    With either, `hysteresis` multiplies the threshold while the foot is held still already.
    """

    kind: str = setting(
        "fixed", choices=("fixed", "adaptive"), source="fixed: published",
        meaning="Whether the stance threshold is fixed, or follows the gait and lets the zero velocity's "
        "noise grow.",
    )  # fmt: skip
    hysteresis: Array = leaf(
        1.0, unit="1", low=1.0, high=100.0, source="1: published",
        meaning="Factor on the stance threshold while the foot is still already; raised, a stance that "
        "began ends later.",
    )  # fmt: skip
    follow: Array = leaf(
        0.0, unit="1", low=-0.5, high=1.5, scale="linear", source="0: published", tune=True,
        when={"kind": "adaptive"},
        meaning="Share of the statistic's recent log level that is added to the log threshold; raised, "
        "it follows the gait more.",
    )  # fmt: skip
    follow_time: Array = leaf(
        0.6, unit="s", low=0.05, high=30.0, source=_KIT, tune=True, when={"kind": "adaptive"},
        meaning="Time over which that recent level is averaged; raised, the threshold follows a change "
        "of gait more slowly.",
    )  # fmt: skip
    growth: Array = leaf(
        0.0, unit="1", low=-0.5, high=3.0, scale="linear", source="0: published", tune=True,
        when={"kind": "adaptive"},
        meaning="How steeply the zero velocity's noise grows with the statistic; raised, a foot that is "
        "less still corrects less.",
    )  # fmt: skip
    floor: Array = leaf(
        0.0, unit="1", low=-10.0, high=10.0, scale="linear", source=_KIT, tune=True,
        when={"kind": "adaptive"},
        meaning="Log of statistic over threshold at which that noise begins to grow; raised, it stays "
        "small for longer.",
    )  # fmt: skip


@parameters
class Updates:
    """Measurement noises of a standing foot, and which rows are on."""

    zero_velocity: Array = leaf(
        0.01, unit="m/s", low=1e-5, high=10.0, source="OpenShoe", tune=True,
        meaning="Standard deviation of a standing foot's velocity; raised, each stance corrects the "
        "estimate less.",
    )  # fmt: skip
    zero_angular_rate: Array = leaf(
        0.05, unit="rad/s", low=1e-5, high=10.0, source=_KIT, when={"zaru": True},
        meaning="Standard deviation of a standing foot's turning; raised, stances correct the "
        "gyroscope's bias less.",
    )  # fmt: skip
    zaru: bool = setting(
        False, source="not part of IEZ",
        meaning="Whether a standing foot also measures the gyroscope's bias, as it does not turn (ZARU).",
    )  # fmt: skip
    adaptive: Adaptive = group(Adaptive)


class State(NamedTuple):
    """Recent `level` of the log statistic, and the last weight, `still`; `(*L)` both. What an adaptive noise
    remembers, `usual`."""

    level: Array
    still: Array
    usual: adaptive.Memory | tuple[()] = ()


def _prepare(p: Any, signals: Signals, dt: Array, rate_hz: float, length: ArrayLike | None) -> Array:
    return stance.evidence(p.stance, signals.force, signals.rate, rate_hz, length)


def _start(
    p: Any, site: Any, opening: Opening, estimate: Any, P: Covariance
) -> tuple[State, Any, Covariance]:
    like = jnp.zeros_like(estimate.position[0])
    return State(like, like, adaptive.start(p.updates.adaptive, like)), estimate, P


def _step(p: Any, site: Any, state: State, seen: Seen) -> Measured:
    evidence = align(seen.own, 2, state.level.ndim)
    published = stance.log_ratio(p.stance, evidence, p.gravity)
    log_ratio = published - state.still * jnp.log(p.gate.hysteresis)
    level, sigma, dt = state.level, p.updates.zero_velocity, seen.sample.dt
    if p.gate.kind == "adaptive":
        bounded = jnp.clip(published, -_FAR, _FAR)
        level = level + dt / (dt + p.gate.follow_time) * (bounded - level)
        log_ratio = log_ratio - p.gate.follow * level
        sigma = sigma * jnp.exp(p.gate.growth * jnp.logaddexp(bounded - p.gate.floor, 0.0))
    weight = gate(log_ratio, p.gate.width, p.gate.straight_through)
    rows, usual = measurements.zero_velocity(seen.estimate, sigma), state.usual
    if p.updates.adaptive.law != "none":
        now = jnp.where((weight > 0.5) & (dt > 0), 1.0, 0.0)
        usual, rows, _ = adaptive.adapted(p.updates.adaptive, usual, seen.P, rows, now)
    return Measured(State(level, weight, usual), rows, weight, Gated(weight, log_ratio))


def _shortest(p: Any) -> tuple[float, str]:
    return 2 * stance.window_s(p.stance), f"stance.{p.stance.detector}.window_s"


TELL_NO_YAW = ("zero_velocity", "zero_angular_rate")
"""Aids whose corrections need not turn what others keep in terms of the yaw. They could, at a cost in each
sample of stance; but a zero velocity tells next to nothing of yaw: with looks at the field that are turned
after it, too, mean errors in six made offices change by 0 to 4 cm, none for the better."""


ZERO_VELOCITY = Aid(
    name="zero_velocity",
    wants=("v",),
    groups=(("stance", stance.StanceParameters), ("gate", Gate), ("updates", Updates)),
    gate="stance",
    prepare=_prepare,
    start=_start,
    step=_step,
    shortest=_shortest,
)
"""ZUPT: z = -v, gated by a stance detector."""


def _rate_step(p: Any, site: Any, state: Any, seen: Seen) -> Measured:
    rows = measurements.zero_angular_rate(seen.estimate, seen.sample.rate, p.updates.zero_angular_rate)
    return Measured(state, rows, seen.gates["stance"].weight)


ZERO_ANGULAR_RATE = Aid(
    name="zero_angular_rate",
    wants=("g",),
    groups=(("updates", Updates),),
    reads=("stance",),
    is_on=lambda p: p.updates.zaru,
    step=_rate_step,
)
"""ZARU: while the foot stands, the gyroscope reads its bias; as sure as the stance is."""
