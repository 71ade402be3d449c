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

from pedjax.lanes import add, eye, matmul, matmul_t, symmetric, transpose
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


def extended(P: Covariance, deviations: Mapping[str, Array]) -> Covariance:
    """With further states, independent of all others, of standard deviations `(3, *L)` by letter."""
    grown = dict(P)
    for new, own in diagonal(deviations).items():
        grown[new] = own
    for a in states_of(P):
        like = jnp.zeros_like(P[a + a])
        for b in deviations:
            grown[a + b] = like + jnp.zeros_like(deviations[b][:, None])
    return grown


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
    """F P Fᵀ + Q with the zero and identity blocks of F left out; `Q[state] (3, 3, *L)`. A state of which F
    does not speak stays as it is."""
    F = {a: F.get(a, {a: None}) for a in states_of(P)}
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
