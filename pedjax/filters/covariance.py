"""An error covariance in named 3×3 blocks, of any set of states.

The inertial filter has fifteen error states, in order: attitude `t` (small rotation in the navigation frame),
gyroscope bias `g`, position `p`, velocity `v`, accelerometer bias `a`. The convention is truth = estimate ⊞
error: C = exp([t×]) Ĉ, the rest additive, so that corrections are added and an innovation is measurement
minus
prediction. Hence ṫ = −C g and v̇ = −[fⁿ×] t − C a, with fⁿ the specific force in the navigation frame, gravity
reaction included. (Ma and Zhang define the error the other way round; Ma's Eq. 39 as printed doubles the
attitude error instead of removing it. The signs here are held to finite differences in the tests.) Other
filters name other blocks: each state has one letter.

Only one of two mirrored blocks is kept, `P["tv"]` is the covariance of attitude and velocity, `(3, 3, *L)`:
half the arithmetic of the full matrix, and symmetric by construction.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations_with_replacement
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from pedjax.lanes import (
    add,
    cholesky,
    eye,
    forward_substitution,
    matmul,
    matmul_t,
    symmetric,
    transpose,
)
from pedjax.rotations import skew

STATES = "tgpva"
"""Of the inertial filter: attitude, gyroscope bias, position, velocity, accelerometer bias."""

Covariance = dict[str, Array]

Transition = Mapping[str, Mapping[str, Array | None]]
"""F by blocks: row to column to its matrix `(3, 3, *L)`, a number `(*L)` times the identity, or None for the
identity; blocks that are not there are zero."""


class ProcessNoise(NamedTuple):
    """Noise densities and correlation times of the inertial model, scalars `(*L)`.

    `gyroscope` rad/s/√Hz, `accelerometer` m/s²/√Hz, `gyroscope_bias` rad/s²/√Hz, `accelerometer_bias`
    m/s³/√Hz; `..._time` in s. Densities make the filter independent of the sampling rate: a per-sample
    standard deviation s at rate r is the density s/√r.
    """

    gyroscope: Array
    accelerometer: Array
    gyroscope_bias: Array
    accelerometer_bias: Array
    gyroscope_bias_time: Array
    accelerometer_bias_time: Array


def states_of(P: Covariance) -> list[str]:
    """The letters of its states, in the order of its blocks."""
    return [name[0] for name in P if name[0] == name[1]]


def block(P: Covariance, row: str, column: str) -> Array:
    """Any block of the symmetric whole."""
    return P[row + column] if row + column in P else transpose(P[column + row])


def diagonal(deviations: Mapping[str, Array]) -> Covariance:
    """Covariance of independent errors from standard deviations `(3, *L)` of each state, by letter."""
    P = {}
    for a, b in combinations_with_replacement(deviations, 2):
        identity = eye(3, deviations[a][0])
        like = deviations[a][:, None] * identity
        P[a + b] = like * like if a == b else jnp.zeros_like(like)
    return P


def dense(P: Covariance, states: str = STATES) -> Array:
    """The full `(3n, 3n, *L)` matrix of the n states in that order."""
    return jnp.concatenate(
        [jnp.concatenate([block(P, a, b) for b in states], axis=1) for a in states], axis=0
    )


def variances(P: Covariance, state: str) -> Array:
    """Of one state, `(3, *L)`."""
    return jnp.stack([P[state + state][i, i] for i in range(3)])


def sigma(P: Covariance, state: str) -> Array:
    """Standard deviation of one state, `(3, *L)`, 0 where rounding made a variance negative."""
    return jnp.sqrt(jnp.maximum(variances(P, state), 0.0))


def is_positive(P: Covariance) -> Array:
    """Whether every variance is a number and not negative, `(*L)` bool; cheaper than looking at them all."""
    smallest = None
    for state in states_of(P):
        for i in range(3):
            one = P[state + state][i, i]
            smallest = one if smallest is None else jnp.minimum(smallest, one)
    assert smallest is not None
    return smallest >= 0


def inertial_transition(attitude: Array, force_n: Array, dt: Array, noise: ProcessNoise) -> Transition:
    """F of the inertial filter over `dt` s."""
    D, G = -dt * attitude, -dt * skew(force_n)
    return {
        "t": {"t": None, "g": D},
        "g": {"g": jnp.exp(-dt / noise.gyroscope_bias_time)},
        "p": {"p": None, "v": dt},
        "v": {"v": None, "t": G, "a": D},
        "a": {"a": jnp.exp(-dt / noise.accelerometer_bias_time)},
    }


def inertial_noise(noise: ProcessNoise, dt: Array, like: Array) -> dict[str, Array]:
    """Q of the inertial filter by state, for scalars like `like (*L)`; the position has none."""
    identity = eye(3, like)

    def spread(density: Array) -> Array:
        return density * density * dt * identity

    return {
        "t": spread(noise.gyroscope),
        "g": spread(noise.gyroscope_bias),
        "v": spread(noise.accelerometer),
        "a": spread(noise.accelerometer_bias),
    }


def predict(P: Covariance, F: Transition, Q: Mapping[str, Array]) -> Covariance:
    """F P Fᵀ + Q with the zero and identity blocks of F left out; `Q[state] (3, 3, *L)`."""
    keep = {}
    for a, of in F.items():
        factor = of.get(a)
        if len(of) == 1 and factor is not None and factor.ndim < P[a + a].ndim:
            keep[a] = factor
    rows: dict[str, Array] = {}

    def row(a: str, s: str) -> Array:
        """A block of F P, made once; without the number that a row of one number has in front."""
        if a in keep:
            return block(P, a, s)
        if a + s not in rows:
            parts = [_times(m, block(P, b, s)) for b, m in F[a].items()]
            rows[a + s] = add(parts) if parts else jnp.zeros_like(block(P, a, s))
        return rows[a + s]

    def whole(a: str, b: str) -> Array:
        if b in keep:
            found = row(a, b)
            if a in keep:
                return keep[a] * keep[b] * found
            return keep[b] * found
        parts = [_times_t(row(a, d), m) for d, m in F[b].items()]
        found = add(parts) if parts else jnp.zeros_like(block(P, a, b))
        return keep[a] * found if a in keep else found

    found = {}
    for name in P:
        a, b = name[0], name[1]
        new = whole(a, b)
        if a == b:
            is_plain = a in keep or list(F[a].values()) in ([], [None])
            new = new if is_plain else symmetric(new)
            new = new + Q[a] if a in Q else new
        found[name] = new
    return found


def _times(matrix: Array | None, x: Array) -> Array:
    if matrix is None:
        return x
    return matmul(matrix, x) if matrix.ndim == x.ndim else matrix * x


def _times_t(x: Array, matrix: Array | None) -> Array:
    if matrix is None:
        return x
    return matmul_t(x, matrix) if matrix.ndim == x.ndim else matrix * x


class Rows(NamedTuple):
    """A measurement: innovation `z (m, *L)`, its noise covariance `R (m, m, *L)`, and H by blocks.

    `H` maps a state to its `(m, 3, *L)` matrix, or to None for the identity (m = 3).
    """

    innovation: Array
    noise: Array
    H: dict[str, Array | None]


class Whitened(NamedTuple):
    """An innovation seen by its own spread: `z` rows of L⁻¹ (innovation), and `Y[state]` rows of L⁻¹ H P,
    with L Lᵀ = w H P Hᵀ + R."""

    z: list[Array]
    Y: dict[str, list[Array]]


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
    return Whitened(z, {s: forward_substitution(lower, HP[s]) for s in HP})


def downdate(P: Covariance, seen: Whitened, weight: Array) -> tuple[Covariance, dict[str, Array]]:
    """P − w Yᵀ Y, symmetric, and positive as far as rounding allows; and the correction of each state, to be
    added."""
    z, Y = seen
    correction = {s: weight * add(y * e for y, e in zip(Y[s], z, strict=True)) for s in Y}

    def removed(a: str, b: str) -> Array:
        return add(x[:, None] * y[None] for x, y in zip(Y[a], Y[b], strict=True))

    return {name: P[name] - weight * removed(*name) for name in P}, correction


def update(P: Covariance, rows: Rows, weight: Array) -> tuple[Covariance, dict[str, Array]]:
    """Kalman update with the measurement's information scaled by `weight (*L)` in [0, 1]: S = w H P Hᵀ + R,
    K = w P Hᵀ S⁻¹. Returns the covariance and the correction of each state, to be added."""
    return downdate(P, whiten(P, rows, weight), weight)


def normalised_innovation(P: Covariance, rows: Rows) -> Array:
    """zᵀ S⁻¹ z `(*L)` with S = H P Hᵀ + R: χ² with m degrees of freedom where the model holds."""
    HPH = rows.noise
    for s, matrix in rows.H.items():
        HP = _through(rows.H, P, s)
        HPH = HPH + (HP if matrix is None else matmul_t(HP, matrix))
    z = forward_substitution(cholesky(HPH), rows.innovation)
    return add(e * e for e in z)
