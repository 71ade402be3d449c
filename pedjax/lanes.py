"""Small matrices with lanes last.

A scalar is `(*lanes)`, a vector `(3, *lanes)`, a matrix `(m, n, *lanes)`: the structural axes lead and any
number of batch axes trail, so that one walk (`lanes = ()`) and a thousand parameter sets run the same code
and the innermost machine loop runs over lanes. No LAPACK and no dot kernel, which would keep a scanned step
from being compiled as one loop. Two habits make it fast on a CPU, each by a factor of two or more: a result
that several others use is a sum over an axis, which the compiler makes once, where it repeats any cheaper
arithmetic in each place that reads it; and nothing is put together with `stack` inside the step, which
becomes a branch for each number and keeps the loop from the vector units.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def matmul(a: Array, b: Array) -> Array:
    """`a (m, k, *L)` times `b (k, n, *L)`."""
    return jnp.sum(a[:, :, None] * b[None], axis=1)


def matmul_t(a: Array, b: Array) -> Array:
    """`a (m, k, *L)` times the transpose of `b (n, k, *L)`."""
    return jnp.sum(a[:, None] * b[None], axis=2)


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


def constant(values: np.ndarray, like: Array) -> Array:
    """A structural constant with as many unit lane axes as the scalar `like (*L)`."""
    return jnp.asarray(values, like.dtype).reshape(values.shape + (1,) * like.ndim)


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


def root(x: Array) -> Array:
    """Square root with slope 0 at 0, and 0 where `x` is negative; what is not a number stays so."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0 * x)


def norm(x: Array, axis: int = 0, small: float = 0.0) -> Array:
    """Length `(*L)` of `x (n, *L)` with a finite slope at zero: √(|x|² + `small`), which is smooth there, or
    where that is 0 the exact length with slope 0."""
    square = jnp.sum(x * x, axis=axis)
    return jnp.sqrt(square + small) if small else root(square)


def hypotenuse(*sides: Array, small: float) -> Array:
    """√(a² + b² + ... + `small`) `(*L)` of numbers `(*L)`: as `norm`, of what is not in one array."""
    return jnp.sqrt(add(x * x for x in sides) + small)


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


def add(parts: Iterable[Array]) -> Array:
    """Their sum, from the first on."""
    return reduce(operator.add, parts)


def product(a: Array, b: Array) -> Array:
    """As `matmul`, but repeated by the compiler in each kernel that reads it: for what one other uses."""
    return add(a[:, k, None] * b[None, k] for k in range(a.shape[1]))


def product_t(a: Array, b: Array) -> Array:
    """As `matmul_t`, repeated likewise."""
    return add(a[:, None, k] * b[None, :, k] for k in range(a.shape[1]))


def t_product(a: Array, b: Array) -> Array:
    """The transpose of `a (k, m, *L)` times `b (k, n, *L)`, repeated likewise."""
    return add(a[k, :, None] * b[k, None] for k in range(a.shape[0]))


def once(x: Array) -> Array:
    """The same array, computed in one place however many use it.

    The compiler repeats cheap arithmetic in each kernel that reads it, but never a sum over an axis: this is
    such a sum.
    """
    pick = jnp.array([1, 0], x.dtype).reshape((2,) + (1,) * x.ndim)
    return jnp.sum(pick * x[None], axis=0)


def forward_substitution(lower: list[list[Array]], b: Array) -> list[Array]:
    """Rows of the solution of `L y = b` for `b (m, ..., *L)`."""
    rows: list[Array] = []
    for i, row in enumerate(lower):
        rows.append(once((b[i] - sum(row[j] * rows[j] for j in range(i))) / row[i]))
    return rows


def solve(s: Array, b: Array) -> Array:
    """x with `s x = b` for `s (m, m, *L)`, symmetric and positive definite, and `b (m, *L)`, m small."""
    lower = cholesky(s)
    y = forward_substitution(lower, b)
    x: list[Array] = [y[0]] * len(y)
    for i in reversed(range(len(y))):
        x[i] = (y[i] - sum(lower[j][i] * x[j] for j in range(i + 1, len(y)))) / lower[i][i]
    return jnp.stack(x)


def slopes(f: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """f(x) `(m, *L)` and ∂f/∂x `(m, 3, *L)` of an `x (3, *L)` whose lanes do not mix."""
    value = f(x)
    columns = []
    for k in range(3):
        move = jnp.zeros_like(x).at[k].set(1.0)
        columns.append(jax.jvp(f, (x,), (move,))[1])
    return value, jnp.stack(columns, axis=1)
