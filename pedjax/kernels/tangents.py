"""Forward derivatives: a step and its slope in one direction, as a step of its own.

The direction is a lane like any other: gradients of S sets by n parameters are S n lanes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pedjax.kernels.program import Advance


class Dual(NamedTuple):
    """A tree of values and one of their slopes, None where there is no slope (of truth values and integers)
    or where it is zero (of parameters)."""

    value: Any
    slope: Any


def tangents(advance: Advance) -> Advance:
    """The same step on `Dual` parameters and states; what it keeps and sums is `Dual`, too."""

    def both(parameters: Dual, state: Dual, sample: Any) -> tuple[Dual, Dual, Dual, Any]:
        def real(p: Any, s: Any) -> tuple[tuple[Any, Any, Any], Any]:
            *found, status = advance(p, s, sample)
            return tuple(found), status

        values = parameters.value, state.value
        slopes = _whole(parameters), _whole(state)
        found, slope, status = jax.jvp(real, values, slopes, has_aux=True)
        state, kept, sums = (_dual(*pair) for pair in zip(found, slope, strict=True))
        return state, kept, sums, status

    return both


def dual(function: Callable[[Any], Any], parameters: Dual) -> Dual:
    """A function of parameters with its slope: how first states are made."""
    return _dual(*jax.jvp(function, (parameters.value,), (_whole(parameters),)))


def _whole(x: Dual) -> Any:
    """The slopes as JAX wants them, none left out."""

    def one(value: Any, slope: Any) -> Any:
        if not jnp.issubdtype(jnp.result_type(value), jnp.inexact):
            return np.zeros(jnp.shape(value), jax.dtypes.float0)
        return jnp.zeros_like(value) if slope is None else slope

    return jax.tree.map(one, x.value, x.slope)


def _dual(value: Any, slope: Any) -> Dual:
    return Dual(value, jax.tree.map(lambda x: None if x.dtype == jax.dtypes.float0 else x, slope))
