"""Steps, packed columns, and the plain scan to which a kernel is held."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.filtering import _advance
from pedjax.kernels.columns import Columns, Walked
from pedjax.system import Signals
from pedjax.systems import system


def advance_of(found):
    """A system's step in the form that a kernel takes."""
    return _advance(found, None, ("position", "attitude"))


def scanned(advance, p, starts, columns, rows):
    """What `columns.walk` computes, by `lax.scan` over lanes (S, C)."""
    chunks, width = columns.which.shape
    p = jax.tree.map(lambda x: jnp.reshape(x, (-1, 1)) if jnp.ndim(x) else x, p)
    sizes = [x.shape for x in jax.tree.leaves(p)] + [(x.shape[-2], 1) for x in jax.tree.leaves(starts)]
    lanes = (*jnp.broadcast_shapes(*sizes)[:1], width)
    count = max(x.shape[-1] for x in jax.tree.leaves(starts))
    starts = jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-2], lanes[0], count)), starts)

    def outer(carry, part):
        state, code = carry
        samples, which = part
        fresh = jax.tree.map(lambda x: x[..., jnp.maximum(which, 0)], starts)
        state = jax.tree.map(lambda new, old: jnp.where(which >= 0, new, old), fresh, state)
        code = jnp.where(which >= 0, 0, code)

        def inner(carry, sample):
            state, code = carry
            state, kept, sums, status = advance(p, state, sample)
            sums = jax.tree.map(lambda x: jnp.broadcast_to(x, lanes), sums)
            return (state, jnp.where(code == 0, status, code)), (kept, sums)

        (state, code), (kept, sums) = jax.lax.scan(inner, (state, code), samples)
        return (state, code), (kept, jax.tree.map(lambda x: x.sum(0), sums), code)

    split = jax.tree.map(lambda x: x.reshape(chunks, -1, *x.shape[1:]), columns.samples)
    first = jax.tree.map(lambda x: jnp.zeros((*x.shape[:-2], *lanes), x.dtype), starts)
    code = jnp.zeros(lanes, jnp.int32)
    _, (kept, sums, status) = jax.lax.scan(outer, (first, code), (split, columns.which))

    def put(x):
        x = x.reshape(-1, *x.shape[2:])
        found = jnp.zeros((rows, *x.shape[1:]), x.dtype)
        for c in range(width):
            at = jnp.where(columns.row[:, c] < 0, rows, columns.row[:, c])
            found = found.at[..., c].set(found[..., c].at[at].set(x[..., c], mode="drop"))
        return found

    return Walked(jax.tree.map(put, kept), sums, status)


class Case(NamedTuple):
    """Arguments of `columns.walk`, and what made its first states."""

    parameters: object
    starts: object
    columns: Columns
    rows: int
    start: object
    openings: object


def signals(length, seed, dtype, hz=100.0):
    """Steps of a foot that stands for half of each second, in a field that changes a little; and dt."""
    rng = np.random.default_rng(seed)
    moves = (np.arange(length) % 40 >= 18)[:, None]
    force = rng.normal(size=(length, 3)) * np.where(moves, 1.5, 0.02) + [0, 0, 9.8]
    rate = rng.normal(size=(length, 3)) * np.where(moves, 0.8, 0.005)
    field = rng.normal(size=(length, 3)) * 0.1 + [5, 20, -40]
    sensor = Signals(*(jnp.asarray(x, dtype) for x in (force, rate, field)))
    return {"foot": sensor}, jnp.full(length, 1 / hz, dtype)


def case(name, changes, dtype, values, chunk=16, lengths=(40, 25, 14), columns=((0, 2), (1,)), every=5):
    """Recordings of those lengths in columns, for parameter sets `values[path] (S,)`; the same order of
    recordings as packing's: each begins with a chunk, and padding with dt = 0 ends it."""
    found = system(name)
    p = parameters.cast(parameters.replace(found.defaults(), changes), dtype)
    p = parameters.with_leaves(p, {k: jnp.asarray(v, dtype)[:, None] for k, v in values.items()})
    sizes = [n // chunk + 1 for n in lengths]
    chunks = max(sum(sizes[r] for r in members) for members in columns) + 1
    prepared = []
    for r, (n, size) in enumerate(zip(lengths, sizes, strict=True)):
        sensors, dt = signals(size * chunk, r, dtype)
        dt = jnp.where(jnp.arange(size * chunk) < n, dt, 0)
        prepared.append(found.prepare(p, sensors, dt, 100.0, n))
    which = np.full((chunks, len(columns)), -1, np.int32)
    row = np.full((chunks * chunk, len(columns)), -1, np.int32)
    laid = []
    for c, members in enumerate(columns):
        at, parts, last = 0, [], 0
        for r in members:
            which[at, c] = r
            scored = np.arange(every - 1, lengths[r], every)
            row[at * chunk + scored, c] = last + np.arange(len(scored))
            last += len(scored)
            at += sizes[r]
            parts.append(prepared[r].samples)
        idle = (chunks - at) * chunk
        parts.append(jax.tree.map(lambda x, n=idle: jnp.broadcast_to(x[-1:], (n, *x.shape[1:])), parts[-1]))
        laid.append(jax.tree.map(lambda *x: jnp.concatenate(x), *parts))
    samples = jax.tree.map(lambda *x: jnp.stack(x, -1), *laid)
    openings = jax.tree.map(lambda *x: jnp.stack(x, -1), *[x.opening for x in prepared])

    def start(p):
        return found.start(p, None, openings)

    count = max(len(v) for v in values.values())
    starts = jax.tree.map(
        lambda x: jnp.broadcast_to(x, (*x.shape[:-2], count, len(lengths))), jax.jit(start)(p)
    )
    rows = int(row.max()) + 2
    return Case(p, starts, Columns(samples, jnp.asarray(which), jnp.asarray(row)), rows, start, openings)


def some(count, seed=0):
    """Parameter sets, thresholds on both sides of the statistic."""
    rng = np.random.default_rng(seed)
    return {
        "stance.shoe.threshold": np.exp(rng.uniform(np.log(1e4), np.log(1e9), count)),
        "updates.zero_velocity": np.exp(rng.uniform(np.log(0.005), np.log(0.05), count)),
    }
