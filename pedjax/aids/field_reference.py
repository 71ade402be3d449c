"""A magnetic field that is not north but stays, as a reference for the gyroscope's bias (and the heading).

Three references, `reference.form`: `differential`, each reading against the one before (Munoz Diaz 2017);
`anchored`, against the first of a steady stretch (`filters.field_turn` has both, and why the second's
covariance is not honest); `state`, against a field that the filter estimates, with what it does not know of
it (`filters.wandering_field`). A detector says which readings count: none, the strength's range over a
window, or the soft weight of `filters.odd_field`."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.detectors.steady import Readings, readings
from pedjax.errors import InputError
from pedjax.filters import covariance, field_turn, odd_field, wandering_field
from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Opening
from pedjax.filters.odd_field import OddField, Oddness
from pedjax.filters.wandering_field import Fields, Wandering
from pedjax.gates import SoftGate, gate, log_positive
from pedjax.lanes import align, matmul, matvec
from pedjax.parameters import group, leaf, parameters, setting
from pedjax.rotations import exp
from pedjax.system import Gated, Signals, Status


@parameters
class Reference(SoftGate):
    """Which reference, which readings count, and how far they are believed."""

    form: str = setting(
        "differential", choices=("none", "differential", "anchored", "state"),
        source="differential: Munoz Diaz 2017",
        meaning="What a reading is held against: nothing, the one before, the first of a steady stretch, or"
        " a field that is estimated.",
    )  # fmt: skip
    noise: str = setting(
        "white", choices=("white", "moving_average"), source="white: Munoz Diaz 2017",
        meaning="Whether two differences of readings that follow share the noise of the one between, as "
        "they do, or are taken as independent (differential form).",
    )  # fmt: skip
    density: Array = leaf(
        0.0015, unit="uT/sqrt(Hz)", low=1e-5, high=100.0, tune=True,
        source="Munoz Diaz 2017, Table 2: 0.015 uT a sample, at 100 Hz",
        meaning="White noise of the magnetometer; raised, readings turn attitude and bias less.",
    )  # fmt: skip
    detector: str = setting(
        "none", choices=("none", "steady", "odd"), source="none: Munoz Diaz 2017, in a homogeneous field",
        meaning="Which readings count: all, those in a steady field, or each the less the odder it is.",
    )  # fmt: skip
    window_s: float = setting(
        0.5, source="kit choice; Munoz Diaz 2017: not printed",
        meaning="Length of the window over which the field must be steady; longer, fewer readings count.",
    )  # fmt: skip
    threshold: Array = leaf(
        0.2, unit="uT", low=1e-3, high=100.0, source="kit choice; Munoz Diaz 2017: not printed", tune=True,
        point=True, when={"detector": "steady"},
        meaning="Range of the strength in a window below which the field is steady; raised, more readings "
        "count.",
    )  # fmt: skip
    odd: OddField = group(OddField, when={"detector": "odd"})
    state: Wandering = group(Wandering, when={"form": "state"})
    patience: Array = leaf(
        60.0, unit="s", low=1.0, high=1e6, source="kit choice",
        meaning="For how long no reading may count before the run is called locked out; raised, it is said "
        "later.",
    )  # fmt: skip


class State(NamedTuple):
    """The last reading `before (3, *L)` µT and whether there was one, `had (*L)`; of the moving average its
    `error (3, *L)`; of the anchored form the `anchor (3, *L)` and whether it is `held (*L)`; of the field
    state `fields`; of the soft weight `oddness`; and for how long
    readings did not count, `idle (*L)` s."""

    before: Array
    had: Array
    error: Array
    anchor: Array
    held: Array
    fields: Fields | tuple[()]
    oddness: Oddness
    idle: Array


def _prepare(p: Any, signals: Signals, dt: Array, rate_hz: float, length: ArrayLike | None) -> Readings:
    assert signals.field is not None
    return readings(signals.field, max(round(p.reference.window_s * rate_hz), 1))


def _start(
    p: Any, site: Any, opening: Opening, estimate: Any, P: Covariance
) -> tuple[State, Any, Covariance]:
    q: Reference = p.reference
    if q.detector == "odd" and q.form != "state":
        raise InputError(
            "reference.detector = odd goes by a field that is estimated, which "
            f"reference.form = {q.form} has not; take detector = steady, or form = state"
        )
    zero = jnp.zeros_like(estimate.attitude[0])
    fields: Fields | tuple[()] = ()
    if q.form == "state":
        fields, P = wandering_field.start(q.state, opening, estimate.attitude, P)
    if q.form == "differential" and q.noise == "moving_average":
        P = covariance.extended(P, {"n": 1.0 + zero})
    one = zero[0]
    return State(zero, one, zero, zero, one, fields, odd_field.start(one), one), estimate, P


class _Look(NamedTuple):
    """A reading, whether it is known, the step and the magnetometer's deviation for it, with lanes."""

    reading: Array
    known: Array
    dt: Array
    sigma: Array


def _step(p: Any, site: Any, state: State, seen: Seen) -> Measured:
    q: Reference = p.reference
    lanes = state.idle.ndim
    own: Readings = seen.own
    step = seen.sample.dt
    known = align(own.known, 0, lanes) * (step > 0) + 0 * state.idle
    dt = jnp.where(step > 0, step, 1.0)
    reading = align(own.field, 1, lanes) + 0 * state.before
    look = _Look(reading, known, dt, q.density / jnp.sqrt(dt) + 0 * state.idle)
    if q.detector == "steady":
        ratio = log_positive(align(own.spread, 0, lanes) + 0 * state.idle) - jnp.log(q.threshold)
        weight = gate(ratio, q.width, q.straight_through)
    else:
        ratio, weight = 0 * state.idle - 1.0, 0 * state.idle + 1.0
    gated = Gated(weight * known, jnp.where(known > 0, ratio, 1.0))
    form = {"differential": _differential, "anchored": _anchored, "state": _of_state}[q.form]
    made = form(p, state, seen, look, gated)
    new: State = made.state
    gated = gated if made.gated is None else made.gated
    idle = jnp.where(gated.weight > 0.5, 0.0, state.idle + step * known)  # a pause is no lock-out
    kept = known > 0
    new = new._replace(
        before=jnp.where(kept, reading, state.before), had=jnp.where(step > 0, known, state.had), idle=idle
    )
    why: Any = Status.LOCKED_OUT
    if isinstance(new.fields, Fields):
        why = jnp.where(new.fields.aligned > 0.5, Status.LOCKED_OUT, Status.NOT_ALIGNED)
    status = jnp.where(idle > q.patience, why, Status.HEALTHY)
    return made._replace(state=new, gated=gated, status=status)


def _differential(p: Any, state: State, seen: Seen, look: _Look, gated: Gated) -> Measured:
    """Against the reading before it."""
    q: Reference = p.reference
    rate, bias = seen.sample.rate, seen.estimate.gyroscope_bias
    densities = (q.density, p.process.gyroscope)
    weight = gated.weight * state.had
    if q.noise == "white":
        rows = field_turn.differential(look.reading, state.before, rate, bias, look.dt, densities)
        return Measured(state, rows, weight)
    P, correction, error = field_turn.chained(
        seen.P, look.reading, state.before, state.error, rate, bias, look.dt, densities, weight
    )
    moves = look.known > 0
    P = {name: jnp.where(moves, x, seen.P[name]) for name, x in P.items()}
    new = state._replace(error=jnp.where(moves, error, state.error))
    return Measured(new, None, None, moved=(P, correction))


def _anchored(p: Any, state: State, seen: Seen, look: _Look, gated: Gated) -> Measured:
    """Against the first reading of the stretch, while it lasts."""
    is_open = gated.weight > 0.5
    begins = is_open & (state.held < 0.5)
    anchor = jnp.where(begins, matvec(seen.estimate.attitude, look.reading), state.anchor)
    rows = field_turn.anchored(look.reading, anchor, seen.estimate.attitude, look.sigma)
    held = jnp.where(seen.sample.dt > 0, jnp.where(is_open, 1.0, 0.0), state.held)
    new = state._replace(anchor=anchor, held=held)
    return Measured(new, rows, gated.weight * jnp.where(is_open & ~begins, state.held, 0.0))


def _of_state(p: Any, state: State, seen: Seen, look: _Look, gated: Gated) -> Measured:
    """Against the field that is estimated."""
    q: Reference = p.reference
    assert isinstance(state.fields, Fields)
    fields, P = wandering_field.evolved(q.state, state.fields, seen.P, seen.sample.dt)
    attitude, correction = seen.estimate.attitude, {}
    if q.state.start == "expected":
        fields, P, turn = wandering_field.aligning(q.state, fields, attitude, P, look.reading, look.known)
        U = exp(turn)
        attitude, correction = matmul(U, attitude), {"t": turn}
        if hasattr(seen.estimate, "velocity"):
            correction["v"] = matvec(U, seen.estimate.velocity) - seen.estimate.velocity
    else:
        fields = wandering_field.begun(fields, attitude, look.reading, look.known)
    rows = wandering_field.rows(q.state, fields, attitude, look.reading, look.sigma)
    oddness = state.oddness
    if q.detector == "odd":
        oddness, weight, ratio = odd_field.judged(
            q.odd, oddness, P, seen.in_filter(rows), look.reading - fields.iron, fields.field, attitude,
            seen.sample.dt, look.known * fields.aligned,
        )  # fmt: skip
        gated = Gated(weight * look.known, jnp.where(look.known > 0, ratio, 1.0))
    gated = gated._replace(weight=gated.weight * fields.aligned)
    new = state._replace(fields=fields, oddness=oddness)
    return Measured(new, rows, gated.weight, gated, moved=(P, correction))


def _after(p: Any, state: State, by: str, correction: dict[str, Array], estimate: Any) -> State:
    fields, error = state.fields, state.error
    if isinstance(fields, Fields):
        fields = wandering_field.corrected(fields, correction)
    if "n" in correction:
        error = error + correction["n"]
    return state._replace(fields=fields, error=error)


def _told(p: Any, state: State, P: Covariance) -> dict[str, Array]:
    fields = state.fields
    if not isinstance(fields, Fields):
        return {}
    found = {"reference_field": fields.field, "reference_field_sigma": covariance.sigma(P, "m")}
    if p.reference.state.iron:
        found |= {"hard_iron": fields.iron, "hard_iron_sigma": covariance.sigma(P, "h")}
    return found


FIELD_REFERENCE = Aid(
    name="field_reference",
    wants=("g",),
    groups=(("reference", Reference),),
    gate="field",
    field=True,
    gaps=True,
    is_on=lambda p: p.reference.form != "none",
    prepare=_prepare,
    start=_start,
    step=_step,
    after=_after,
    told=_told,
)
"""A field that stays, as a reference."""
