"""The gyroscope's first bias: zero, as an earlier walk left it, or as the rest before the first step measures
it."""

from __future__ import annotations

from typing import Any, Protocol

import jax.numpy as jnp
from jax import Array

from pedjax.detectors.rest import Rest
from pedjax.lanes import align
from pedjax.parameters import leaf, parameters

BIASES = ("zero", "given", "rest")
"""What the first bias of the gyroscope may be."""


def _about(axis: str) -> Any:
    return leaf(
        0.0, unit="rad/s", low=-0.35, high=0.35, scale="linear", source="0: nothing is known",
        meaning=f"First bias about the body's {axis}, with initial.gyroscope_bias as its standard deviation; "
        "raised, as much more of the rate is taken off.",
    )  # fmt: skip


@parameters
class Prior:
    """The gyroscope's bias as it is known before the walk, by body axis."""

    x: Array = _about("x")
    y: Array = _about("y")
    z: Array = _about("z")


class Known(Protocol):
    """Parameters that tell of a first bias."""

    @property
    def bias(self) -> str: ...  # noqa: D102
    @property
    def prior(self) -> Prior: ...  # noqa: D102
    @property
    def gyroscope_bias(self) -> Array: ...  # noqa: D102
    @property
    def sway(self) -> Array: ...  # noqa: D102


def first_bias(p: Known, rest: Rest | None, ones: Array) -> tuple[Array, Array]:
    """The first bias `(3, *L)` and its standard deviation, rad/s, for `ones (3, *L)`.

    Before the walk it is b0 (zero unless given) with the variance P0 = gyroscope_bias². The n windows of rest
    measure it by their mean rate, each with the variance s² = sway² + spread. About each axis

        P = 1 / (1/P0 + n/s²),    b = P (b0/P0 + n/s² (mean rate)),

    written here without 1/P0; with n = 0 they are P0 and b0.
    """
    prior = ones * 0.0
    if p.bias != "zero":
        prior = jnp.stack([one + 0.0 * ones[0] for one in (p.prior.x, p.prior.y, p.prior.z)])
    if rest is None:
        return prior, p.gyroscope_bias * ones
    lanes = ones.ndim - 1
    windows, spread = align(rest.windows, 0, lanes), align(rest.spread, 0, lanes)
    weight, own = windows * p.gyroscope_bias**2, p.sway**2 + spread  # n P0 and s²
    bias = (own * prior + weight * align(rest.rate, 1, lanes)) / (weight + own)
    return bias * ones, p.gyroscope_bias * jnp.sqrt(own / (weight + own)) * ones


def rest_asked(p: Any) -> float:
    """How many seconds of rest a filter's parameters ask for: none where rest does not give the bias."""
    return float(p.initial.rest_s) if p.initial.bias == "rest" else 0.0
