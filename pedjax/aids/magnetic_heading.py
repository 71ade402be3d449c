"""Magnetic heading: where the field is quasi-static, its horizontal direction tells the yaw (Ma 2018).

Once in each stance a look at the field, a detector over the last looks, and a row on the attitude. Beyond the
paper: a first yaw as certain as the start deserves; heading noise from field, tilt and oddity; tails heavier
than a Gaussian's, by which a heading far from the expected one counts less and none is locked out for ever;
updates that ask of the field only that it is what it was (Afzal 2011), anchored at the window's start or from
look to look; and hard iron that changes while walking, tracked from turning and taken off the readings.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax import rotations
from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.aids.zero_velocity import TELL_NO_YAW
from pedjax.calibration.attitude import Earth, heading_variance
from pedjax.detectors import field as detectors
from pedjax.errors import InputError
from pedjax.filters import adaptive, compass, compensation, hard_iron, kalman, measurements, rivals
from pedjax.filters.adaptive import Adaptive
from pedjax.filters.compass import Body, Foot, HeadingNoise, Level, Looking, Looks
from pedjax.filters.compensation import Compensation
from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Opening, still_mean
from pedjax.filters.hard_iron import TrackerParameters
from pedjax.filters.rivals import RivalParameters, Rivals
from pedjax.gates import gate
from pedjax.lanes import align, constant, hypotenuse, lane_shape, matmul
from pedjax.parameters import group, leaf, parameters, setting
from pedjax.system import Gated, Signals

_KIT = "kit choice"
_QUARTER_TURN = 1.5707963267948966


@parameters
class Tracker(TrackerParameters):
    """The tracker of hard iron; `lag_s`, by which the magnetometer is behind the gyroscope, is a fixed choice
    here, since every parameter set shares the signals.

    A rate that is sampled, not averaged over its interval, makes half an interval of it, less the delay of
    the gyroscope's own filter. The defaults are for a field that hardly changes along the path; preset
    `ma2018_tracked` is for buildings.
    """

    lag_s: float = setting(
        0.0, source="0: none",
        meaning="Time by which the magnetometer is behind the gyroscope; the tracker turns the field by "
        "rates that much older.",
    )  # fmt: skip


@parameters
class Compass:
    """What is made of the field."""

    update: str = setting(
        "heading", choices=("heading", "anchored", "differential", "none"), source="Ma 2018; Afzal 2011",
        meaning="What a quasi-static field corrects: the heading; the attitude, from an anchor or look "
        "to look; or nothing.",
    )  # fmt: skip
    row: str = setting(
        "full", choices=("full", "simple"), source="Ma 2018; simple: [0, 0, 1]",
        meaning="Row of a heading whose field the attitude levels: full, with the influence of tilt, or "
        "simple, of yaw alone, as it is where the force levels.",
    )  # fmt: skip
    start: str = setting(
        "field", choices=("field", "given"), source=f"{_KIT}: yaw from the first field",
        meaning="Whether the first yaw comes from the field of the start, as initial.alignment reads it, or "
        "is given as initial.heading.",
    )  # fmt: skip
    hard_iron: str = setting(
        "fixed", choices=("fixed", "tracked"), source="fixed: published",
        meaning="Whether hard iron stays as calibrated, or is tracked while walking and taken off the "
        "readings.",
    )  # fmt: skip
    reference: str = setting(
        "running", choices=("running", "given"), source=_KIT,
        meaning="Which strength and inclination count as undisturbed: the running mean of the looks, or "
        "those given.",
    )  # fmt: skip
    recovery: str = setting(
        "none", choices=("none", "rivals"), source="none: published",
        meaning="What happens where looks keep saying that the yaw is wrong: nothing, or a rival heading is "
        "kept beside and takes over once it is the likelier.",
    )  # fmt: skip
    gyroscope_rows: bool = setting(
        False, source="Afzal 2011: option",
        meaning="Whether a quasi-static field in stance also corrects the gyroscope's bias by how the "
        "field turns.",
    )  # fmt: skip
    declination: Array = leaf(
        0.0, unit="rad", low=-3.2, high=3.2, scale="linear", source="0: magnetic north",
        meaning="Angle by which magnetic north lies east of true north; raised, headings and track turn "
        "clockwise.",
    )  # fmt: skip
    start_sigma: Array = leaf(
        0.1, unit="rad", low=1e-4, high=3.2, source=f"{_KIT}: as rooms turn the field", tune=True,
        when={"start": "field"},
        meaning="Standard deviation of the first yaw that the field gives, beside what the start itself "
        "shows; raised, early headings turn the track more.",
    )  # fmt: skip
    tail: Array = leaf(
        1e6, unit="1", low=0.1, high=1e9, source="1e6, a Gaussian: published", tune=True,
        when={"update": ("heading", "anchored", "differential")},
        meaning="Degrees of freedom of the innovation's noise, large for a Gaussian; raised, outlying "
        "headings count for more.",
    )  # fmt: skip
    strength: Array = leaf(
        48.0, unit="uT", low=10.0, high=100.0, source=f"{_KIT}: mid-latitudes",
        when={"reference": "given", "update": "heading"},
        meaning="Strength of the undisturbed field; raised, weak fields count as odder and strong ones "
        "less so (noise.oddity).",
    )  # fmt: skip
    inclination: Array = leaf(
        1.1, unit="rad", low=-1.6, high=1.6, scale="linear", source=_KIT,
        when={"reference": "given", "update": "heading"},
        meaning="Dip of the undisturbed field below the horizon; raised, flat fields count as odder, "
        "steep ones less so.",
    )  # fmt: skip
    looking: Looking = group(Looking)
    body: Body = group(Body)
    level: Level = group(Level)
    noise: HeadingNoise = group(HeadingNoise)
    adaptive: Adaptive = group(Adaptive, when={"update": ("heading", "anchored", "differential")})
    compensation: Compensation = group(Compensation, when={"update": "heading"})
    tracker: Tracker = group(Tracker, when={"hard_iron": "tracked"})
    rival: RivalParameters = group(RivalParameters, when={"recovery": "rivals", "update": "heading"})

    def north(self) -> Array:
        """The azimuth of the undisturbed horizontal field, rad counter-clockwise from east."""
        return _QUARTER_TURN - self.declination

    def earth(self, like: Array) -> Earth:
        """The undisturbed field as given; `like (*L)` is zeros."""
        return Earth(self.strength + like, self.inclination + like, self.north() + like)

    def looks(self) -> Looking:
        """When it looks, and what levels: the attitude where the field tells of the tilt, too."""
        tilted = self.update in ("anchored", "differential")
        return replace(self.looking, levelling="attitude") if tilted else self.looking

    def only_looking(self) -> Compass:
        """The same looks, of which nothing is made: no detector has a say in what it is given."""
        return replace(self, update="none", gyroscope_rows=False, recovery="none", looking=self.looks())

    def compensates(self) -> bool:
        """Whether the start's disturbance is allowed for; an `InputError` where that has no meaning."""
        on = self.compensation.mode != "none" and self.update == "heading"
        if on and self.reference != "given":
            raise InputError(
                f"compass.compensation.mode = {self.compensation.mode} needs to know the undisturbed field; "
                "set compass.reference = given, with its compass.strength and compass.inclination"
            )
        return on

    def recovers(self) -> bool:
        """Whether rival headings are kept; an `InputError` where they cannot be."""
        if self.recovery == "rivals" and self.update in ("anchored", "differential"):
            raise InputError(
                f"compass.recovery = rivals goes by headings, and compass.update = {self.update} has none; "
                "set compass.update = heading, or compass.recovery = none"
            )
        return self.recovery == "rivals" and self.update == "heading"


class State(NamedTuple):
    """The looks at the field; whether it was `quasi`-static at the last one; the `anchor (3, *L)` that it is
    compared with; the `reference (2, *L)` strength and inclination; the field `before` `(3, *L)` in body
    axes; the `tracker` of hard iron, and the `rivals` of the heading, if there are such; the field that the
    `start` showed, `(3, *L)` in navigation axes, where its disturbance is allowed for; and what an adaptive
    noise remembers, `usual`."""

    looks: Looks
    quasi: Array
    anchor: Array
    reference: Array
    before: Array
    tracker: hard_iron.State | tuple[()]
    rivals: Rivals | tuple[()]
    start: Array | tuple[()]
    usual: adaptive.Memory | tuple[()]


def _prepare(p: Any, signals: Signals, dt: Array, rate_hz: float, length: ArrayLike | None) -> Any:
    """The rate `(T, 3)` when the field was so, if that was not now."""
    q = p.compass
    if q.hard_iron == "tracked" and q.tracker.lag_s > 0:
        return hard_iron.delayed(signals.rate, dt, q.tracker.lag_s)
    return ()


def _start(p: Any, site: Any, opening: Opening, nav: Any, P: Covariance) -> tuple[State, Any, Covariance]:
    """With `compass.start` = "field" the first yaw is the compass's."""
    assert opening.field is not None
    mean_force, mean_field = still_mean(opening, opening.force), still_mean(opening, opening.field)
    like = jnp.zeros(lane_shape(p, mean_force[0]), mean_force.dtype)
    force = align(mean_force, 1, like.ndim) + 0 * like
    mag = compass.in_body(p.compass.body, align(mean_field, 1, like.ndim) + 0 * like)
    seen = compass.levelled(nav.attitude, force, mag, p.compass.level)
    own = jnp.stack([detectors.strength(seen), detectors.inclination(seen)])
    given = p.compass.reference == "given"
    reference = jnp.stack([p.compass.strength + like, p.compass.inclination + like]) if given else own
    if p.compass.start == "field" and p.initial.alignment == "levelling":
        yaw = rotations.wrap(p.compass.north() - detectors.azimuth(seen))
        turn = rotations.from_euler(0 * yaw, 0 * yaw, yaw)
        nav = nav._replace(attitude=matmul(turn, nav.attitude))
        strays = align(still_mean(opening, (opening.field - mean_field) ** 2), 1, like.ndim)
        known = reference if p.compass.update == "heading" else own
        earth = Earth(known[0], known[1], p.compass.north() + like)
        shown = heading_variance(seen, earth, P["tt"][0, 0], jnp.sum(strays, axis=0) / 3)
        P = P | {"tt": P["tt"].at[2, 2].set(p.compass.start_sigma**2 + shown + 0 * like)}
    looks = compass.first(nav.attitude, p.field.window)
    tracker = hard_iron.start(p.compass.tracker, mag) if p.compass.hard_iron == "tracked" else ()
    others = rivals.none(p.compass.rival, nav.position) if p.compass.recovers() else ()
    start = _shown(p, opening, nav.attitude) if p.compass.compensates() else ()
    usual = adaptive.start(p.compass.adaptive, like)
    return State(looks, like, jnp.zeros_like(mag), reference, mag, tracker, others, start, usual), nav, P


def _shown(p: Any, opening: Opening, attitude: Array) -> Array:
    """The field of the start `(3, *L)` in navigation axes: of all of the rest that aligned it, if any did."""
    if opening.stands is not None:
        opening = opening._replace(still=jnp.where(opening.dt > 0, opening.stands, 0.0))
    assert opening.field is not None
    lanes, like = attitude.ndim - 2, 0 * attitude[0]
    force, field = (align(still_mean(opening, x), 1, lanes) for x in (opening.force, opening.field))
    mag = compass.in_body(p.compass.body, field + like)
    return compass.levelled(attitude, force + like, mag, p.compass.level)


def _step(p: Any, site: Any, state: State, from_: Seen) -> Measured:
    """A look, and a row as far as the field is quasi-static."""
    nav, P, stance = from_.estimate, from_.P, from_.gates["stance"].weight
    lanes = stance.ndim
    dt, force, rate, field = from_.sample
    assert field is not None
    mag = compass.in_body(p.compass.body, field)
    q, north = p.compass, p.compass.north()
    tracker = state.tracker
    if isinstance(tracker, hard_iron.State):
        late = rate if isinstance(from_.own, tuple) else align(from_.own, 1, lanes)
        tracker = hard_iron.step(q.tracker, tracker, late, mag, dt)
        mag = mag - tracker.offset

    foot = Foot(nav.attitude, P["tt"][2, 2], force, mag, dt, stance)
    looks, now = compass.look(q.looks(), q.level, state.looks, foot)
    seen = looks.window[-1]
    ratio = detectors.log_ratio(p.field, looks.window, north)
    enough = 0 if p.field.detector == "none" else p.field.window
    whole = jnp.where(looks.follow > enough, 1.0, 0.0)
    quasi = whole * gate(ratio, p.field.width, p.field.straight_through)
    begins = (now > 0) & (quasi > 0.5) & (state.quasi <= 0.5)
    anchor = jnp.where(begins, looks.window[0].field, state.anchor)
    sigma, sigma_field = compass.heading_sigma(q.noise, seen.field, state.reference), q.noise.field
    if isinstance(tracker, hard_iron.State):
        unsure = tracker.P["oo"]
        sigma = jnp.sqrt(sigma * sigma + compass.offset_variance(nav.attitude, seen.field, unsure))
        every = unsure[0, 0] + unsure[1, 1] + unsure[2, 2]
        twice = 2 * every  # half a turn on, an offset counts twice
        sigma_field = jnp.sqrt(sigma_field * sigma_field + twice)
    innovation = rotations.wrap(north - detectors.azimuth(seen.field))
    if not isinstance(state.start, tuple):
        innovation, added = _compensated(q, state.start, seen.field, innovation, sigma, P["tt"][2, 2])
        sigma = jnp.sqrt(sigma * sigma + added)
    usual, alpha = state.usual, None
    rows, weight = None, 0.0 * now
    if q.update != "none":
        if q.update == "heading":
            rows = measurements.heading(innovation, _heading_row(q, seen.field), sigma)
        else:
            against = anchor if q.update == "anchored" else looks.window[-2].field
            rows = measurements.same_field(seen.field, against, sigma_field)
        if q.adaptive.law != "none":
            usual, rows, alpha = adaptive.adapted(q.adaptive, usual, P, rows, now)
        far = kalman.normalised_innovation(P, rows)
        weight = now * quasi * (q.tail + rows.innovation.shape[0]) / (q.tail + far)
        weight = jnp.minimum(weight, 1.0)
        if q.update == "anchored":  # only while the anchor is of this quasi-static stretch
            weight = jnp.where(begins | (state.quasi > 0.5), weight, 0.0)
    quasi = jnp.where(now > 0, quasi, state.quasi)
    others, moved = state.rivals, None
    once = now
    if q.looking.per == "sample":  # of a stance, one look: the others share its field
        once = now * jnp.where(looks.follow == enough + 1, 1.0, 0.0)
    if isinstance(others, Rivals):
        odd = detectors.strength(seen.field) - state.reference[0]
        look = rivals.Look(once, innovation, sigma * sigma, P["tt"][2, 2], odd, nav.position)
        others, best, over = rivals.judged(q.rival, others, look, dt)
        others = rivals.left(q.rival, others, best, over, P["tt"][2, 2])
        moved = rivals.taken_over(P, best, over, nav.position, nav.velocity)
        weight = (1 - over) * weight
    reference = state.reference
    if q.reference == "running":
        share = now / jnp.minimum(looks.many + 1.0, 50.0)
        found = jnp.stack([detectors.strength(seen.field), detectors.inclination(seen.field)])
        reference = reference + share * (found - reference)
    more = {
        "look": now,
        "magnetic_field": seen.field,
        "heading_innovation": innovation,
        "heading_sigma": sigma,
        "quasi_static": quasi,
        "body_field": mag + 0 * state.before,
        "body_field_before": state.before,
        "reference": reference,
        "look_time": looks.clock.time,
        "look_of_stance": once,
    }
    if alpha is not None:
        more["heading_alpha"] = alpha
    if isinstance(tracker, hard_iron.State):
        more |= {"hard_iron": tracker.offset, "hard_iron_sigma": hard_iron.sigma(tracker)}
    if isinstance(others, Rivals):
        more |= {"rival_turn": others.fresh.turn, "rival_odds": others.fresh.odds, "took_over": over}
    state = State(looks, quasi, anchor, reference, more["body_field"], tracker, others, state.start, usual)
    gated = Gated(weight, jnp.where(whole > 0, ratio, 10.0))
    return Measured(state, rows, weight, gated, more, moved)


def _compensated(
    q: Compass, start: Array, field: Array, innovation: Array, sigma: Array, of_yaw: Array
) -> tuple[Array, Array]:
    """The innovation beside the disturbance of the `start`, and the variance that it adds."""
    earth = q.earth(0 * sigma).field()
    if q.compensation.mode == "vector":
        return rotations.wrap(detectors.azimuth(start) - detectors.azimuth(field)), 0 * sigma
    measured, known, disturbed = (hypotenuse(x[0], x[1], small=1e-12) for x in (field, earth, start - earth))
    level = measured, known, disturbed
    return compensation.chosen(q.compensation, innovation, sigma * sigma + of_yaw, level, q.noise.field)


def _heading_row(q: Compass, field: Array) -> Array:
    """What the heading says of the attitude error, `(1, 3, *L)`."""
    if q.row == "simple" or q.looking.levelling == "force":
        return (constant(np.array([0.0, 0.0, 1.0]), field[0]) + 0 * field)[None]
    return measurements.azimuth_row(field)


def _after(p: Any, state: State, by: str, correction: dict[str, Array], nav: Any) -> State:
    if by in TELL_NO_YAW:
        return state
    others = state.rivals
    if isinstance(others, Rivals):
        others = rivals.turned(others, correction["t"][2])
    looks, start = compass.turned(state.looks, correction["t"], p.compass.looks().levelling), state.start
    if by == "start_check" and not isinstance(start, tuple):  # clean fields: the disturbance was left behind
        start = jnp.where(correction["t"][2] == 0, start, p.compass.earth(0 * start[0]).field())
    return state._replace(looks=looks, rivals=others, start=start)


MAGNETIC_HEADING = Aid(
    name="magnetic_heading",
    wants=("t", "g", "v"),
    groups=(("field", detectors.FieldParameters), ("compass", Compass)),
    gate="field",
    reads=("stance",),
    field=True,
    prepare=_prepare,
    start=_start,
    step=_step,
    after=_after,
    opening_s=lambda p: p.initial.levelling_s,
)
"""A look at the field in each stance, and the heading (or the field itself) as a row."""


def _rate_step(p: Any, site: Any, state: Any, seen: Seen) -> Measured:
    dt, rate, said = seen.sample.dt, seen.sample.rate, seen.more
    noises = (p.compass.noise.field, p.process.gyroscope / jnp.sqrt(jnp.maximum(dt, 1e-6)))
    before, now = said["body_field_before"], said["body_field"]
    rows = measurements.field_rate(seen.estimate, rate, before, now, dt, noises)
    return Measured(state, rows, said["quasi_static"] * seen.gates["stance"].weight * (dt > 0))


FIELD_RATE = Aid(
    name="field_rate",
    wants=("g",),
    groups=(("compass", Compass),),
    reads=("stance", "field"),
    field=True,
    is_on=lambda p: p.compass.gyroscope_rows,
    step=_rate_step,
)
"""While the field is quasi-static it turns as the body does, which tells the gyroscope's bias (Afzal
2011)."""
