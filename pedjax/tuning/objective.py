"""The mean loss of many starts over many recordings, and its gradient by unconstrained numbers."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from pedjax import parameters
from pedjax.ensemble import Problem, losses, losses_along
from pedjax.packing import Batches


def _mean_loss(problem: Problem, params: Any, free: dict[str, Array], batches: Batches) -> Array:
    """Mean over recordings `(S,)`, from free numbers; a recording that diverged gives no direction."""
    specs = parameters.specs(params)
    values = {path: specs[path].from_free(x) for path, x in free.items()}
    each = losses(problem, params, values, batches)
    return jnp.mean(jnp.where(jnp.isfinite(each), each, 0.0), axis=-1)


@partial(jax.jit, static_argnames="problem")
def soft_loss_and_gradient(
    problem: Problem, params: Any, free: dict[str, Array], batches: Batches
) -> tuple[Array, dict[str, Array]]:
    """Mean loss over recordings of each start `(S,)` and its gradient by the free numbers (reverse mode)."""

    def total(free: dict[str, Array]) -> tuple[Array, Array]:
        each = _mean_loss(problem, params, free, batches)
        return jnp.sum(each), each

    gradient, each = jax.grad(total, has_aux=True)(free)
    return each, gradient


@partial(jax.jit, static_argnames="problem")
def soft_loss_and_gradient_forward(
    problem: Problem, params: Any, free: dict[str, Array], batches: Batches
) -> tuple[Array, dict[str, Array]]:
    """The same by tangents beside the states, a lane for each start and parameter: one kernel on a GPU."""
    specs = parameters.specs(params)
    paths, starts = list(free), next(iter(free.values())).shape[0]
    values, slopes = {}, {}
    for path in paths:
        values[path], slopes[path] = jax.jvp(specs[path].from_free, (free[path],), (jnp.ones(starts),))
    sets = {path: jnp.tile(values[path], len(paths)) for path in paths}
    moves = {path: jnp.concatenate([slopes[path] * (path == other) for other in paths]) for path in paths}
    losses, gradients = [], []
    for batch in batches.parts:
        loss, slope = losses_along(problem, params, sets, moves, batch)
        losses.append(loss)
        gradients.append(slope)
    each, slope = batches.joined(losses), batches.joined(gradients)
    sound = jnp.isfinite(each)
    mean = jnp.mean(jnp.where(sound, each, 0.0), axis=-1)[:starts]
    gradient = jnp.mean(jnp.where(sound, slope, 0.0), axis=-1).reshape(len(paths), starts)
    return mean, dict(zip(paths, gradient, strict=True))


GRADIENTS = {"reverse": soft_loss_and_gradient, "forward": soft_loss_and_gradient_forward}
"""Ways to the same gradient: backward through the scan; or forward, a lane for each start and parameter."""
