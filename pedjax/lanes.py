"""Small matrices with lanes last.

A scalar is `(*lanes)`, a vector `(3, *lanes)`, a matrix `(m, n, *lanes)`: the structural axes lead and any
number of batch axes trail, so that one walk (`lanes = ()`) and a thousand parameter sets run the same code
and the innermost machine loop runs over lanes. No LAPACK and no dot kernel, which would keep a scanned step
from being compiled as one loop: products are elementwise, and summed by a reduction, which the compiler
computes once where it would repeat a written-out sum in each place that uses it (twice the speed).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array


def matmul(a: Array, b: Array) -> Array:
    """`a (m, k, *L)` times `b (k, n, *L)`."""
    return jnp.sum(a[:, :, None] * b[None], axis=1)


def matmul_t(a: Array, b: Array) -> Array:
    """`a (m, k, *L)` times the transpose of `b (n, k, *L)`."""
    return jnp.sum(a[:, None] * b[None], axis=2)


def t_matmul(a: Array, b: Array) -> Array:
    """The transpose of `a (k, m, *L)` times `b (k, n, *L)`."""
    return jnp.sum(a[:, :, None] * b[:, None], axis=0)


def matvec(a: Array, x: Array) -> Array:
    """`a (m, n, *L)` times `x (n, *L)`."""
    return jnp.sum(a * x[None], axis=1)


def transpose(a: Array) -> Array:
    """Swap the two structural axes."""
    return jnp.swapaxes(a, 0, 1)


def symmetric(a: Array) -> Array:
    """The symmetric part."""
    return 0.5 * (a + transpose(a))


def eye(n: int, like: Array) -> Array:
    """The `(n, n)` identity with as many unit lane axes as the scalar `like (*L)`."""
    return jnp.eye(n, dtype=like.dtype).reshape((n, n) + (1,) * like.ndim)


def align(x: Array, structural: int, lanes: int) -> Array:
    """Insert unit axes after the structural ones so that `x` broadcasts against that many lane axes."""
    missing = lanes - (x.ndim - structural)
    return x.reshape(x.shape[:structural] + (1,) * missing + x.shape[structural:])


def lane_shape(parameters: Any, scalar: Array) -> tuple[int, ...]:
    """The common lane shape of a parameter tree and of a scalar `(*L)` of the inputs.

    Lanes of the inputs are the last ones: parameters `(S, 1)` and inputs `(R,)` run as lanes `(S, R)`.
    """
    return jnp.broadcast_shapes(scalar.shape, *(leaf.shape for leaf in jax.tree.leaves(parameters)))


def dot(x: Array, y: Array) -> Array:
    """Inner product of `x` and `y (n, *L)`."""
    return jnp.sum(x * y, axis=0)


def cross(x: Array, y: Array) -> Array:
    """Vector product of `x` and `y (3, *L)`."""
    return jnp.stack([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])


def cholesky(s: Array) -> list[list[Array]]:
    """Rows of the lower triangular factor of `s (m, m, *L)`, positive definite, m small and fixed."""
    lower: list[list[Array]] = []
    for i in range(s.shape[0]):
        row: list[Array] = []
        for j in range(i):
            row.append((s[i, j] - sum(row[k] * lower[j][k] for k in range(j))) / lower[j][j])
        row.append(jnp.sqrt(s[i, i] - sum(x * x for x in row)))
        lower.append(row)
    return lower


def forward_substitution(lower: list[list[Array]], b: Array) -> Array:
    """Solve `L y = b` for `b (m, ..., *L)`.

    The divisions are left as such: the compiler takes a division as too dear to repeat, and so computes
    each element once instead of once for each place that uses it.
    """
    rows: list[Array] = []
    for i, row in enumerate(lower):
        rows.append((b[i] - sum(row[j] * rows[j] for j in range(i))) / row[i])
    return jnp.stack(rows)
