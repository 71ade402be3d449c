"""Operating points: from a threshold of a detector's statistic to parameters.

Which leaves move, and how, is said where they are made (`leaf(..., point=True, moves=...)`), so that a
detector of your own needs nothing here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from pedjax import parameters
from pedjax.errors import InputError
from pedjax.parameters import Spec


class Reached(NamedTuple):
    """Parameters at an operating point, by path, and the probabilities that they reach."""

    parameters: dict[str, float | str]
    p_detection: float
    p_false_alarm: float


def points_of(own: Any, detector: str) -> dict[str, Spec]:
    """The operating points among a detector's `own` parameters, by path in them."""
    found = {path: spec for path, spec in parameters.specs(own).items() if spec.point}
    if not found:
        raise InputError(
            f"detector '{detector}' has no operating point: make the leaf that its statistic is held against "
            "with point=True"
        )
    return found


def is_searched(own: Any, detector: str) -> bool:
    """Whether no threshold is among the points, so that values for them have to be found."""
    return all(spec.moves == "search" for spec in points_of(own, detector).values())


def unit_of(own: Any, detector: str) -> float:
    """What the statistic is held against: the first of the points; 1 where those are searched."""
    first, spec = next(iter(points_of(own, detector).items()))
    return 1.0 if spec.moves == "search" else float(parameters.get(own, first))


def moved(own: Any, detector: str, threshold: float, unit: float) -> dict[str, float]:
    """The points, by path, with which a statistic that is held against `unit` is held against `threshold`:
    one takes the threshold, several go together."""
    factor = threshold / unit
    values = {}
    for path, spec in points_of(own, detector).items():
        value = float(parameters.get(own, path))
        if spec.moves == "root":
            values[path] = value * float(np.sqrt(factor))
        elif spec.moves == "threshold":
            values[path] = threshold * (value / unit)  # exact where the unit is this one
    return values


def searched(
    own: Any, detector: str, passing: Callable[[dict[str, float]], int], wanted: int
) -> dict[str, float]:
    """By path, the value of the first point with which as many windows pass as `wanted`, by bisection on its
    own scale between its bounds; where none does it, an end of the last one. `passing` counts those that pass
    with such a value; more do the larger it is."""
    best: dict[str, float] = {}
    for path, spec in points_of(own, detector).items():
        if passing({path: spec.low}) <= wanted <= passing({path: spec.high}):
            return {path: _bisected(spec, lambda x, path=path: passing({path: x}) >= wanted)}  # type: ignore[misc]
        best = {path: spec.high if wanted else spec.low}
    return best


def _bisected(spec: Spec, enough: Callable[[float], bool]) -> float:
    """The least value that is enough, between the bounds of a leaf, on its own scale."""
    low, high = spec.low, spec.high
    for _ in range(40):
        middle = float(np.sqrt(low * high)) if spec.scale == "log" else (low + high) / 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high
