"""What an estimator is: four pure functions over a parameter tree, and no more than that."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from jax import Array

from pedjax.filters.strapdown import Navigation


class Signals(NamedTuple):
    """What a sensor measured, on one clock: specific force and angular rate `(T, 3)` in m/s^2 and rad/s, `dt
    (T,)` s, and the magnetic field `(T, 3)` in µT, None where there is no magnetometer."""

    force: Array
    rate: Array
    dt: Array
    field: Array | None = None


class Inputs(NamedTuple):
    """What a system's `prepare` makes of a recording.

    `samples` is a tree with time first and the lanes, if any, last; `opening` is what the first instant
    needs (such as the mean force of the first still samples), without a time axis. Neither depends on a
    tunable number, so that every parameter set of a sweep shares them.
    """

    samples: Any
    opening: Any


class Output(NamedTuple):
    """What a step reports beside its state, lanes last; the caller keeps what it needs of it.

    `stance` is the weight of the zero-velocity update, `log_ratio` the stance statistic over its threshold
    (log), `variances (15, *L)` the diagonal of the covariance, `more` what a system has to say beside.
    """

    navigation: Navigation
    stance: Array
    log_ratio: Array
    variances: Array
    healthy: Array
    more: dict[str, Array] = {}  # noqa: RUF012


class System(NamedTuple):
    """A published estimator.

    `defaults()` gives its parameters; `prepare(parameters, signals, rate_hz, length)` its `Inputs`, from the
    settings alone (samples from `length` on are padding, with dt = 0); `tunable(parameters)` the paths that
    tuning and sweeps vary unless told otherwise; `start(parameters, opening)` the first state, which has a
    `navigation` and a `healthy`; and `step(parameters, state, sample)` the next state and an `Output`. The
    last three are pure and take leaves with any trailing lanes.
    """

    name: str
    title: str
    defaults: Callable[[], Any]
    tunable: Callable[[Any], tuple[str, ...]]
    prepare: Callable[..., Inputs]
    start: Callable[[Any, Any], Any]
    step: Callable[[Any, Any, Any], tuple[Any, Output]]
    magnetic: bool = False
    """Whether it needs a magnetometer."""
