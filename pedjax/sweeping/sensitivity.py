"""What a little more of each parameter would do to the error at one point of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pedjax import parameters
from pedjax.ensemble import Problem, losses
from pedjax.packing import Batches, pack_all
from pedjax.runtime import double_precision
from pedjax.sweeping.designs import Axis
from pedjax.sweeping.engine import Job
from pedjax.tuning.loop import gate_widths, gated

WIDTH = 0.25
"""Of the soft gates: a hard one says nothing about its threshold."""


class Sensitivity(NamedTuple):
    """Mean `loss` over recordings in m, on the soft gate, and its slope by each path: in m for an e-fold of a
    parameter on a log scale, for a hundredth of the swept range on a linear one."""

    loss: float
    slope: dict[str, float]


@partial(jax.jit, static_argnames=("problem", "logs"))
def _loss_and_slope(
    problem: Problem, params: Any, logs: tuple[bool, ...], at: dict[str, Array], batches: Batches
) -> tuple[Array, dict[str, Array]]:
    def mean(steps: dict[str, Array]) -> Array:
        values = {
            path: at[path] * jnp.exp(steps[path]) if log else at[path] + steps[path]
            for path, log in zip(at, logs, strict=True)
        }
        return jnp.mean(losses(problem, params, values, batches))

    return jax.value_and_grad(mean)({path: jnp.zeros_like(x) for path, x in at.items()})


def sensitivity(job: Job, params: Any, axes: Sequence[Axis]) -> Sensitivity:
    """Slopes at `params` along the axes, in float64, through the whole filter."""
    with double_precision():
        widths = gate_widths(params)
        axes = [axis for axis in axes if axis.path not in widths]  # they are what makes the gates soft
        soft = parameters.cast(gated(params, WIDTH), float)
        batches = pack_all(job.problem.system, soft, job.walks, float, job.site)
        at = {axis.path: jnp.asarray([parameters.get(params, axis.path)], float) for axis in axes}
        # the tree of a dict is in the order of its keys: the scales must be too
        logs = tuple(axis.log for axis in sorted(axes, key=lambda axis: axis.path))
        at = dict(sorted(at.items()))
        loss, slope = _loss_and_slope(job.problem, soft, logs, at, batches)
        unit = {axis.path: 1.0 if axis.log else 0.01 * (axis.high - axis.low) for axis in axes}
        return Sensitivity(float(loss), {path: float(g[0]) * unit[path] for path, g in slope.items()})
