"""A system made of a filter and a tuple of aids.

At each sample the filter predicts, and the aids act one after the other in the tuple's order: each sees the
estimate as the one before it left it, which for independent noises is the stacked update of all. What an aid
may know of another is decided here: the gates and the `more` of those before it at this sample, nothing else.
The parameter tree is the filter's, with each aid's groups behind it under their own names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cache, partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax.aids.aid import Aid, Seen
from pedjax.detectors.rest import standing_rows, standing_start
from pedjax.errors import InputError
from pedjax.filters import covariance, kalman
from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Filter, Opening, Sample
from pedjax.parameters import grown, latest, redefined
from pedjax.system import Gated, Inputs, Need, Output, Signals, Status, System


class AidedSample(NamedTuple):
    """A sample of the sensor, and what each aid prepared of it, by name."""

    sensor: Sample
    own: dict[str, Any]


class AidedState(NamedTuple):
    """The estimate, its covariance, and the state of each aid by name."""

    estimate: Any
    P: Covariance
    aids: dict[str, Any]


def aided(
    name: str,
    filter: Filter,
    aids: Sequence[Aid],
    title: str = "",
    role: str = "foot",
    values: Mapping[str, tuple[Any, str]] | None = None,
) -> System:
    """The system `name`: that filter with those aids, in that order, on the sensor of that role. `values` are
    its own defaults where they differ from those of its parts: dotted path to value and source.

    An aid that reads a gate which none before it has, two of one name, or a group of parameters that two
    aids define differently, is an `InputError`.
    """
    aids = tuple(aids)
    _check(name, aids)
    _check_states(name, filter, aids)
    _check_names(name, filter, aids)
    _groups_of(name, aids)
    own_values = tuple((values or {}).items())
    magnetic = any(aid.field for aid in aids)
    gaps = all(aid.gaps for aid in aids if aid.field)

    def prepare(
        p: Any, sensors: Mapping[str, Signals], dt: Array, rate_hz: float, length: ArrayLike | None = None
    ) -> Inputs:
        signals = sensors[role]
        on = [aid for aid in aids if aid.is_on(p)]
        own = {aid.name: aid.prepare(p, signals, dt, rate_hz, length) for aid in on}
        levelling_s = filter.opening_s(p)
        stand_s = max((aid.stand_s(p) for aid in on), default=0.0)
        seconds = max((levelling_s, stand_s, *(aid.opening_s(p) for aid in on)))
        first, still = (max(round(s * rate_hz), 1) for s in (seconds, levelling_s))
        field = None if signals.field is None else signals.field[:first]
        row = jnp.arange(dt[:first].shape[0])
        levels = (row < still).astype(dt.dtype)
        rest_s = filter.rest_s(p)
        rest = standing_start(signals.rate, dt, rate_hz, rest_s, length) if rest_s else None
        stands = None
        if stand_s:  # never less than what levels
            most = standing_rows(signals.rate, dt, rate_hz, stand_s, length)
            stands = (row < jnp.maximum(most, still)).astype(dt.dtype)
        opening = Opening(
            dt[:first], signals.force[:first], signals.rate[:first], field, levels, rest, stands
        )
        return Inputs(AidedSample(Sample(dt, signals.force, signals.rate, signals.field), own), opening)

    def start(p: Any, site: Any, opening: Opening) -> AidedState:
        estimate, P = filter.start(p, opening)
        states = {}
        for aid in aids:
            if aid.is_on(p):
                states[aid.name], estimate, P = aid.start(p, site, opening, estimate, P)
        return AidedState(estimate, P, states)

    def tell(p: Any, states: dict[str, Any], by: str, correction: dict[str, Array], estimate: Any) -> Any:
        """The corrected estimate, of which the aids' states, changed in place, hear."""
        estimate = filter.correct(estimate, correction)
        for other in aids:
            if other.name in states:
                states[other.name] = other.after(p, states[other.name], by, correction, estimate)
        return estimate

    def step(p: Any, site: Any, state: AidedState, sample: AidedSample) -> tuple[AidedState, Output]:
        sensor = sample.sensor.in_lanes(state.estimate.position.ndim - 1)
        estimate, P = filter.predict(p, state.estimate, state.P, sensor)
        states = dict(state.aids)
        gates: dict[str, Gated] = {}
        more: dict[str, Array] = {}
        faults = [] if filter.status is None else [filter.status(estimate)]
        for aid in (aid for aid in aids if aid.is_on(p)):
            own = sample.own[aid.name]
            seen = Seen(estimate, P, sensor, own, gates, more, partial(filter.rows, estimate))
            made = aid.step(p, site, states[aid.name], seen)
            states[aid.name], rows, weight, gated, said, moved, found = made
            if found is not None:
                faults.append(found)
            if aid.gate is not None:
                assert gated is not None
                gates[aid.gate] = gated
            more |= said
            if moved is not None:
                P, correction = moved
                estimate = tell(p, states, aid.name, correction, estimate)
            if rows is not None:
                assert weight is not None
                P, correction = kalman.update(P, filter.rows(estimate, rows), weight)
                estimate = tell(p, states, aid.name, correction, estimate)
        for aid in aids:
            if aid.name in states:
                more |= aid.told(p, states[aid.name], P)
        sound = jnp.isfinite(jnp.sum(estimate.position, 0)) & covariance.is_positive(P)
        status = jnp.where(sound, Status.HEALTHY, Status.DIVERGED).astype(jnp.int32)
        for fault in faults:
            status = jnp.where(status == 0, fault, status).astype(jnp.int32)
        sigma = {field: covariance.sigma(P, letter) for field, letter in filter.states}
        nothing = jnp.zeros_like(estimate.position[0])
        for aid in aids:  # a gate that is off is shut
            if aid.gate is not None:
                gates.setdefault(aid.gate, Gated(nothing, nothing))
        return AidedState(estimate, P, states), Output(estimate, sigma, gates, status, more)

    def shortest(p: Any) -> tuple[float, str]:
        own = [aid.shortest(p) for aid in aids if aid.is_on(p)]
        return max(own, default=(0.0, ""))

    return System(
        name=name,
        title=title or f"{filter.name} filter with {', '.join(aid.name.replace('_', ' ') for aid in aids)}",
        needs=(Need(role, magnetic, magnetic and gaps),),
        gates=tuple(aid.gate for aid in aids if aid.gate is not None),
        defaults=lambda: _parameters(name, filter.parameters, _groups_of(name, aids), own_values)(),
        prepare=prepare,
        start=start,
        step=step,
        shortest=shortest,
    )


def _groups_of(name: str, aids: Sequence[Aid]) -> tuple[tuple[str, type], ...]:
    """Path and class of each group of parameters, with the detectors that were registered since."""
    groups: dict[str, type] = {}
    for aid in aids:
        for path, cls in aid.groups:
            if groups.setdefault(path, cls) is not cls:
                raise InputError(
                    f"system '{name}': aids define the parameters '{path}' in two ways; leave one of them out"
                )
    return tuple((path, latest(cls)) for path, cls in groups.items())


_STATES = {
    "t": "attitude (as a small rotation)",
    "g": "gyroscope bias",
    "p": "position",
    "v": "velocity",
    "a": "accelerometer bias",
}


def _check_states(name: str, filter: Filter, aids: Sequence[Aid]) -> None:
    own = {letter for _, letter in filter.states}
    for aid in aids:
        for letter in aid.wants:
            if letter not in own:
                what = _STATES.get(letter, letter)
                raise InputError(
                    f"system '{name}': the aid '{aid.name}' needs the {what}, which the filter "
                    f"'{filter.name}' does not estimate; put it on another filter (inertial has all)"
                )


def _check_names(name: str, filter: Filter, aids: Sequence[Aid]) -> None:
    own = {f.name for f in fields(filter.parameters)}
    taken = sorted(own & {path for aid in aids for path, _ in aid.groups})
    if taken:
        raise InputError(
            f"system '{name}': an aid's parameters are called '{taken[0]}', as the filter's are; rename them"
        )


@cache  # one class for one system: another would compile another program
def _parameters(
    name: str,
    base: type,
    groups: tuple[tuple[str, type], ...],
    values: tuple[tuple[str, tuple[Any, str]], ...],
) -> type:
    camel = "".join(part.capitalize() for part in name.replace("-", "_").split("_"))
    made: type = grown(base, dict(groups), f"{camel}Parameters", f"All parameters of {name}.")
    return redefined(made, dict(values)) if values else made


def _check(name: str, aids: Sequence[Aid]) -> None:
    known: set[str] = set()
    for aid in aids:
        missing = set(aid.reads) - known
        if missing:
            raise InputError(
                f"system '{name}': the aid '{aid.name}' reads the gate '{min(missing)}', which no aid before "
                "it has; put one that has it before it"
            )
        if aid.gate in known:
            raise InputError(f"system '{name}': two aids have the gate '{aid.gate}'; leave one of them out")
        if aid.gate is not None:
            known.add(aid.gate)
    names = [aid.name for aid in aids]
    if len(set(names)) < len(names):
        raise InputError(f"system '{name}': an aid is there twice; leave one of them out")
