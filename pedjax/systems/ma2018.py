"""Ma 2018: the ZUPT-EKF with the heading of a quasi-static magnetic field.

IEZ at every sample; once in each stance a look at the field, a detector over the last looks, and where the
field is quasi-static the magnetic heading as a further row. Zero velocity and heading are updated one after
the other, which for independent noises is the stacked update of the paper (Eq. 35-38).

The same parts give the systems it is compared with: field.detector = "iqsf" or "qsf", and compass.update =
"none", pure ZUPT. Beyond the paper: heading noise from field, tilt and oddity; tails heavier than a
Gaussian's, by which a heading far from the expected one counts less and none is locked out for ever; updates
that ask of the field only that it is what it was (Afzal 2011), anchored at the window's start or from look to
look; and hard iron that changes while walking, tracked from turning and taken off the readings.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax import rotations
from pedjax.detectors import field as detectors
from pedjax.filters import compass, covariance, hard_iron, measurements
from pedjax.filters.compass import Body, HeadingNoise, Level, Looking, Looks
from pedjax.filters.hard_iron import TrackerParameters
from pedjax.filters.strapdown import Navigation
from pedjax.gates import gate
from pedjax.lanes import align, constant, lane_shape, matmul
from pedjax.parameters import group, leaf, parameters, setting
from pedjax.system import Inputs, Output, Signals, System
from pedjax.systems import iez
from pedjax.systems.iez import IezParameters

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

    lag_s: float = setting(0.0, source="0: none")


@parameters
class Compass:
    """What is made of the field."""

    update: str = setting(
        "heading", choices=("heading", "anchored", "differential", "none"), source="Ma 2018; Afzal 2011"
    )
    row: str = setting("full", choices=("full", "simple"), source="Ma 2018; simple: [0, 0, 1]")
    start: str = setting("field", choices=("field", "given"), source=f"{_KIT}: yaw from the first field")
    hard_iron: str = setting("fixed", choices=("fixed", "tracked"), source="fixed: published")
    reference: str = setting("running", choices=("running", "given"), source=_KIT)
    gyroscope_rows: bool = setting(False, source="Afzal 2011: option")
    declination: Array = leaf(0.0, unit="rad", low=-3.2, high=3.2, scale="linear", source="0: magnetic north")
    start_sigma: Array = leaf(0.01, unit="rad", low=1e-4, high=3.2, source=_KIT)
    tail: Array = leaf(1e6, unit="1", low=0.1, high=1e9, source="1e6, a Gaussian: published")
    strength: Array = leaf(48.0, unit="uT", low=10.0, high=100.0, source=f"{_KIT}: mid-latitudes")
    inclination: Array = leaf(1.1, unit="rad", low=-1.6, high=1.6, scale="linear", source=_KIT)
    looking: Looking = group(Looking)
    body: Body = group(Body)
    level: Level = group(Level)
    noise: HeadingNoise = group(HeadingNoise)
    tracker: Tracker = group(Tracker)


@parameters
class Ma2018Parameters(IezParameters):
    """All parameters of IEZ, of the field detector and of the compass."""

    field: detectors.FieldParameters = group(detectors.FieldParameters)
    compass: Compass = group(Compass)


class Sample(NamedTuple):
    """An inertial sample, the field `(3,)` µT in body axes, and the rate `(3,)` when the field was so, if
    that was not now."""

    inertial: iez.Sample
    field: Array
    late: Array | tuple[()]


class Opening(NamedTuple):
    """Mean force and mean field of the first still samples."""

    force: Array
    field: Array


class State(NamedTuple):
    """IEZ's state; the looks at the field; whether it was `quasi`-static at the last one; the `anchor
    (3, *L)` that it is compared with; the `reference (2, *L)` strength and inclination; the sample
    `before`; and the `tracker` of hard iron, if there is one."""

    inertial: iez.State
    looks: Looks
    quasi: Array
    anchor: Array
    reference: Array
    before: Array
    tracker: hard_iron.State | tuple[()]

    @property
    def navigation(self) -> Navigation:
        """The estimate."""
        return self.inertial.navigation

    @property
    def healthy(self) -> Array:
        """Whether all was finite."""
        return self.inertial.healthy


def prepare(p: Ma2018Parameters, signals: Signals, rate_hz: float, length: ArrayLike | None = None) -> Inputs:
    """IEZ's, with the field beside it."""
    assert signals.field is not None
    inertial = iez.prepare(p, signals, rate_hz, length)
    first = max(round(p.initial.levelling_s * rate_hz), 1)
    opening = Opening(inertial.opening, jnp.mean(signals.field[:first], axis=0))
    q = p.compass
    late: Array | tuple[()] = ()
    if q.hard_iron == "tracked" and q.tracker.lag_s > 0:
        late = hard_iron.delayed(signals.rate, signals.dt, q.tracker.lag_s)
    return Inputs(Sample(inertial.samples, signals.field, late), opening)


def north_of(p: Compass) -> Array:
    """The azimuth of the undisturbed horizontal field, counter-clockwise from east."""
    return _QUARTER_TURN - p.declination


def looking_of(p: Compass) -> Looking:
    """When it looks, and what levels: the attitude where the field tells of the tilt, too."""
    tilted = p.update in ("anchored", "differential")
    return replace(p.looking, levelling="attitude") if tilted else p.looking


def start(p: Ma2018Parameters, opening: Opening) -> State:
    """As IEZ; with `compass.start` = "field" the first yaw is the compass's."""
    inertial = iez.start(p, opening.force)
    like = jnp.zeros(lane_shape(p, opening.force[0]), opening.force.dtype)
    force = align(opening.force, 1, like.ndim) + 0 * like
    mag = compass.in_body(p.compass.body, align(opening.field, 1, like.ndim) + 0 * like)
    nav = inertial.navigation
    seen = compass.levelled(nav, force, mag, p.compass.level, "force")
    if p.compass.start == "field":
        yaw = rotations.wrap(north_of(p.compass) - detectors.azimuth(seen))
        turn = rotations.from_euler(0 * yaw, 0 * yaw, yaw)
        nav = nav._replace(attitude=matmul(turn, nav.attitude))
        tilt = inertial.P["tt"]
        sigma = p.compass.start_sigma
        P = inertial.P | {"tt": tilt.at[2, 2].set(sigma * sigma + 0 * like)}
        inertial = inertial._replace(navigation=nav, P=P)
    if p.compass.reference == "running":
        reference = jnp.stack([detectors.strength(seen), detectors.inclination(seen)])
    else:
        reference = jnp.stack([p.compass.strength + like, p.compass.inclination + like])
    looks = compass.first(like, p.field.window)
    tracker = hard_iron.start(p.compass.tracker, mag) if p.compass.hard_iron == "tracked" else ()
    return State(inertial, looks, like, jnp.zeros_like(mag), reference, mag, tracker)


def step(p: Ma2018Parameters, state: State, sample: Sample) -> tuple[State, Output]:
    """IEZ's step; a look, and an update as far as the field is quasi-static."""
    inertial, output = iez.step(p, state.inertial, sample.inertial)
    nav, P, lanes = inertial.navigation, inertial.P, output.stance.ndim
    dt = align(sample.inertial.dt, 0, lanes)
    mag = compass.in_body(p.compass.body, align(sample.field, 1, lanes))
    force, rate = (align(x, 1, lanes) for x in (sample.inertial.force, sample.inertial.rate))
    q, north = p.compass, north_of(p.compass)
    tracker = state.tracker
    if isinstance(tracker, hard_iron.State):
        late = rate if isinstance(sample.late, tuple) else align(sample.late, 1, lanes)
        tracker = hard_iron.step(q.tracker, tracker, late, mag, dt)
        mag = mag - tracker.offset

    specific = force - nav.accelerometer_bias
    looking = looking_of(q)
    looks, now = compass.look(looking, q.level, state.looks, nav, specific, mag, dt, output.stance)
    seen = looks.window[-1]
    ratio = detectors.log_ratio(p.field, looks.window, north)
    whole = jnp.where(looks.many > p.field.window, 1.0, 0.0)
    quasi = whole * gate(ratio, p.field.width, p.field.straight_through)
    begins = (now > 0) & (quasi > 0.5) & (state.quasi <= 0.5)
    anchor = jnp.where(begins, looks.window[0].field, state.anchor)
    sigma, sigma_field = compass.heading_sigma(q.noise, seen.field, state.reference), q.noise.field
    if isinstance(tracker, hard_iron.State):
        sigma = jnp.sqrt(sigma * sigma + compass.offset_variance(nav.attitude, seen.field, tracker.bb))
        every = tracker.bb[0, 0] + tracker.bb[1, 1] + tracker.bb[2, 2]
        twice = 2 * every  # half a turn on, an offset counts twice
        sigma_field = jnp.sqrt(sigma_field * sigma_field + twice)
    innovation = rotations.wrap(north - detectors.azimuth(seen.field))
    if q.update in ("heading", "none"):
        if q.row == "simple":
            row = (constant(np.array([0.0, 0.0, 1.0]), innovation) + 0 * seen.field)[None]
        elif q.looking.levelling == "force":
            row = measurements.yaw_row(nav.attitude)
        else:
            row = measurements.azimuth_row(seen.field)
        rows = measurements.heading(innovation, row, sigma)
    else:
        against = anchor if q.update == "anchored" else looks.window[-2].field
        rows = measurements.same_field(seen.field, against, sigma_field)
    degrees = rows.innovation.shape[0]
    far = covariance.normalised_innovation(P, rows)
    weight = now * quasi * (q.tail + degrees) / (q.tail + far)
    weight = jnp.minimum(weight, 1.0) * (0.0 if q.update == "none" else 1.0)
    if q.update == "anchored":  # only while the anchor is of this quasi-static stretch
        weight = jnp.where(begins | (state.quasi > 0.5), weight, 0.0)
    P, correction = covariance.update(P, rows, weight)
    nav = measurements.correct(nav, correction)
    looks = compass.turned(looks, correction["t"], nav.attitude, looking.levelling)
    quasi = jnp.where(now > 0, quasi, state.quasi)
    if q.gyroscope_rows:
        noises = (q.noise.field, p.process.gyroscope / jnp.sqrt(jnp.maximum(dt, 1e-6)))
        turn = measurements.field_rate(nav, rate, state.before, mag, dt, noises)
        P, correction = covariance.update(P, turn, quasi * output.stance * (dt > 0))
        nav = measurements.correct(nav, correction)
        looks = compass.turned(looks, correction["t"], nav.attitude, looking.levelling)
    reference = state.reference
    if q.reference == "running":
        share = now / jnp.minimum(looks.many + 1.0, 50.0)
        found = jnp.stack([detectors.strength(seen.field), detectors.inclination(seen.field)])
        reference = reference + share * (found - reference)

    inertial = inertial._replace(navigation=nav, P=P)
    more = {
        "look": now,
        "field_weight": weight,
        "field_log_ratio": jnp.where(whole > 0, ratio, 10.0),
        "magnetic_field": seen.field,
        "heading_innovation": innovation,
        "heading_sigma": sigma,
    }
    if isinstance(tracker, hard_iron.State):
        more |= {"hard_iron": tracker.offset, "hard_iron_sigma": hard_iron.sigma(tracker)}
    output = output._replace(navigation=nav, variances=covariance.variances(P), more=more)
    return State(inertial, looks, quasi, anchor, reference, mag + 0 * state.before, tracker), output


def defaults() -> Ma2018Parameters:
    """Ma's detector and the parameters of IEZ; what the paper leaves out is a kit choice."""
    return Ma2018Parameters()


TRACKER = tuple(f"compass.tracker.{name}" for name in ("still", "turning", "offset", "threshold", "jump"))
"""The tracker's main numbers: how field and offset wander, and when and how far they jump."""


def tunable(p: Ma2018Parameters) -> tuple[str, ...]:
    """IEZ's, and those of the field detector, of the heading noise, and of the tracker if it is on."""
    detector = p.field.detector
    thresholds = {"magyq": ("variance",), "vector": ("false_alarm", "change")}
    own = tuple(f"field.{detector}.{name}" for name in thresholds.get(detector, ("threshold",)))
    noise = ("compass.noise.floor", "compass.noise.field", "compass.tail", "compass.start_sigma")
    tracker = TRACKER if p.compass.hard_iron == "tracked" else ()
    return (*iez.tunable(p), *own, *noise, *tracker)


MA2018 = System(
    "ma2018", "ZUPT-EKF with quasi-static magnetic heading", defaults, tunable, prepare, start, step, True
)
