"""The hard-gate losses that tuning selects by: one program for any number of parameter sets."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax.ensemble import Problem, in_blocks, losses
from pedjax.packing import Batches
from pedjax.runtime import lane_count


@partial(jax.jit, static_argnames="problem")
def _blocks(problem: Problem, params: Any, values: dict[str, Array], used: Array, batches: Batches) -> Array:
    """Losses `(B, S, R)` of blocks of sets `values[path] (B, S)`, the first `used` of them."""

    found: Array = in_blocks(lambda block: losses(problem, params, block, batches, "auto"), values, used)
    return found


class Judge:
    """Losses of up to `most` parameter sets at a time on some recordings. Sets are laid out in blocks of as
    many as fill the lanes, so that one set, all starts and a grid around each share one program, which
    `compile` makes ahead of its first use."""

    def __init__(self, problem: Problem, params: Any, names: tuple[str, ...], batches: Batches, most: int):
        self.problem, self.params, self.names, self.batches = problem, params, names, batches
        # recordings take lanes, too: one block is no larger than what fills them
        columns = min(part.packed.which.shape[1] for part in batches.parts)
        self.sets = max(min(lane_count(jnp.result_type(float)) // columns, most), 1)
        self.count = -(-most // self.sets)
        self._lowered: Any = None
        self._program: Any = None

    def _laid(self, values: Mapping[str, Any]) -> tuple[dict[str, Array], int]:
        count = len(next(iter(values.values())))
        index = np.minimum(np.arange(self.count * self.sets), count - 1).reshape(self.count, self.sets)
        return {name: jnp.asarray(np.asarray(values[name], float)[index]) for name in self.names}, count

    def trace(self) -> None:
        """Make what the compiler needs, if it is not there yet."""
        if self._lowered is None:
            laid, _ = self._laid({name: np.ones(1) for name in self.names})
            self._lowered = _blocks.lower(self.problem, self.params, laid, jnp.asarray(0), self.batches)

    def compile(self) -> None:
        """Make the program, if it is not there yet."""
        self.trace()
        if self._program is None:
            self._program = self._lowered.compile()

    def __call__(self, values: Mapping[str, Any]) -> np.ndarray:
        """Loss `(n, R)` of sets `values[path] (n,)` on each recording."""
        self.compile()
        laid, count = self._laid(values)
        used = jnp.asarray(-(-count // self.sets))
        found = self._program(self.params, laid, used, self.batches)
        return np.asarray(found).reshape(-1, found.shape[-1])[:count]
