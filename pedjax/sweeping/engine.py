"""Parameter sets side by side in lanes, a block at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.errors import InputError, suggest
from pedjax.evaluation.landmarks import ALIGNMENTS
from pedjax.packing import pack
from pedjax.recording import Clock, Recording
from pedjax.system import System
from pedjax.systems import system as find_system
from pedjax.tuning.loop import walks_for
from pedjax.tuning.objective import LOSSES, Problem, losses

_LANES = 64
"""Lanes in a block: more fall out of the cache, fewer leave vector units idle."""


@dataclass(frozen=True)
class Sweep:
    """`values` of each path `(N,)`; `loss (N, R)` m of each set on each recording, inf where it diverged."""

    names: tuple[str, ...]
    values: dict[str, np.ndarray]
    loss: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Mean loss over recordings `(N,)`."""
        return self.loss.mean(axis=1)

    @property
    def best(self) -> int:
        """Row of the best set."""
        return int(np.argmin(self.mean))


def sweep(
    recordings: Sequence[Recording],
    values: Mapping[str, np.ndarray],
    system: str | System = "iez",
    params: Any = None,
    *,
    loss: str = "armse",
    alignment: str = "yaw_translation",
    sensor: str = "foot",
    clock: Clock | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Run every parameter set `values[path] (N,)` over every recording and keep the losses only."""
    chosen = find_system(system)
    params = chosen.defaults() if params is None else params
    for what, word, known in (("loss", loss, tuple(LOSSES)), ("alignment", alignment, ALIGNMENTS)):
        if word not in known:
            raise InputError(f"{what} '{word}' is unknown{suggest(word, known)}")
    counts = {len(v) for v in values.values()}
    if len(counts) != 1:
        raise InputError(f"every swept parameter needs equally many values, not {sorted(counts)}")
    count = counts.pop()
    dtype = jnp.result_type(float)
    cast = parameters.cast(params, dtype)
    batch = pack(chosen, cast, walks_for(chosen, params, recordings, sensor, clock, loss), dtype)
    problem = Problem(chosen, loss, alignment)
    width = max(_LANES // batch.packed.slot.shape[1], 1)
    width = min(width, count)
    found = []
    for start in range(0, count, width):
        # the last block is filled up with its own last set, so that all blocks have one shape
        index = np.minimum(np.arange(start, start + width), count - 1)
        block = {path: jnp.asarray(np.asarray(v)[index], dtype) for path, v in values.items()}
        each = np.asarray(losses(problem, cast, block, batch))
        found.append(each[: min(width, count - start)])
        if progress is not None:
            progress(min(start + width, count), count)
    return Sweep(batch.names, {k: np.asarray(v) for k, v in values.items()}, np.concatenate(found))
