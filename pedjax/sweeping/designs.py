"""Where to look: parameter sets on each parameter's own scale."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import qmc

from pedjax import parameters
from pedjax.errors import InputError

DESIGNS = ("sobol", "grid", "random")


def design(
    params: Any, ranges: Mapping[str, Sequence[float]], count: int, kind: str = "sobol", seed: int = 0
) -> dict[str, np.ndarray]:
    """Values `(N,)` of each path of `ranges` (`[low, high]`, or empty for the parameter's bounds).

    `grid` has the same number of steps along each parameter, the most that `count` allows; `sobol` and
    `random` have exactly `count` sets, scrambled by the seed.
    """
    if kind not in DESIGNS:
        raise InputError(f"design '{kind}' is unknown; known are: {', '.join(DESIGNS)}")
    if count < 1 or not ranges:
        raise InputError("a sweep needs at least one parameter and one set")
    paths = list(ranges)
    if kind == "grid":
        steps = max(math.floor(count ** (1 / len(paths)) + 1e-9), 1)
        axis = np.linspace(0.0, 1.0, steps) if steps > 1 else np.array([0.5])
        unit = np.stack([a.ravel() for a in np.meshgrid(*[axis] * len(paths), indexing="ij")], axis=1)
    elif kind == "sobol":
        power = max(math.ceil(math.log2(count)), 0)
        unit = qmc.Sobol(len(paths), rng=np.random.default_rng(seed)).random_base2(power)[:count]
    else:
        unit = np.random.default_rng(seed).random((count, len(paths)))
    specs = parameters.specs(params)
    values = {}
    for column, path in zip(unit.T, paths, strict=True):
        low, high = ranges[path] or (specs[path].low, specs[path].high)
        if not low <= high:
            raise InputError(f"the range of {path} runs from {low:g} down to {high:g}")
        log = specs[path].scale == "log"
        ends = np.log([low, high]) if log else np.array([low, high], float)
        inner = ends[0] + column * (ends[1] - ends[0])
        values[path] = np.exp(inner) if log else inner
    return values
