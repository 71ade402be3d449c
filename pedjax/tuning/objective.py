"""The loss of many parameter sets over many recordings at once, soft for gradients and hard for selection."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pedjax import parameters
from pedjax.evaluation.landmarks import landmark_errors
from pedjax.filtering import scan_points
from pedjax.packing import Batch
from pedjax.system import System

LOSSES = {"armse": "pyshoe_armse", "rms_2d": "rms_2d", "mean_2d": "mean_2d", "rms_3d": "rms_3d"}
"""Each is averaged over recordings."""


class Problem(NamedTuple):
    """What a loss is made of: static parts of one tuning."""

    system: System
    loss: str
    alignment: str


@partial(jax.jit, static_argnames="problem")
def losses(problem: Problem, params: Any, values: dict[str, Array], batch: Batch) -> Array:
    """Loss of each recording for parameter sets `values[path] (S,)`: `(S, R)` in m, inf where unhealthy."""
    lanes = {path: value[..., None] for path, value in values.items()}
    points = scan_points(problem.system, parameters.with_leaves(params, lanes), batch.packed, batch.slots)
    errors = landmark_errors(batch.estimates(points), batch.reference, problem.alignment)
    loss = getattr(errors, LOSSES[problem.loss])
    return jnp.where(batch.healthy(points) & jnp.isfinite(loss), loss, jnp.inf)


def _mean_loss(problem: Problem, params: Any, free: dict[str, Array], batch: Batch) -> Array:
    """Mean over recordings `(S,)`, from free numbers; a recording that diverged gives no direction."""
    specs = parameters.specs(params)
    values = {path: specs[path].from_free(x) for path, x in free.items()}
    each = losses(problem, params, values, batch)
    return jnp.mean(jnp.where(jnp.isfinite(each), each, 0.0), axis=-1)


@partial(jax.jit, static_argnames="problem")
def soft_loss_and_gradient(
    problem: Problem, params: Any, free: dict[str, Array], batch: Batch
) -> tuple[Array, dict[str, Array]]:
    """Mean loss over recordings of each start `(S,)` and its gradient by the free numbers (reverse mode)."""

    def total(free: dict[str, Array]) -> tuple[Array, Array]:
        each = _mean_loss(problem, params, free, batch)
        return jnp.sum(each), each

    gradient, each = jax.grad(total, has_aux=True)(free)
    return each, gradient


@partial(jax.jit, static_argnames="problem")
def soft_loss_and_gradient_forward(
    problem: Problem, params: Any, free: dict[str, Array], batch: Batch
) -> tuple[Array, dict[str, Array]]:
    """The same by forward mode: one extra run a parameter, cheaper for one to four of them."""

    def total(free: dict[str, Array]) -> Array:
        return _mean_loss(problem, params, free, batch)

    gradient = {}
    for path in free:
        tangent = {p: jnp.ones_like(x) if p == path else jnp.zeros_like(x) for p, x in free.items()}
        each, gradient[path] = jax.jvp(total, (free,), (tangent,))
    return each, gradient
