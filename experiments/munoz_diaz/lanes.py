"""One system over many recordings of equal length, side by side in lanes, told every second.

A walk of 39 minutes has 234 000 samples, of which a figure needs one in a hundred, but covariances with them:
the inner scan goes over a block of samples and hands out what stands at its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.errors import InputError
from pedjax.preparing import prepare
from pedjax.recording import Recording
from pedjax.system import Output, System
from pedjax.walks import Walk, check_walk
from pedjax.walks import walk as as_walk

EVERY = 100  # samples


class Told(NamedTuple):
    """At `time (K,)` s, the end of each block, of R recordings: the gyroscope's `bias (K, 3, R)` and its
    `sigma`, rad/s, the `attitude (K, 3, 3, R)` body to navigation, the `position (K, 3, R)` m; of each gate
    the mean `weight (K, R)` over the block; `status (K, R)`, the first so far that is not healthy; and `more`
    of what the system says beside, by name, `(K, ..., R)`."""

    time: np.ndarray
    bias: np.ndarray
    sigma: np.ndarray
    attitude: np.ndarray
    position: np.ndarray
    weight: dict[str, np.ndarray]
    status: np.ndarray
    more: dict[str, np.ndarray]


class Inputs(NamedTuple):
    """What a system takes of R recordings: `samples`, a tree of `(K, every, ..., R)`, the `opening` and the
    `time (K,)` s at which a block ends. They serve all parameters of the same settings."""

    samples: Any
    opening: Any
    time: np.ndarray


def inputs(
    system: System,
    params: Any,
    recordings: Sequence[Recording],
    every: int = EVERY,
    least: int = 1,
    lost: np.ndarray | None = None,
) -> Inputs:
    """The inputs of recordings of equal length; what is left over at the end is cut off.

    With fewer than `least` recordings the last one fills up the lanes, so that one program serves all. At the
    samples `lost (T,)` the magnetometer has no reading."""
    dtype = jnp.result_type(float)
    params = parameters.cast(params, dtype)
    walks = [as_walk(r, None, None, needs=system.needs) for r in recordings]
    if lost is not None:
        walks = [_without(w, lost) for w in walks]
    if len({len(w) for w in walks}) != 1:
        raise InputError("recordings in lanes need one length")
    for w in walks:
        check_walk(system, params, w)
    blocks = len(walks[0]) // every
    end = blocks * every
    samples: Any = None
    openings = []
    lanes = max(len(walks), least)
    for lane, w in enumerate(walks):
        found = prepare(system, params, w, dtype, len(w))
        if samples is None:
            samples = jax.tree.map(lambda x: np.empty((*x[:end].shape, lanes), x.dtype), found.samples)
        to = slice(lane, lane + 1) if lane + 1 < len(walks) else slice(lane, lanes)
        jax.tree.map(lambda all_, x, to=to: _fill(all_, x[:end], to), samples, found.samples)
        openings += [found.opening] * (to.stop - to.start)
    samples = jax.tree.map(lambda x: x.reshape(blocks, every, *x.shape[1:]), samples)
    opening = jax.tree.map(lambda *x: np.stack(x, axis=-1), *openings)
    return Inputs(samples, opening, walks[0].imu.time[every - 1 : end : every])


def _without(w: Walk, lost: np.ndarray) -> Walk:
    imu = w.imu
    assert imu.magnetic_field is not None
    field = np.where(lost[:, None], np.nan, imu.magnetic_field)
    return replace(w, sensors={next(iter(w.sensors)): replace(imu, magnetic_field=field)})


def _fill(whole: np.ndarray, part: np.ndarray, to: slice) -> None:
    whole[..., to] = part[..., None]


def run(system: System, params: Any, given: Inputs, more: Sequence[str] = (), site: Any = None) -> Told:
    """Run a system over its inputs in JAX's current precision."""
    params = parameters.cast(params, jnp.result_type(float))
    found = _run(system, tuple(more), params, site, given.samples, given.opening)
    kept, sums, status = jax.tree.map(lambda x: np.asarray(x)[..., 0], found)
    every = jax.tree.leaves(given.samples)[0].shape[1]
    bias, sigma, attitude, position, told = kept
    weight = {name: x / every for name, x in sums.items()}
    return Told(given.time, bias, sigma, attitude, position, weight, status, told)


@partial(jax.jit, static_argnames=("system", "more"))
def _run(
    system: System, more: tuple[str, ...], params: Any, site: Any, samples: Any, opening: Any
) -> tuple[Any, dict[str, jax.Array], jax.Array]:
    # A unit axis after the lanes keeps the compiler from unrolling the loop over them.
    samples, opening = jax.tree.map(lambda x: x[..., None], (samples, opening))

    def of(output: Output) -> Any:
        e = output.estimate
        told = {name: output.more[name] for name in more}
        return e.gyroscope_bias, output.sigma["gyroscope_bias"], e.attitude, e.position, told

    def weights(output: Output) -> dict[str, jax.Array]:
        return {name: g.weight for name, g in output.gates.items()}

    state = system.start(params, site, opening)
    first = jax.tree.map(lambda x: x[0, 0], samples)
    like = jax.eval_shape(lambda: system.step(params, site, state, first)[1])
    blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), (of(like), weights(like), like.status))

    def inner(carry: Any, sample: Any) -> tuple[Any, None]:
        state, _, sums, status = carry
        state, output = system.step(params, site, state, sample)
        sums = jax.tree.map(jnp.add, sums, weights(output))
        return (state, of(output), sums, jnp.where(status == 0, output.status, status)), None

    def outer(carry: Any, block: Any) -> tuple[Any, Any]:
        state, status = carry
        (state, kept, sums, status), _ = jax.lax.scan(inner, (state, blank[0], blank[1], status), block)
        return (state, status), (kept, sums, status)

    return jax.lax.scan(outer, (state, blank[2]), samples)[1]
