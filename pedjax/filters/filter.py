"""What a filter is: an estimate with its covariance, started, predicted and corrected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from pedjax.detectors.rest import Rest
from pedjax.filters.covariance import Covariance
from pedjax.filters.kalman import Rows
from pedjax.lanes import align


class Sample(NamedTuple):
    """One sample of a sensor: `dt` s, `force (3, *L)` m/s^2, `rate (3, *L)` rad/s, and `field (3, *L)` µT in
    body axes or None."""

    dt: Array
    force: Array
    rate: Array
    field: Array | None = None

    def in_lanes(self, lanes: int) -> Sample:
        """With unit axes for that many lane axes."""
        field = None if self.field is None else align(self.field, 1, lanes)
        return Sample(
            align(self.dt, 0, lanes), align(self.force, 1, lanes), align(self.rate, 1, lanes), field
        )


class Opening(NamedTuple):
    """The first samples, time first: `dt (n, *L)`, `force`, `rate`, `field (n, 3, *L)` as in `Sample`, and
    `still (n, *L)`, 1 for the samples that level the start. Rows with dt = 0 are padding. `rest`, without
    rows, is what was measured of the standing start, None where the filter asks for none; `stands (n, *L)`, 1
    for the samples of that start, None where no aid asks for them."""

    dt: Array
    force: Array
    rate: Array
    field: Array | None
    still: Array
    rest: Rest | None = None
    stands: Array | None = None


def still_mean(opening: Opening, values: Array) -> Array:
    """Mean `(3, *L)` of values `(n, 3, *L)` over the samples that level the start."""
    counts = (opening.still > 0)[:, None]
    return jnp.sum(jnp.where(counts, values, 0.0), axis=0) / jnp.sum(opening.still, axis=0)


def _as_they_are(estimate: Any, rows: Rows) -> Rows:
    return rows


class Filter(NamedTuple):
    """An estimator of motion, on which aids build.

    `parameters` is the class of its parameters, to which aids add groups. `opening_s(p)` is how much of the
    walk `start(p, opening) -> estimate, P` levels by, `predict(p, estimate, P, sample)` moves both on by a
    sample, `correct(estimate, correction)` adds a correction by state, and `states` names the field of the
    estimate and the letter of the covariance that belong together. `rest_s(p)` is how long a standing start
    the opening's `rest` is at most; 0: the filter asks for none. Aids speak of the attitude's error as a
    small rotation t in navigation axes; a filter that has it otherwise says by `rows(estimate, rows)` what
    these are to it. `status(estimate)` tells where the estimate is not to be trusted, beside not being a
    number."""

    name: str
    parameters: type
    opening_s: Callable[[Any], float]
    start: Callable[[Any, Opening], tuple[Any, Covariance]]
    predict: Callable[[Any, Any, Covariance, Sample], tuple[Any, Covariance]]
    correct: Callable[[Any, dict[str, Array]], Any]
    states: tuple[tuple[str, str], ...]
    rest_s: Callable[[Any], float] = lambda p: 0.0
    rows: Callable[[Any, Rows], Rows] = _as_they_are
    status: Callable[[Any], Array] | None = None
