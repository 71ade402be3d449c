"""A Kalman update of a covariance in blocks, with its derivative written out.

The update whitens: with L Lᵀ = S = w H P Hᵀ + R, Y = L⁻¹ H P and ζ = L⁻¹ z, it is P − w Yᵀ Y and w Yᵀ ζ,
which needs no inverse. Its derivative does not go through the factor: with V = S⁻¹ H P and u = S⁻¹ z,

    d(P − w Yᵀ Y) = dP − w (d(HP)ᵀ V + Vᵀ d(HP)) + w Vᵀ dS V − dw Vᵀ H P,
    d(w Yᵀ ζ) = w d(HP)ᵀ u + w Vᵀ (dz − dS u) + dw (H P)ᵀ u.

Both this and its transpose are said here, in few array expressions: differentiated line by line, updates are
a third of all the loops of a filter's gradient, and the compiler's time goes with the square of their number.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jax.typing import ArrayLike

from pedjax.filters.covariance import Covariance, block, states_of
from pedjax.lanes import (
    add,
    cholesky,
    eye,
    forward_substitution,
    matmul,
    matmul_t,
    matvec,
    once,
    product,
    product_t,
    t_product,
    transpose,
)


class Rows(NamedTuple):
    """A measurement: innovation `z (m, *L)`, its noise covariance `R (m, m, *L)`, and H by blocks.

    `H` maps a state to its `(m, 3, *L)` matrix, or to None for the identity (m = 3).
    """

    innovation: Array
    noise: Array
    H: dict[str, Array | None]


class Whitened(NamedTuple):
    """An innovation seen by its own spread: `z` rows of L⁻¹ (innovation), and `Y[state]` rows of L⁻¹ H P,
    with L Lᵀ = w H P Hᵀ + R; and what they are made of."""

    z: list[Array]
    Y: dict[str, list[Array]]
    lower: list[list[Array]]
    HP: dict[str, Array]
    HPH: Array


def _through(H: dict[str, Array | None], P: Covariance, state: str) -> Array:
    """H P for the columns of one state, `(m, 3, *L)`."""
    parts = [
        block(P, row, state) if matrix is None else matmul(matrix, block(P, row, state))
        for row, matrix in H.items()
    ]
    return add(parts)


def whiten(P: Covariance, rows: Rows, weight: Array) -> Whitened:
    """The innovation and H P through the Cholesky factor of their spread, for an update of that `weight`."""
    HP = {s: _through(rows.H, P, s) for s in states_of(P)}
    HPH = sum(
        (HP[s] if matrix is None else matmul_t(HP[s], matrix) for s, matrix in rows.H.items()),
        jnp.zeros_like(rows.noise),
    )
    lower = cholesky(weight * HPH + rows.noise)
    z = forward_substitution(lower, rows.innovation)
    return Whitened(z, {s: forward_substitution(lower, HP[s]) for s in HP}, lower, HP, HPH)


def downdate(P: Covariance, seen: Whitened, weight: Array) -> tuple[Covariance, dict[str, Array]]:
    """P − w Yᵀ Y, symmetric, and positive as far as rounding allows; and the correction of each state, to be
    added."""
    z, Y = seen.z, seen.Y
    correction = {s: weight * add(y * e for y, e in zip(Y[s], z, strict=True)) for s in Y}

    def removed(a: str, b: str) -> Array:
        return add(x[:, None] * y[None] for x, y in zip(Y[a], Y[b], strict=True))

    return {name: P[name] - weight * removed(*name) for name in P}, correction


def update(P: Covariance, rows: Rows, weight: ArrayLike) -> tuple[Covariance, dict[str, Array]]:
    """Kalman update with the measurement's information scaled by `weight (*L)` in [0, 1]: S = w H P Hᵀ + R,
    K = w P Hᵀ S⁻¹. Returns the covariance and the correction of each state, to be added."""
    like = P[next(iter(P))][0, 0]
    H = {s: matrix for s, matrix in rows.H.items() if matrix is not None}
    parts = ((rows.innovation, 1), (rows.noise, 2), *((x, 2) for x in (*H.values(), *P.values())))
    lanes = jnp.broadcast_shapes(jnp.shape(weight), *(x.shape[structural:] for x, structural in parts))

    def whole(x: Array, structural: int) -> Array:
        return jnp.broadcast_to(x, (*x.shape[:structural], *lanes))

    P = {name: whole(x, 2) for name, x in P.items()}
    wide = {s: None if matrix is None else whole(matrix, 2) for s, matrix in rows.H.items()}
    rows = Rows(whole(rows.innovation, 1), whole(rows.noise, 2), wide)
    return _update(P, rows, whole(jnp.asarray(weight, like.dtype), 0))


@jax.custom_jvp
def _update(P: Covariance, rows: Rows, weight: Array) -> tuple[Covariance, dict[str, Array]]:
    return downdate(P, whiten(P, rows, weight), weight)


_Given = tuple[Covariance, Rows, Array]
_Found = tuple[Covariance, dict[str, Array]]


class _Known(NamedTuple):
    """What the slopes need: `HP` and `V` by state `(m, 3, *L)`, `HPH (m, m, *L)`, `u (m, *L)`."""

    P: Covariance
    H: dict[str, Array | None]
    HP: dict[str, Array]
    HPH: Array
    V: dict[str, Array]
    u: Array
    weight: Array


def _update_and_slope(given: _Given, moves: _Given) -> tuple[_Found, _Found]:
    P, rows, weight = given
    seen = whiten(P, rows, weight)
    identity = jnp.broadcast_to(eye(len(seen.z), weight), rows.noise.shape)
    inverse = once(add(x[:, None] * x[None] for x in forward_substitution(seen.lower, identity)))
    V = {s: matmul(inverse, HP) for s, HP in seen.HP.items()}
    u = matvec(inverse, rows.innovation)
    known = _Known(P, rows.H, seen.HP, seen.HPH, V, u, weight)

    leaves, structure = jax.tree.flatten(moves, is_leaf=lambda x: isinstance(x, SymbolicZero))
    still = [isinstance(x, SymbolicZero) for x in leaves]

    def forward(known: _Known, moving: list[Array]) -> _Found:
        rest = iter(moving)
        whole = [jnp.zeros(x.shape, x.dtype) if z else next(rest) for x, z in zip(leaves, still, strict=True)]
        return _slope(known, jax.tree.unflatten(structure, whole))

    def backward(known: _Known, slopes: _Found) -> list[Array]:
        whole = jax.tree.leaves(_slope_transposed(known, slopes))
        return [x for x, z in zip(whole, still, strict=True) if not z]

    moving = [x for x, z in zip(leaves, still, strict=True) if not z]
    slope = jax.custom_derivatives.linear_call(forward, backward, known, moving)
    return downdate(P, seen, weight), slope


_update.defjvp(_update_and_slope, symbolic_zeros=True)


def _slope(known: _Known, moves: _Given) -> _Found:
    """How covariance and corrections move when all that is given does."""
    (P, H, HP, HPH, V, u, w), (dP, of, dw) = known, moves

    def through(s: str) -> Array:
        """d(HP) for the columns of a state."""
        parts = []
        for r, matrix in H.items():
            moved, own = block(dP, r, s), of.H[r]
            parts.append(moved if matrix is None else product(matrix, moved))
            if own is not None:
                parts.append(product(own, block(P, r, s)))
        return add(parts)

    dHP = {s: through(s) for s in HP}
    dHPH = []
    for s, matrix in H.items():
        own = of.H[s]
        dHPH.append(dHP[s] if matrix is None else product_t(dHP[s], matrix))
        if own is not None:
            dHPH.append(product_t(HP[s], own))
    dS = once(dw * HPH + w * add(dHPH) + of.noise)
    dSV = {s: product(dS, V[s]) for s in V}
    changed = {}
    for name in P:
        a, b = name[0], name[1]
        outer = t_product(dHP[a], V[b]) + t_product(V[a], dHP[b]) - t_product(V[a], dSV[b])
        changed[name] = dP[name] - w * outer - dw * t_product(V[a], HP[b])
    inner = of.innovation - add(dS[:, k] * u[k] for k in range(len(u)))
    correction = {}
    for s in V:
        moved = add(dHP[s][k] * u[k] + V[s][k] * inner[k] for k in range(len(u)))
        correction[s] = w * moved + dw * add(HP[s][k] * u[k] for k in range(len(u)))
    return changed, correction


def _slope_transposed(known: _Known, slopes: _Found) -> _Given:
    """The slopes of a number by all that is given from those by what was found; of symmetric P and R."""
    (P, H, HP, HPH, V, u, w), (by_P, by_correction) = known, slopes
    m = range(len(u))

    def both(a: str, b: str) -> Array:
        """The slope by a block and by its mirror image."""
        return by_P[a + a] + transpose(by_P[a + a]) if a == b else block(by_P, a, b)

    M = {s: once(add(product(V[b], both(b, s)) for b in V)) for s in V}
    along = once(add(V[s][:, i] * by_correction[s][i] for s in V for i in range(3)))
    crossed = along[:, None] * u[None] + u[:, None] * along[None]
    by_S = once(0.5 * w * (add(product_t(M[s], V[s]) for s in V) - crossed))
    by_HP = {}
    for s in V:
        found = u[:, None] * by_correction[s][None] - M[s]
        if s in H:
            matrix = H[s]
            found = found + (by_S if matrix is None else product(by_S, matrix))
        by_HP[s] = once(w * found)

    found_P = dict(by_P)
    by_H: dict[str, Array | None] = dict.fromkeys(H)
    for r, matrix in H.items():
        for s in V:
            part = by_HP[s] if matrix is None else t_product(matrix, by_HP[s])
            name = r + s if r + s in P else s + r
            found_P[name] = found_P[name] + (part if name == r + s else transpose(part))
        if matrix is not None:
            through = add(product_t(by_HP[s], block(P, r, s)) for s in V)
            by_H[r] = through + w * product(by_S, HP[r])

    removed = add(jnp.sum(M[s] * HP[s], axis=(0, 1)) for s in V)
    corrected = add(u[k] * by_correction[s][i] * HP[s][k, i] for s in V for i in range(3) for k in m)
    by_weight = corrected - 0.5 * removed + jnp.sum(by_S * HPH, axis=(0, 1))
    return found_P, Rows(w * along, by_S, by_H), by_weight


def projected(P: Covariance, rows: Rows) -> Array:
    """H P Hᵀ `(m, m, *L)`."""
    parts = []
    for s, matrix in rows.H.items():
        HP = _through(rows.H, P, s)
        parts.append(HP if matrix is None else matmul_t(HP, matrix))
    return add(parts)


def normalised_innovation(P: Covariance, rows: Rows) -> Array:
    """zᵀ S⁻¹ z `(*L)` with S = H P Hᵀ + R: χ² with m degrees of freedom where the model holds."""
    z = forward_substitution(cholesky(rows.noise + projected(P, rows)), rows.innovation)
    return add(e * e for e in z)
