"""Does the walker go straight? A statistic over the headings of the last strides, in rad."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.gates import SoftGate, log_positive
from pedjax.lanes import add
from pedjax.parameters import leaf, parameters, setting

_KIT = "kit choice"
_DEGREE = 0.017453292519943295


def circular_mean(angles: Sequence[Array]) -> Array:
    """The direction of the sum of unit vectors, rad: no step at half a turn."""
    return jnp.arctan2(add(jnp.sin(x) for x in angles), add(jnp.cos(x) for x in angles) + 1e-12)


def _change(headings: Sequence[Array]) -> Array:
    """How far the last heading is from the mean of those before it (Zhang, Eq. 27)."""
    return jnp.abs(rotations.wrap(headings[-1] - circular_mean(headings[:-1])))


def _spread(headings: Sequence[Array]) -> Array:
    """How far one of them is from their mean at most."""
    mean, most = circular_mean(headings), None
    for x in headings:
        away = jnp.abs(rotations.wrap(x - mean))
        most = away if most is None else jnp.maximum(most, away)
    assert most is not None
    return most


STRAIGHT_DETECTORS: dict[str, Callable[[Sequence[Array]], Array]] = {"change": _change, "spread": _spread}
"""Headings `(*L)` rad of the last strides, the oldest first, to a statistic in rad."""


@parameters
class Straight(SoftGate):
    """Which statistic, over how many strides, and the angle that it must stay below."""

    detector: str = setting(
        "spread", choices=tuple(STRAIGHT_DETECTORS), source="change: Zhang, Eq. 27; spread: kit",
        meaning="Whether the last heading is held against the mean of those before it (change), or all "
        "against their mean (spread).",
    )  # fmt: skip
    heading: str = setting(
        "stride", choices=("stride", "yaw"), source="stride: Jimenez 2011; yaw: Zhang",
        meaning="What counts as the heading of a stride: the direction in which the foot went, or its yaw "
        "while it stands.",
    )  # fmt: skip
    strides: int = setting(
        6, choices=tuple(range(1, 21)), source=f"{_KIT}: with 4 deg, harmless on curves",
        meaning="How many strides before the last are looked at; more, only longer straights pass.",
    )  # fmt: skip
    angle: Array = leaf(
        4 * _DEGREE, unit="rad", low=1e-3, high=3.2, source=_KIT, tune=True, point=True,
        meaning="Angle that the statistic must stay below; raised, gentle curves pass as straight, too.",
    )  # fmt: skip
    shortest: Array = leaf(
        0.3, unit="m", low=1e-3, high=10.0, source=_KIT,
        meaning="Length of a stride below which the walker does not walk; raised, short strides begin the "
        "count anew.",
    )  # fmt: skip
    dwell_s: float = setting(
        0.06, source=f"{_KIT}: runners stand for 0.1 s",
        meaning="How long the foot must stand before its stride is counted; longer, short stances are "
        "missed.",
    )  # fmt: skip
    gap_s: float = setting(
        0.15, source=f"{_KIT}: movement that ends a stance",
        meaning="How long the foot must move to end a stance; longer, a short gap does not make a stride.",
    )  # fmt: skip


def statistic(p: Straight, headings: Sequence[Array]) -> Array:
    """Of `p.strides + 1` headings `(*L)` rad, the oldest first."""
    return STRAIGHT_DETECTORS[p.detector](headings)


def log_ratio(p: Straight, headings: Sequence[Array]) -> Array:
    """Log of the statistic over the angle, `(*L)`; negative where the walk is straight."""
    return log_positive(statistic(p, headings)) - jnp.log(p.angle)
