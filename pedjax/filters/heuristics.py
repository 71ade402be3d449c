"""Heading heuristics: what it says of the yaw that people walk straight, and along the corridors.

Each form is a function of what is known when a stride has ended, and gives a measurement or a correction:

- `hdr` (Zhang, Eq. 27-28): a straight walker's heading is the mean of the strides before; a row on yaw. It
  counts a walk's natural sway as drift and its own past as truth, and so is never honest: it shrinks the
  yaw's variance without knowing anything of the yaw.
- `slope`: the honest form of the same. Over a straight run the yaw keeps its level; its slope over time is
  what is left of the gyroscope's bias about up, c · g with c the up axis in body axes: a row on the bias,
  once for each run, with σ²/Σ(t − t̄)² as its variance.
- `integrator` (HDR of Borenstein and Ojeda 2009): on straights the bias about up moves by a fixed amount
  against the sign of the turn.
- `hde` (Borenstein and Ojeda 2010): the same against the side on which the nearest dominant direction lies.
  The yaw integrates the bias and the bias the yaw, so that alone this swings about the direction and never
  settles: the yaw itself is turned by a small share of the deviation, too (`turn`; 0 as published).
- `ihde` (Jimenez 2011): the deviation from the nearest direction as a row on yaw, which counts less the
  farther that is and the less straight the walk.
- `mihde` (Jimenez 2012): the same, where the magnetic heading agrees on which direction it is.
- `von_mises`: soft. A stride goes along a direction with some share, or anywhere; the posterior that it does
  is the row's weight: w = π N(E; 0, S)/(π N(E; 0, S) + (1 − π)/Δ) with S = σ² + P_ψψ.

The constants of the papers by Borenstein and by Jimenez were not at hand: these are the kit's.
Dominant directions are Δ apart, 90 degrees unless said otherwise; they are given, or learnt from the walk's
first straight strides as the circular mean of 2π/Δ times their heading.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.detectors.straight import Straight, circular_mean
from pedjax.filters import kalman
from pedjax.filters.covariance import Covariance
from pedjax.filters.kalman import Rows
from pedjax.lanes import constant
from pedjax.parameters import group, leaf, parameters, setting

_KIT = "kit choice"
_DEGREE = 0.017453292519943295
DIRECTED = ("hde", "ihde", "mihde", "von_mises")
"""Forms that go by dominant directions."""
_ON = ("hdr", "slope", "integrator", *DIRECTED)


def _sigma(value: float, what: str) -> Any:
    return leaf(
        value, unit="rad", low=1e-4, high=10.0, source=_KIT, tune=True,
        meaning=f"Standard deviation of {what}; raised, it turns the track less.",
    )  # fmt: skip


def _tolerance(value: float, form: str) -> Any:
    return leaf(
        value, unit="rad", low=1e-3, high=3.2, source=_KIT, tune=True,
        meaning=f"Deviation from a dominant direction at which a stride counts for less in {form}; raised, "
        "strides across the building count, too.",
    )  # fmt: skip


def _gain(value: float, form: str) -> Any:
    return leaf(
        value, unit="rad/s", low=1e-8, high=1e-2, source=_KIT, tune=True,
        meaning=f"By how much {form} moves the gyroscope's bias at each straight stride; raised, drift is "
        "taken off sooner and less smoothly.",
    )  # fmt: skip


def _softness(unit: str, value: float, what: str) -> Any:
    return leaf(
        value, unit=unit, low=1e-6, high=1.0, source=f"{_KIT}: almost a sign", tune=True,
        meaning=f"Size of {what} below which it counts in proportion, not by its sign alone; raised, small "
        "ones move the bias less.",
    )  # fmt: skip


@parameters
class Hdr:
    """HDR of Zhang, Eq. 27-28."""

    sigma: Array = _sigma(0.3, "the heading that the strides before tell")
    on_curve: str = setting(
        "skip", choices=("skip", "zero"), source=f"skip: {_KIT}; zero: Zhang, Eq. 28",
        meaning="What a stride tells that is not straight: nothing, or, as printed, that the yaw is right, "
        "which shrinks its variance without any knowledge.",
    )  # fmt: skip


@parameters
class Slope:
    """The slope of the heading over straight runs."""

    sigma: Array = _sigma(0.05, "a stride's heading about a straight run's line")
    least: Array = leaf(
        12.0, unit="1", low=3.0, high=1e3, source=_KIT,
        meaning="Strides of a straight run from which its slope counts; raised, only long straights do.",
    )  # fmt: skip
    longest: Array = leaf(
        40.0, unit="1", low=3.0, high=1e4, source=_KIT,
        meaning="Strides after which a straight run is counted and begun anew; raised, slopes are surer "
        "and come later.",
    )  # fmt: skip
    far: Array = leaf(
        3.0, unit="1", low=0.1, high=1e3, source=f"{_KIT}: 3 sigma",
        meaning="Standard deviations from which a slope is taken for a gentle curve and left out; raised, "
        "gentle curves count as drift.",
    )  # fmt: skip


@parameters
class Integrator:
    """HDR of Borenstein and Ojeda 2009."""

    gain: Array = _gain(5e-6, "the integrator")
    softness: Array = _softness("rad/s", 1e-3, "a turn")


@parameters
class Hde:
    """HDE of Borenstein and Ojeda 2010."""

    gain: Array = _gain(7e-6, "HDE")
    softness: Array = _softness("rad", 0.01, "a deviation")
    turn: Array = leaf(
        0.1, unit="1", low=0.0, high=1.0, scale="linear", source=f"{_KIT}; 0: Borenstein 2010", tune=True,
        meaning="Share of a deviation up to `softness` by which a straight stride turns the yaw itself; "
        "raised, the bias swings less about the direction.",
    )  # fmt: skip


@parameters
class Ihde:
    """iHDE of Jimenez 2011."""

    sigma: Array = _sigma(0.1, "a stride about its direction in iHDE")
    tolerance: Array = _tolerance(6 * _DEGREE, "iHDE")


@parameters
class Mihde(Ihde):
    """MiHDE of Jimenez 2012."""

    sigma: Array = _sigma(0.1, "a stride about its direction in MiHDE")
    tolerance: Array = _tolerance(6 * _DEGREE, "MiHDE")
    compass: Array = leaf(
        20 * _DEGREE, unit="rad", low=1e-3, high=3.2, source=_KIT, tune=True,
        meaning="Deviation of the direction from the magnetic heading at which a stride counts for less; "
        "raised, the compass has less of a say in which direction it is.",
    )  # fmt: skip


@parameters
class VonMises:
    """Soft dominant directions."""

    sigma: Array = _sigma(0.05, "a stride about its dominant direction")
    share: Array = leaf(
        0.5, unit="1", low=1e-4, high=0.9999, scale="linear", source=_KIT, tune=True,
        meaning="Share of straight strides that go along a dominant direction; raised, strides are put "
        "down to one more readily.",
    )  # fmt: skip


@parameters
class Directions:
    """The dominant directions of a building."""

    known: str = setting(
        "learnt", choices=("learnt", "given"), source=_KIT,
        meaning="Whether they are learnt from straight strides of the walk, or given by `axis`.",
    )  # fmt: skip
    count: int = setting(
        4, choices=(2, 4, 8), source="4: Borenstein 2010",
        meaning="How many there are in a full turn; more, buildings with slanting corridors fit, and a "
        "wrong one is nearer.",
    )  # fmt: skip
    axis: Array = leaf(
        0.0, unit="rad", low=-3.2, high=3.2, scale="linear", source="0: along x", tune=True,
        when={"known": "given"},
        meaning="One of them, counter-clockwise from x; raised, the track turns counter-clockwise.",
    )  # fmt: skip
    strides: Array = leaf(
        6.0, unit="1", low=1.0, high=1e3, source=_KIT, when={"known": "learnt"},
        meaning="Straight strides that they are learnt from; raised, they are surer and come later.",
    )  # fmt: skip
    error: Array = leaf(
        0.01, unit="rad", low=1e-6, high=1.0, source=_KIT, when={"form": ("ihde", "mihde", "von_mises")},
        meaning="How far they may be from the building's true ones; as this error is the same in every "
        "stride, rows leave the yaw no surer than that. Raised, they count for less.",
    )  # fmt: skip
    sure: Array = leaf(
        0.05, unit="rad", low=1e-4, high=10.0, source=_KIT, when={"known": "learnt"},
        meaning="Standard deviation of the yaw at which a stride counts by half in learning them; raised, "
        "they are learnt while the yaw is still unsure.",
    )  # fmt: skip
    memory: Array = leaf(
        6.0, unit="1", low=1.0, high=1e6, source=f"{_KIT}: the first strides", when={"known": "learnt"},
        meaning="Over how many straight strides they are averaged; with no more than `strides` they stay as "
        "first learnt; raised, they follow later strides slowly.",
    )  # fmt: skip


@parameters
class Heuristic:
    """Which form, beside what, and the numbers of all of them."""

    form: str = setting(
        "none", choices=("none", *_ON), source="none: not part of IEZ",
        meaning="What straight walking says of the yaw; only the group of that name has an effect.",
    )  # fmt: skip
    beside: str = setting(
        "complement", choices=("complement", "always"), source="complement: Zhang, Eq. 31",
        meaning="Whether it counts only as far as the compass does not, by 1 - w of the field's weight w, "
        "or always.",
    )  # fmt: skip
    straight: Straight = group(Straight, when={"form": _ON})
    hdr: Hdr = group(Hdr, when={"form": "hdr"})
    slope: Slope = group(Slope, when={"form": "slope"})
    integrator: Integrator = group(Integrator, when={"form": "integrator"})
    hde: Hde = group(Hde, when={"form": "hde"})
    ihde: Ihde = group(Ihde, when={"form": "ihde"})
    mihde: Mihde = group(Mihde, when={"form": "mihde"})
    von_mises: VonMises = group(VonMises, when={"form": "von_mises"})
    directions: Directions = group(Directions, when={"form": DIRECTED})

    def only_counting(self) -> Heuristic:
        """Strides are counted, and nothing is made of them."""
        return replace(self, form="slope", slope=replace(self.slope, least=jnp.asarray(jnp.inf)))


class Run(NamedTuple):
    """Sums over a straight run, from its first `heading` and `time`: of `strides`, and over them of t, t², y
    and t y, `(*L)` each, and of the up axis in body axes, `up (3, *L)`."""

    heading: Array
    time: Array
    strides: Array
    t: Array
    tt: Array
    y: Array
    ty: Array
    up: Array


class Walked(NamedTuple):
    """What is known when a stride has ended: the `headings` of the last ones, rad, the oldest first; how long
    the last took, `seconds`; how `straight` they were in [0, 1], and by which part of the angle that is
    allowed they were not, `bent`; the deviation `away` from the nearest dominant direction, rad, and whether
    such are `known` (0 or 1); the straight `run` that is `over` now (0 or 1); the `up` axis in body axes
    `(3, *L)`; by how much the compass would turn the yaw, `compass` rad, or None; and the covariance `P`."""

    headings: tuple[Array, ...]
    seconds: Array
    straight: Array
    bent: Array
    away: Array
    known: Array
    run: Run
    over: Array
    up: Array
    compass: Array | None
    P: Covariance


class Told(NamedTuple):
    """What a form says: `rows`, and how much of their information counts, `weight (*L)`; or by how much the
    gyroscope's `bias (3, *L)` is to move, and the `yaw (*L)` rad with it."""

    weight: Array
    rows: Rows | None = None
    bias: Array | None = None
    yaw: Array | None = None


def _on_yaw(innovation: Array, sigma: Array) -> Rows:
    row = constant(np.array([[0.0, 0.0, 1.0]]), innovation) + 0 * innovation
    return Rows(innovation[None], (sigma * sigma + 0 * innovation)[None, None], {"t": row})


def _hdr(p: Hdr, seen: Walked) -> Told:
    back = rotations.wrap(circular_mean(seen.headings[:-1]) - seen.headings[-1])
    if p.on_curve == "zero":
        return Told(jnp.ones_like(back), _on_yaw(seen.straight * back, p.sigma))
    return Told(seen.straight, _on_yaw(back, p.sigma))


def fitted(run: Run) -> tuple[Array, Array]:
    """The slope rad/s of a run's headings over time, and Σ(t − t̄)² s²."""
    count = jnp.maximum(run.strides, 1.0)
    spread = jnp.maximum(run.tt - run.t * run.t / count, 1e-6)
    return (run.ty - run.t * run.y / count) / spread, spread


def _slope(p: Slope, seen: Walked) -> Told:
    run = seen.run
    slope, spread = fitted(run)
    up = run.up / jnp.maximum(run.strides, 1.0)
    rows = Rows(slope[None], (p.sigma * p.sigma / spread)[None, None], {"g": up[None]})
    near = kalman.normalised_innovation(seen.P, rows) < p.far * p.far
    return Told(jnp.where(near & (run.strides >= p.least), seen.over, 0.0), rows)


def _integrator(p: Integrator, seen: Walked) -> Told:
    turn = rotations.wrap(seen.headings[-1] - seen.headings[-2]) / jnp.maximum(seen.seconds, 1e-3)
    return Told(seen.straight, bias=p.gain * jnp.tanh(turn / p.softness) * seen.up)


def _hde(p: Hde, seen: Walked) -> Told:
    side = jnp.tanh(seen.away / p.softness)
    return Told(seen.straight * seen.known, bias=p.gain * side * seen.up, yaw=-p.turn * p.softness * side)


def _directed(axis: Directions, seen: Walked, sure: Array, sigma: Array) -> Told:
    """A row on yaw by the nearest direction; it counts as far as a stride is `sure (*L)` to go along it."""
    of_yaw = jnp.maximum(seen.P["tt"][2, 2], 1e-12)
    left = jnp.maximum(1 - axis.error**2 / of_yaw, 0.0)
    return Told(seen.straight * seen.known * sure * left, _on_yaw(-seen.away, sigma))


def _ihde(p: Ihde, axis: Directions, seen: Walked) -> Told:
    sure = jnp.exp(-((seen.away / p.tolerance) ** 2) - jnp.minimum(seen.bent, 3.0) ** 2)
    return _directed(axis, seen, sure, p.sigma)


def _mihde(p: Mihde, axis: Directions, seen: Walked) -> Told:
    assert seen.compass is not None
    told = _ihde(p, axis, seen)
    apart = rotations.wrap(seen.compass + seen.away)  # of the turns that compass and direction ask for
    return told._replace(weight=told.weight * jnp.exp(-0.5 * (apart / p.compass) ** 2))


def _von_mises(p: VonMises, axis: Directions, seen: Walked) -> Told:
    spread = p.sigma * p.sigma + seen.P["tt"][2, 2]
    along = p.share * jnp.exp(-0.5 * seen.away**2 / spread) / jnp.sqrt(2 * np.pi * spread)
    sure = along / (along + (1 - p.share) * axis.count / (2 * np.pi))
    return _directed(axis, seen, sure, p.sigma)


FORMS: dict[str, Callable[[Heuristic, Walked], Told]] = {
    "hdr": lambda p, seen: _hdr(p.hdr, seen),
    "slope": lambda p, seen: _slope(p.slope, seen),
    "integrator": lambda p, seen: _integrator(p.integrator, seen),
    "hde": lambda p, seen: _hde(p.hde, seen),
    "ihde": lambda p, seen: _ihde(p.ihde, p.directions, seen),
    "mihde": lambda p, seen: _mihde(p.mihde, p.directions, seen),
    "von_mises": lambda p, seen: _von_mises(p.von_mises, p.directions, seen),
}
"""`(parameters, what is known at the end of a stride) -> what it says`."""


class Axis(NamedTuple):
    """The sum of unit vectors at `directions.count` times the headings of straight strides, as far as they
    are kept, and how `many` there were; `(*L)` each."""

    cosine: Array
    sine: Array
    many: Array


def learnt(p: Directions, axis: Axis, heading: Array, straight: Array, of_yaw: Array) -> Axis:
    """With another stride, as far as it was `straight (*L)`, and the less the larger the variance `of_yaw
    (*L)` rad²: what the yaw is off by while they are learnt, they are off by for ever."""
    straight = straight * p.sure * p.sure / (p.sure * p.sure + of_yaw)
    full = axis.many >= jnp.maximum(p.strides, p.memory)
    keep = jnp.where(full, 1 - 1 / p.memory, 1.0)
    counts = jnp.where((axis.many >= p.strides) & (p.memory <= p.strides), 0.0, straight)
    keep = 1 - counts * (1 - keep)
    turned = p.count * heading
    return Axis(
        keep * axis.cosine + counts * jnp.cos(turned),
        keep * axis.sine + counts * jnp.sin(turned),
        axis.many + counts,
    )


def away_from(p: Directions, axis: Axis, heading: Array) -> tuple[Array, Array]:
    """Deviation `(*L)` rad of a heading from the nearest direction, and whether those are known, 0 or 1."""
    if p.known == "given":
        return rotations.wrap(p.count * (heading - p.axis)) / p.count, jnp.ones_like(heading)
    phase = jnp.arctan2(axis.sine, axis.cosine + 1e-12)
    known = jnp.where(axis.many >= p.strides, 1.0, 0.0)
    return rotations.wrap(p.count * heading - phase) / p.count, known
