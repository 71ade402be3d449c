"""What an aid is: one kind of measurement with all that it needs, to be put beside others on a filter.

Zero velocity, zero angular rate, a magnetic heading, a heading heuristic, a map fix: each has parameters, a
state of its own, perhaps a gate, and a step that sees the estimate and gives rows. It is to a filter what a
transformation is to an optimiser in optax.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from jax import Array
from jax.typing import ArrayLike

from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Opening, Sample
from pedjax.filters.kalman import Rows
from pedjax.system import Gated, Signals


class Seen(NamedTuple):
    """What an aid sees at a sample: the `estimate` and its covariance `P` as the aids before it left them,
    the `sample` (with lane axes), what its own `prepare` made of it (`own`), and of the aids before it their
    `gates` by name and what they had to say (`more`). `in_filter` gives its rows as the filter takes them,
    for an aid that weighs its innovation against P itself."""

    estimate: Any
    P: Covariance
    sample: Sample
    own: Any
    gates: Mapping[str, Gated]
    more: Mapping[str, Array]
    in_filter: Callable[[Rows], Rows] = lambda rows: rows


class Measured(NamedTuple):
    """What an aid makes of a sample: its next `state`, `rows` to be updated with (None: nothing) and how much
    of their information counts, `weight (*L)` in [0, 1]; its gate, where it has one; what else is to be
    told, to later aids and to the user; where it does not measure but decides, the covariance and the
    correction by state that it `moved` the filter by, which is done before the rows count; and a `status`
    where it finds the run wanting."""

    state: Any
    rows: Rows | None
    weight: Array | None
    gated: Gated | None = None
    more: dict[str, Array] = {}  # noqa: RUF012
    moved: tuple[Covariance, dict[str, Array]] | None = None
    status: Array | None = None


def _no_state(
    p: Any, site: Any, opening: Opening, estimate: Any, P: Covariance
) -> tuple[Any, Any, Covariance]:
    return (), estimate, P


def _nothing_own(p: Any, signals: Signals, dt: Array, rate_hz: float, length: ArrayLike | None) -> Any:
    return ()


def _unmoved(p: Any, state: Any, by: str, correction: dict[str, Array], estimate: Any) -> Any:
    return state


def _nothing_told(p: Any, state: Any, P: Covariance) -> dict[str, Array]:
    return {}


class Aid(NamedTuple):
    """An aid by its `name`.

    Every function takes the whole parameter tree `p` first and reads its own groups of it.

    - `groups`: name in the tree to class of its parameters. Two aids may share a group, of one class.
    - `gate`: the name of its gate, or None. `reads`: gates that aids before it must have.
    - `wants`: letters of the states that its filter must have.
    - `field`: whether it needs a magnetometer; `gaps`: whether it goes on where that has no readings (NaN).
    - `is_on(p)`: by settings; an aid that is off costs nothing.
    - `prepare(p, signals, dt, rate_hz, length)`: what it needs of each sample beside the signals, time first.
    - `start(p, site, opening, estimate, P) -> state, estimate, P`: its first state; it may mend the first
      estimate, and add states of its own to P (`covariance.extended`), which it then moves by itself in
      `step` and corrects in `after`.
    - `step(p, site, state, seen) -> Measured`.
    - `after(p, state, by, correction, estimate) -> state`: called after each correction of the estimate at
      this sample, whichever aid it was `by`, in the order of aids: for states that are kept in terms of the
      estimate, as fields in navigation axes are.
    - `told(p, state, P)`: what is to be told to the user once all aids of the sample have been heard.
    - `opening_s(p)`: how many seconds of the opening it wants to see; `stand_s(p)`: and how many of the rest
      with which the recording begins, marked in the opening's `stands`; `shortest(p)`: the least a recording
      must last in s, and the path of the setting that asks for it.
    """

    name: str
    step: Callable[[Any, Any, Any, Seen], Measured]
    groups: tuple[tuple[str, type], ...] = ()
    gate: str | None = None
    reads: tuple[str, ...] = ()
    wants: tuple[str, ...] = ()
    field: bool = False
    gaps: bool = False
    is_on: Callable[[Any], bool] = lambda p: True
    prepare: Callable[[Any, Signals, Array, float, ArrayLike | None], Any] = _nothing_own
    start: Callable[[Any, Any, Opening, Any, Covariance], tuple[Any, Any, Covariance]] = _no_state
    after: Callable[[Any, Any, str, dict[str, Array], Any], Any] = _unmoved
    told: Callable[[Any, Any, Covariance], dict[str, Array]] = _nothing_told
    opening_s: Callable[[Any], float] = lambda p: 0.0
    stand_s: Callable[[Any], float] = lambda p: 0.0
    shortest: Callable[[Any], tuple[float, str]] = lambda p: (0.0, "")
