"""What an estimator is: a few pure functions over a parameter tree, and the nouns that they speak.

    sensors, dt ──prepare──► Inputs(samples, opening)
    opening ─────start─────► State                       once for each parameter set and recording
    State, sample ──step──► State, Output                scanned over time

Everything here has lanes last: a scalar is `(*L)`, a vector `(3, *L)`, a matrix `(3, 3, *L)`, where L are the
axes of parameter sets and recordings, which a system never counts or names. Parameters come as leaves `()` or
`(*L)`; `lanes.align` and broadcasting do the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from jax import Array
from jax.typing import ArrayLike


class Need(NamedTuple):
    """A sensor that a system needs: its `role` (foot, waist, pocket), which is also the name it is looked for
    by unless the user says otherwise, whether it must have a magnetometer (`field`), and whether that may
    lack readings for a while (`gaps`; they are NaN)."""

    role: str
    field: bool = False
    gaps: bool = False


class Signals(NamedTuple):
    """What one sensor measured, on the clock of the first: specific force and angular rate `(T, 3)` in m/s^2
    and rad/s, and the magnetic field `(T, 3)` in µT, None where the system needs none."""

    force: Array
    rate: Array
    field: Array | None = None


class Inputs(NamedTuple):
    """What a system's `prepare` makes of a recording.

    `samples` is a tree with time first and the lanes, if any, last; `opening` is what the start is made of, a
    stretch of the first samples, time first too, in which rows with dt = 0 are padding, and what was measured
    of a longer one, without time. Neither depends on a tunable number, so that every parameter set of a sweep
    shares them.
    """

    samples: Any
    opening: Any


class Gated(NamedTuple):
    """How far a gate is open: its `weight` in [0, 1] and the log of its statistic over the threshold, below 0
    where the hard test passes; `(*L)` both."""

    weight: Array
    log_ratio: Array


class Status(IntEnum):
    """Why a run is not healthy. A system reports it at each sample; whoever runs it keeps the first."""

    HEALTHY = 0
    DIVERGED = 1
    GIMBAL = 2
    OFF_THE_MAP = 3
    NOT_ALIGNED = 4
    LOCKED_OUT = 5


REASONS: dict[int, str] = {
    Status.HEALTHY: "healthy",
    Status.DIVERGED: "the filter left the numbers (not finite, or no covariance)",
    Status.GIMBAL: "the attitude came to where its angles are not defined",
    Status.OFF_THE_MAP: "the position left the map",
    Status.NOT_ALIGNED: "the start could not be aligned",
    Status.LOCKED_OUT: "no reading of the magnetic field has fitted for long: the heading is the gyroscope's",
}
"""Status to a sentence. A system of your own may add codes from 100 on."""


class Output(NamedTuple):
    """What a step reports beside its state, lanes last; the caller keeps what it needs of it.

    `estimate` is a NamedTuple with `position (3, *L)` and `attitude (3, 3, *L)`, which is all that others may
    assume, and fields of its own; `sigma` standard deviations `(3, *L)` by field of it; `gates` by name;
    `status (*L)` int32, see `Status`; `more` what the system has to say beside.
    """

    estimate: Any
    sigma: dict[str, Array]
    gates: dict[str, Gated]
    status: Array
    more: dict[str, Array] = {}  # noqa: RUF012


class Prepare(Protocol):
    """Inputs of a recording, from settings alone: pure, jitted, shared by all parameter sets.

    `sensors` by role, `dt (T,)` s (the step that ends at each sample), `rate_hz` the sampling rate in whole
    Hz, which may set the length of windows. Samples from `length` on are padding, with dt = 0. What comes out
    for a sample may depend on later ones only where a setting says so.
    """

    def __call__(  # noqa: D102
        self,
        parameters: Any,
        sensors: Mapping[str, Signals],
        dt: Array,
        rate_hz: float,
        length: ArrayLike | None = None,
        /,
    ) -> Inputs: ...


class Start(Protocol):
    """The first state, from the opening: pure, with any lanes, called once for each parameter set and
    recording, so that it may take its time (a seconds-long alignment). Every leaf has all lanes."""

    def __call__(self, parameters: Any, site: Any, opening: Any, /) -> Any: ...  # noqa: D102


class Step(Protocol):
    """The next state and what is to be said of it: pure, with any lanes, causal, and finite where dt = 0."""

    def __call__(  # noqa: D102
        self, parameters: Any, site: Any, state: Any, sample: Any, /
    ) -> tuple[Any, Output]: ...


class System(NamedTuple):
    """An estimator.

    `needs` are its sensors, the first of which gives clock, track and truth; `gates` the names of its gates,
    the first of which is what bounds its drift: warnings and counts speak of it (none: nothing is said).
    `defaults()` gives the parameters. `shortest(parameters)` is the least a recording must last in s, and the
    path of the setting that asks for it. `read_site(path)` reads what `--map` names, data beside the samples
    that `start` and `step` are given: one tree for a whole batch, without lanes.
    """

    name: str
    title: str
    needs: tuple[Need, ...]
    gates: tuple[str, ...]
    defaults: Callable[[], Any]
    prepare: Prepare
    start: Start
    step: Step
    shortest: Callable[[Any], tuple[float, str]] = lambda parameters: (0.0, "")
    read_site: Callable[[Path], Any] | None = None
    reasons: tuple[tuple[int, str], ...] = ()
    """Sentences for status codes of its own, from 100 on."""

    @property
    def magnetic(self) -> bool:
        """Whether it needs a magnetometer."""
        return any(need.field for need in self.needs)

    def reason(self, status: int) -> str:
        """Why a run is not healthy, in words."""
        return {**REASONS, **dict(self.reasons)}.get(status, f"status {status}")
