"""A measurement's noise that follows what is measured (Wang 2018, Eq. 9-10, and what works better).

Each law gives an α ≥ 0, and the noise of the rows is (1 + α) R, never less than R. With the innovation z of m
rows, S = H P Hᵀ + R and the mean over the last M looks,

- `printed`: α R with α = |tr E − tr Ē|, E = z zᵀ. An innovation as large as usual makes the noise zero.
- `trace`: the same α as (1 + α) R. In rad² it is a thousandth, and does nothing unless it is scaled up.
- `innovation`: α = max(0, zᵀ S⁻¹ z/m − 1), back to nothing at the next look that fits.
- `windowed`: α = max(0, mean(zᵀ R⁻¹ z)/m − tr(R⁻¹ H P Hᵀ)/m − 1), an estimate of R itself; it comes late, and
  stays for M looks.

max(0, x) is s log(1 + exp(x/s)), of which it is the limit for s = 0. (Wang takes the residual after the
update, which is made with α; the sum of Eq. 10b has k for its upper limit, and each E its own H and state.)
A Student tail (`compass.tail`) is another law of the kind, and odd strength or dip another ground
(`compass.noise.oddity`).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from pedjax.filters import kalman
from pedjax.filters.covariance import Covariance
from pedjax.filters.kalman import Rows
from pedjax.lanes import add
from pedjax.parameters import leaf, parameters, setting

_KIT = "kit choice"
_REMEMBERS = ("printed", "trace", "windowed")
_SOFT = ("innovation", "windowed")


@parameters
class Adaptive:
    """Which law, and its numbers."""

    law: str = setting(
        "none", choices=("none", "printed", "trace", "innovation", "windowed"), source="none: a fixed noise",
        meaning="How the noise of these rows follows their innovations.",
    )  # fmt: skip
    scale: Array = leaf(
        1.0, unit="1", low=1e-3, high=1e5, source=f"1: {_KIT}", tune=True,
        when={"law": ("printed", "trace", "innovation", "windowed")},
        meaning="Factor on alpha; raised, a large innovation makes its measurement count for less.",
    )  # fmt: skip
    softness: Array = leaf(
        0.5, unit="1", low=1e-3, high=10.0, source=_KIT, tune=True, when={"law": _SOFT},
        meaning="Size of an excess of the innovation below which alpha grows gently; raised, usual "
        "innovations make more noise, too.",
    )  # fmt: skip
    window: int = setting(
        10, choices=tuple(range(2, 31)), source=f"{_KIT}; Wang 2018: not printed",
        meaning="Number of looks over which innovations are averaged; longer, alpha is steadier and later.",
    )  # fmt: skip


class Memory(NamedTuple):
    """The last `squares (*L)` of innovations, the oldest first, and how `many (*L)` there were."""

    squares: tuple[Array, ...]
    many: Array


def start(p: Adaptive, like: Array) -> Memory | tuple[()]:
    """Nothing seen; nothing at all for a law that remembers nothing. `like (*L)` is zeros."""
    return Memory((like,) * p.window, like) if p.law in _REMEMBERS else ()


def adapted(
    p: Adaptive, memory: Memory | tuple[()], P: Covariance, rows: Rows, now: Array
) -> tuple[Memory | tuple[()], Rows, Array]:
    """The rows with the noise that they deserve, and α `(*L)`; `now (*L)`, 0 or 1, where they are one look
    more to be remembered."""
    m = rows.innovation.shape[0]
    if p.law == "innovation":
        alpha = _excess(p, kalman.normalised_innovation(P, rows) / m - 1)
    else:
        assert isinstance(memory, Memory)
        if p.law == "windowed":
            size = add(rows.innovation[i] ** 2 / rows.noise[i, i] for i in range(m)) / m
        else:
            size = add(rows.innovation[i] ** 2 for i in range(m))
        shifted = (*memory.squares[1:], size)
        pairs = zip(shifted, memory.squares, strict=True)
        squares = tuple(jnp.where(now > 0, new, old) for new, old in pairs)
        memory = Memory(squares, jnp.minimum(memory.many + now, p.window))
        known = jnp.maximum(memory.many, 1.0)
        if p.law == "windowed":
            spread = kalman.projected(P, rows)
            own = add(spread[i, i] / rows.noise[i, i] for i in range(m)) / m
            alpha = _excess(p, add(squares) / known - own - 1)
        else:
            usual = add(squares) / jnp.maximum(known - 1, 1.0)
            alpha = p.scale * jnp.abs(size - usual)
    factor = jnp.maximum(alpha, 1e-9) if p.law == "printed" else 1 + alpha
    return memory, rows._replace(noise=factor * rows.noise), alpha


def _excess(p: Adaptive, x: Array) -> Array:
    return p.scale * p.softness * jax.nn.softplus(x / p.softness)
