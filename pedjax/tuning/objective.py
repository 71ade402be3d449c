"""The mean loss of many starts over many recordings, and its gradient by unconstrained numbers."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from pedjax import parameters
from pedjax.ensemble import Problem, losses
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
    """The same by forward mode: one extra run a parameter, cheaper for one to four of them."""

    def total(free: dict[str, Array]) -> Array:
        return _mean_loss(problem, params, free, batches)

    gradient = {}
    for path in free:
        tangent = {p: jnp.ones_like(x) if p == path else jnp.zeros_like(x) for p, x in free.items()}
        each, gradient[path] = jax.jvp(total, (free,), (tangent,))
    return each, gradient
