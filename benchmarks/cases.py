"""What is measured: signals, packed recordings, a clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.filtering import Packed
from pedjax.recording import Inertial
from pedjax.system import Inputs, Signals
from pedjax.systems.iez import IEZ
from pedjax.walks import Walk

RATE = 200.0


def best_of(work: Callable[[], Any], repeats: int = 3, wall: bool = False) -> float:
    """Least processor time (or wall time) of a few runs, after one that compiles."""
    clock = time.perf_counter if wall else time.process_time
    jax.block_until_ready(work())
    times = []
    for _ in range(repeats):
        start = clock()
        jax.block_until_ready(work())
        times.append(clock() - start)
    return min(times)


def signals(length: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noise about rest for half of each second, motion for the other."""
    rng = np.random.default_rng(0)
    still = (np.arange(length) % 200 < 90)[:, None]
    force = rng.normal(size=(length, 3)) * np.where(still, 0.02, 2.0) + [0, 0, 9.8]
    rate = rng.normal(size=(length, 3)) * np.where(still, 0.01, 1.0)
    return force, rate, np.full(length, 1 / RATE)


def walk(length: int) -> Walk:
    """The signals as a walk with a landmark every five seconds."""
    force, rate, dt = signals(length)
    index = np.arange(0, length, int(5 * RATE))
    place = np.stack([0.01 * index, np.zeros(len(index)), np.zeros(len(index))], axis=1)
    return Walk("benchmark", {"foot": Inertial(np.cumsum(dt), dt, force, rate)}, index, place)


def inputs(params: Any, length: int, dtype: Any) -> Inputs:
    """The signals, prepared for IEZ."""
    given = [jnp.asarray(x, dtype) for x in signals(length)]
    return jax.jit(lambda f, r, d: IEZ.prepare(params, {"foot": Signals(f, r)}, d, RATE))(*given)


def packed(length: int, dtype: Any, **changes: Any) -> tuple[Any, Packed]:
    """Parameters with changes, and one recording in one column, scored every 1000 samples."""
    params = parameters.cast(parameters.replace(IEZ.defaults(), changes), dtype)
    chunk = 1 << round(np.log2(length) / 2)
    length = length // chunk * chunk
    slot = np.full((length, 1), -1)
    slot[::1000] = 0
    which = np.full((length // chunk, 1), -1)
    which[0] = 0
    lanes = jax.tree.map(lambda x: x[..., None], inputs(params, length, dtype))
    return params, Packed(lanes.samples, lanes.opening, jnp.asarray(which), jnp.asarray(slot))


class Case(NamedTuple):
    """Something to measure: `make()` gives the work, whose first run compiles; `told(seconds)` says what came
    of the least wall time of its runs."""

    title: str
    make: Callable[[], Callable[[], Any]]
    told: Callable[[float], str]
    double: bool = False


def compiled(case: Case) -> Callable[[], Any]:
    """Its work, run once."""
    with jax.enable_x64(case.double):
        work = case.make()
        jax.block_until_ready(work())
        return work


def timed(case: Case, work: Callable[[], Any]) -> str:
    """What comes of the least wall time of two runs."""
    with jax.enable_x64(case.double):
        return case.told(best_of(work, 2, wall=True))
