"""One gate: from a statistic and a threshold to a weight in [0, 1].

The weight multiplies a measurement's information: S = w H P Hᵀ + R, K = w P Hᵀ S⁻¹. w = 0 is no update,
w = 1 the textbook one. The gate works on the log of statistic over threshold, in which a detector's
thresholds spread evenly over decades.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax.parameters import leaf, parameters, setting


@parameters
class SoftGate:
    """What every group of parameters that holds a gate is: tuning finds gates by this type."""

    width: Array = leaf(
        0.0, unit="1", low=0.0, high=5.0, scale="linear", source="0: the published hard test",
        meaning="Scale of the gate's transition in log units; 0 is the hard test, raised it opens gradually.",
    )  # fmt: skip
    straight_through: bool = setting(
        False, source="kit choice",
        meaning="Whether a soft gate passes its hard value forward and its soft slope backward.",
    )  # fmt: skip


def gate(log_ratio: Array, width: ArrayLike, straight_through: bool = False) -> Array:
    """Weight of a measurement whose statistic is `exp(log_ratio)` times its threshold.

    `width` is the soft transition's scale in log units; 0 is the published hard test (stance where
    log_ratio < 0), the limit of the soft one. `straight_through` takes the hard value with the soft slope.
    """
    hard = jnp.where(log_ratio < 0, 1.0, 0.0).astype(log_ratio.dtype)
    width = jnp.asarray(width, log_ratio.dtype)
    is_soft = width > 0
    soft = jax.nn.sigmoid(-log_ratio / jnp.where(is_soft, width, 1.0))
    if straight_through:
        return jnp.where(is_soft, soft + jax.lax.stop_gradient(hard - soft), hard)
    return jnp.where(is_soft, soft, hard)


def log_positive(x: Array) -> Array:
    """log of a non-negative statistic, finite (and with finite slope) at zero and at overflow."""
    limits = jnp.finfo(x.dtype)
    return jnp.log(jnp.clip(x, limits.tiny * 1e6, limits.max / 1e6))
