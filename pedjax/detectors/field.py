"""Quasi-static field detectors: is the magnetic field the same here as a few steps ago?

Each looks at a window of N + 1 fields in navigation axes, as the inertial attitude turns them there, and so
at N changes from each to the next. What the papers call the difference between magnetic and gyroscope
heading is minus the azimuth of that field, up to a constant; nothing else needs to be carried along. The
field is quasi-static where statistic < threshold.

Ma 2018 (Eq. 13-26), with the choices that its text leaves open as settings. Where it prints a level, |heading
difference|, its abstract and the unit of its sigma say rate of change, which is the default here. Its
densities carry an exponent 3/2 for one dimension (1/2; it cancels). Its threshold of 170 is where its own ROC
finds 0.8 of the quasi-static windows. That is far from what its Gaussian model gives (99 % of them stay below
21), and in simulated offices 16 finds 0.8: the default, as for QSF, QMD and iQSF.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.gates import SoftGate, log_positive
from pedjax.lanes import (
    add,
    cholesky,
    constant,
    dot,
    eye,
    forward_substitution,
    hypotenuse,
    matmul_t,
    norm,
)
from pedjax.parameters import group, leaf, offer, parameters, setting

_MA = "Ma 2018"
_KIT = "kit choice"
_MAGYQ = "MAGYQ, Renaudin and Combettes 2014, public code"
_FINDS = f"{_KIT}: finds 0.8 of the quasi-static windows in simulated offices"
_DEGREE = 0.017453292519943295
_ALWAYS = 10.0  # log units below the threshold, where there is no test


class Look(NamedTuple):
    """One look at the field: `field (3, *L)` µT in navigation axes, `yaw (*L)` rad of the inertial attitude,
    `time (*L)` s, and the `variance (*L)` rad² of that yaw, as far as the filter knew."""

    field: Array
    yaw: Array
    time: Array
    variance: Array


Window = tuple[Look, ...]
"""N + 1 looks, the oldest first."""


def _mean_or_energy(y: list[Array], form: str) -> Array:
    """(Σ y)²/N, the likelihood ratio of an unknown constant (Afzal, Ma), or Σ y²/N (Skog, Zhang)."""
    return add(y) ** 2 / len(y) if form == "mean" else add(x * x for x in y) / len(y)


def strength(field: Array) -> Array:
    """‖B‖ `(*L)`, with a finite slope at zero."""
    return norm(field, small=1e-12)


def azimuth(field: Array) -> Array:
    """Direction of the horizontal field, rad counter-clockwise from x, with a finite slope at zero."""
    return jnp.arctan2(field[1], field[0] + 1e-12)


def inclination(field: Array) -> Array:
    """By how much the field points below the horizon, rad."""
    return jnp.arctan2(-field[2], hypotenuse(field[0], field[1], small=1e-12))


def _changes(
    window: Window, of: Callable[[Look], Array], per: str = "step", angle: bool = False
) -> list[Array]:
    """Changes from look to look, of an angle in (-pi, pi], by the step or by the second."""
    found = []
    for (before, old), (after, new) in pairwise([(look, of(look)) for look in window]):
        y = rotations.wrap(new - old) if angle else new - old
        found.append(y if per == "step" else y / jnp.maximum(after.time - before.time, 1e-3))
    return found


def _size(y: list[Array], absolute: bool) -> list[Array]:
    return [hypotenuse(x, small=1e-18) for x in y] if absolute else y


def _per() -> Any:
    return setting(
        "step", choices=("step", "second"), source=_KIT,
        meaning="Whether a change is counted as it is, from look to look (step), or divided by the time "
        "between (second).",
    )  # fmt: skip


def _absolute(source: str) -> Any:
    return setting(
        True, source=source,
        meaning="Whether the sizes of changes are added up, so that changes of opposite sign do not cancel.",
    )  # fmt: skip


def _form(default: str, source: str) -> Any:
    return setting(
        default, choices=("mean", "energy"), source=source,
        meaning="Whether the changes are added up and then squared (mean), or squared and then added up "
        "(energy).",
    )  # fmt: skip


@parameters
class Qsf:
    """QSF of Afzal, Renaudin and Lachapelle 2011: the rate of change of the field's strength alone."""

    threshold: Array = leaf(
        3.9, unit="1", low=1e-4, high=1e6, source=_FINDS, tune=True, point=True,
        meaning="Statistic of QSF below which the field is quasi-static; raised, more windows pass, "
        "disturbed ones too.",
    )  # fmt: skip
    sigma_strength: Array = leaf(
        0.535, unit="uT", low=1e-4, high=100.0, source=f"{_MA}: 5.35 mGs",
        meaning="Usual change of strength in an undisturbed field; raised, changes count for less and "
        "more windows pass.",
    )  # fmt: skip
    form: str = _form("mean", "Afzal 2011")
    per: str = _per()


@parameters
class Qmd(Qsf):
    """The classical quasi-static magnetic field detector (Zhang, Eq. 8-12): energy of the same rate."""

    threshold: Array = leaf(
        6.2, unit="1", low=1e-4, high=1e6, source=_FINDS, tune=True, point=True,
        meaning="Statistic of QMD below which the field is quasi-static; raised, more windows pass, "
        "disturbed ones too.",
    )  # fmt: skip
    form: str = _form("energy", "Zhang")


@parameters
class Magyq:
    """Variance form: variance of the strength in the window, and the last one's distance from its mean."""

    variance: Array = leaf(
        6.0, unit="uT^2", low=1e-4, high=1e4, source=_MAGYQ, tune=True, point=True,
        meaning="Variance of the window's strengths below which the field is quasi-static; raised, more "
        "windows pass.",
    )  # fmt: skip
    outlier: Array = leaf(
        8.0, unit="uT", low=1e-3, high=1e3, source=_MAGYQ, point=True,
        moves="root",  # a length beside a variance
        meaning="Distance of the last strength from the window's mean below which it passes; raised, "
        "more windows pass.",
    )  # fmt: skip


@parameters
class Iqsf:
    """iQSF (Ma 2016), rebuilt from the description in Ma 2018: changes of strength, of magnetic heading and
    of gyroscope heading, so that only a straight path can pass. Its own parameters are not public."""

    threshold: Array = leaf(
        16.1, unit="1", low=1e-3, high=1e7, source=_FINDS, tune=True, point=True,
        meaning="Statistic of iQSF below which the field is quasi-static; raised, more windows pass, "
        "curved paths too.",
    )  # fmt: skip
    sigma_heading: Array = leaf(
        0.067, unit="rad", low=1e-5, high=3.0, source=f"{_KIT}: as Ma 2018",
        meaning="Usual change of magnetic and of gyroscope heading in iQSF; raised, turning counts for "
        "less and more pass.",
    )  # fmt: skip
    sigma_strength: Array = leaf(
        0.535, unit="uT", low=1e-4, high=100.0, source=f"{_MA}: 5.35 mGs",
        meaning="Usual change of strength in iQSF; raised, changes of strength count for less and more "
        "windows pass.",
    )  # fmt: skip
    absolute: bool = _absolute(_KIT)
    per: str = _per()


@parameters
class Ma:
    """Ma 2018: changes of heading difference, inclination and strength (Eq. 26)."""

    threshold: Array = leaf(
        15.7, unit="1", low=1e-3, high=1e7, source=f"{_FINDS}; published 170", tune=True, point=True,
        meaning="Statistic of Ma's test below which the field is quasi-static; raised, more windows "
        "pass, disturbed ones too.",
    )  # fmt: skip
    sigma_heading: Array = leaf(
        0.067, unit="rad", low=1e-5, high=3.0, source=_MA,
        meaning="Usual change of heading difference in Ma's test; raised, headings count for less and "
        "more windows pass.",
    )  # fmt: skip
    sigma_inclination: Array = leaf(
        0.054, unit="rad", low=1e-5, high=3.0, source=_MA,
        meaning="Usual change of inclination in Ma's test; raised, inclinations count for less and more "
        "windows pass.",
    )  # fmt: skip
    sigma_strength: Array = leaf(
        0.535, unit="uT", low=1e-4, high=100.0, source=f"{_MA}: 5.35 mGs",
        meaning="Usual change of strength in Ma's test; raised, strengths count for less and more "
        "windows pass.",
    )  # fmt: skip
    theta: str = setting(
        "rate", choices=("rate", "level"), source=f"{_MA}: abstract; level: Eq. 13",
        meaning="Whether the test takes the change of the heading difference (rate), or the difference "
        "itself (level).",
    )  # fmt: skip
    absolute: bool = _absolute(_MA)
    form: str = _form("mean", _MA)
    per: str = _per()


@parameters
class Aiez:
    """AIEZ (Zhang, Guo and Liu, Eq. 8-18): the difference between magnetic and inertial heading itself, and
    the change of strength,

        T = (1/N) Σ [e²/(σ_ψ² + P_ψψ) + (Δ‖B‖)²/σ_B²],

    so that a field that is steady and wrong, as above a magnet in the floor, does not pass. Printed as the
    strength, s^B is its rate of change: under H1 it is zero. p(y^B) is printed with σ_Δψ; σ_B is meant.

    The paper has no P_ψψ: once the filter's yaw is off by more than σ_ψ √γ no heading passes ever again. With
    it the gate is as wide as the yaw is unsure, which the filter must know to be of use; a yaw that is wrong
    and thought right needs a rival (`compass.rival`).
    """

    threshold: Array = leaf(
        6.0, unit="1", low=1e-3, high=1e6, source=_KIT, tune=True, point=True,
        meaning="Statistic of AIEZ's test below which the field is pure; raised, more looks pass, "
        "disturbed ones too.",
    )  # fmt: skip
    sigma_heading: Array = leaf(
        0.07, unit="rad", low=1e-5, high=3.0, source=_KIT, tune=True,
        meaning="Usual difference of magnetic and inertial heading in a pure field; raised, larger "
        "differences pass.",
    )  # fmt: skip
    sigma_strength: Array = leaf(
        3.0, unit="uT", low=1e-4, high=1e4, source=_KIT, tune=True,
        meaning="Usual change of strength in a pure field (per second: in uT/s, as the sensor's noise makes "
        "it); raised, changes count for less and more looks pass.",
    )  # fmt: skip
    yaw_variance: bool = setting(
        True, source=f"{_KIT}; Zhang: without",
        meaning="Whether the filter's own variance of yaw widens the test.",
    )  # fmt: skip
    form: str = _form("energy", "Zhang")
    per: str = _per()


@parameters
class Vector:
    """The change of the whole vector from one look to the next against its own covariance, the worst of the
    window: Δᵀ Σ⁻¹ Δ with Σ = 2 σ² I + [B×] diag(τ², τ², ψ²) [B×]ᵀ, which is χ² of three where the field is
    the same.

    Its threshold is a probability: that of taking a window for quasi-static in which one change was as long
    as `change`, in the direction where it is seen worst (a noncentral χ²; the other changes being none, so
    that no field with such a change passes more often).
    """

    false_alarm: Array = leaf(
        0.1, unit="1", low=1e-6, high=0.999, source=_KIT, tune=True, point=True,
        moves="search",
        meaning="Chance that a window with a change as long as `change` passes as quasi-static; raised, "
        "more windows pass.",
    )  # fmt: skip
    change: Array = leaf(
        3.0, unit="uT", low=1e-3, high=100.0, source=f"{_KIT}: what quasi-static means", tune=True,
        point=True, moves="search",
        meaning="Change of the field that is to be noticed; raised, the threshold grows and more windows "
        "pass.",
    )  # fmt: skip
    sigma_field: Array = leaf(
        0.1, unit="uT", low=1e-4, high=100.0, source=f"{_KIT}: of one look",
        meaning="Noise of one look along each axis; raised towards `change`, changes across the "
        "field must be smaller to pass.",
    )  # fmt: skip
    sigma_tilt: Array = leaf(
        0.1 * _DEGREE, unit="rad", low=1e-6, high=1.0, source=f"{_KIT}: between two",
        meaning="Error of roll and pitch between two looks; raised above sigma_yaw, the field must "
        "change less to pass.",
    )  # fmt: skip
    sigma_yaw: Array = leaf(
        0.1 * _DEGREE, unit="rad", low=1e-6, high=1.0, source=f"{_KIT}: between two",
        meaning="Error of yaw between two looks; raised above sigma_tilt, the field must change less to "
        "pass.",
    )  # fmt: skip


def _qsf(p: Qsf, window: Window, north: Array) -> Array:
    y = _changes(window, lambda look: strength(look.field), p.per)
    t = _mean_or_energy(y, p.form) / p.sigma_strength**2
    return log_positive(t) - jnp.log(p.threshold)


def _magyq(p: Magyq, window: Window, north: Array) -> Array:
    sizes = [strength(look.field) for look in window]
    mean = add(sizes) / len(sizes)
    variance = add((s - mean) ** 2 for s in sizes) / len(sizes)
    away = (sizes[-1] - mean) ** 2
    return jnp.maximum(
        log_positive(variance) - jnp.log(p.variance), log_positive(away) - 2 * jnp.log(p.outlier)
    )


def _iqsf(p: Iqsf, window: Window, north: Array) -> Array:
    y_strength = _size(_changes(window, lambda look: strength(look.field), p.per), p.absolute)
    y_gyroscope = _size(_changes(window, lambda look: look.yaw, p.per, angle=True), p.absolute)
    y_magnetic = _size(
        _changes(window, lambda look: look.yaw - azimuth(look.field), p.per, angle=True), p.absolute
    )
    t = _mean_or_energy(y_strength, "mean") / p.sigma_strength**2
    t = t + (_mean_or_energy(y_gyroscope, "mean") + _mean_or_energy(y_magnetic, "mean")) / p.sigma_heading**2
    return log_positive(t) - jnp.log(p.threshold)


def _ma(p: Ma, window: Window, north: Array) -> Array:
    if p.theta == "rate":
        y_heading = _changes(window, lambda look: -azimuth(look.field), p.per, angle=True)
    else:
        y_heading = [rotations.wrap(north - azimuth(look.field)) for look in window[1:]]
    y_inclination = _changes(window, lambda look: inclination(look.field), p.per)
    y_strength = _changes(window, lambda look: strength(look.field), p.per)
    channels = (
        (y_heading, p.sigma_heading),
        (y_inclination, p.sigma_inclination),
        (y_strength, p.sigma_strength),
    )
    t = add(_mean_or_energy(_size(y, p.absolute), p.form) / sigma**2 for y, sigma in channels)
    return log_positive(t) - jnp.log(p.threshold)


def _aiez(p: Aiez, window: Window, north: Array) -> Array:
    y_heading = []
    for look in window[1:]:
        known = p.sigma_heading**2 + (look.variance if p.yaw_variance else 0.0)
        y_heading.append(rotations.wrap(north - azimuth(look.field)) / jnp.sqrt(known))
    y_strength = _changes(window, lambda look: strength(look.field), p.per)
    t = _mean_or_energy(y_heading, p.form) + _mean_or_energy(y_strength, p.form) / p.sigma_strength**2
    return log_positive(t) - jnp.log(p.threshold)


def _vector(p: Vector, window: Window, north: Array) -> Array:
    field = add(look.field for look in window) / len(window)
    across = rotations.skew(field)
    turned = jnp.ones_like(field) * p.sigma_tilt**2 * constant(np.array([1.0, 1.0, 0.0]), field[0])
    turned = turned + p.sigma_yaw**2 * constant(np.array([0.0, 0.0, 1.0]), field[0])
    square = dot(field, field)
    steepest = square * jnp.maximum(p.sigma_tilt, p.sigma_yaw) ** 2
    noise = 2 * p.sigma_field**2 + 8 * jnp.finfo(field.dtype).eps * steepest  # positive in any precision
    spread = noise * eye(3, field[0]) + matmul_t(across * turned[None], across)
    lower = cholesky(spread)
    worst = None
    for before, after in pairwise(window):
        white = forward_substitution(lower, after.field - before.field)
        energy = add(x * x for x in white)
        worst = energy if worst is None else jnp.maximum(worst, energy)
    assert worst is not None
    largest = noise + steepest  # no direction has a larger variance
    return log_positive(worst) - jnp.log(noncentral_quantile(p.false_alarm, 3.0, p.change**2 / largest))


def noncentral_quantile(probability: Array, degrees: float, noncentrality: Array) -> Array:
    """The value below which a noncentral χ² stays with that probability (Sankaran's cube-root approximation,
    inverted), smooth in all three. Within 2 % from 10 to 99 %; below, where the noncentrality is small, it is
    too small, but the probability kept is off by 0.007 at most."""
    total, double = degrees + noncentrality, degrees + 2 * noncentrality
    h = 1 - 2 / 3 * total * (degrees + 3 * noncentrality) / double**2
    q = double / total**2
    m = (h - 1) * (1 - 3 * h)
    middle = 1 + h * q * (h - 1 - 0.5 * (2 - h) * m * q)
    width = h * jnp.sqrt(2 * q) * (1 + 0.5 * m * q)
    return total * jnp.maximum(middle + width * normal_quantile(probability), 1e-3) ** (1 / h)


def normal_quantile(probability: Array) -> Array:
    """The standard normal's quantile."""
    from jax.scipy.special import ndtri

    return ndtri(probability)


FIELD_DETECTORS: dict[str, Callable[[Any, Window, Array], Array]] = {
    "qsf": _qsf, "qmd": _qsf, "magyq": _magyq, "iqsf": _iqsf, "ma": _ma, "aiez": _aiez,
    "vector": _vector,
}  # fmt: skip
"""`(parameters, window, north) -> log of statistic over threshold (*L)`."""


def register_field_detector(name: str, log_ratio: Callable[[Any, Window, Array], Array], own: type) -> None:
    """Make a field detector of your own known by its name, with the class of its parameters, its operating
    points as leaves made with `point`."""
    FIELD_DETECTORS[name] = log_ratio
    offer(FieldParameters, name, own)


@parameters
class FieldParameters(SoftGate):
    """Which detector is on, its window in steps (or samples), and the numbers of all of them."""

    detector: str = setting(
        "ma", choices=("none", *FIELD_DETECTORS), source=_MA,
        meaning="Which statistic decides whether the field is quasi-static, none: it always is; only the "
        "group of that name has an effect.",
    )  # fmt: skip
    window: int = setting(
        3, choices=tuple(range(1, 31)), source=f"{_MA}: N = 3 steps",
        meaning="Number of changes that must be small together; longer, only a field steady over more "
        "looks passes.",
    )  # fmt: skip
    qsf: Qsf = group(Qsf, when={"detector": "qsf"})
    qmd: Qmd = group(Qmd, when={"detector": "qmd"})
    magyq: Magyq = group(Magyq, when={"detector": "magyq"})
    iqsf: Iqsf = group(Iqsf, when={"detector": "iqsf"})
    ma: Ma = group(Ma, when={"detector": "ma"})
    aiez: Aiez = group(Aiez, when={"detector": "aiez"})
    vector: Vector = group(Vector, when={"detector": "vector"})


def log_ratio(p: FieldParameters, window: Window, north: Array) -> Array:
    """Log of the chosen detector's statistic over its threshold, `(*L)`; negative where quasi-static.

    `north` rad is the azimuth at which the horizontal field points where nothing disturbs it.
    """
    if p.detector == "none":
        return jnp.full_like(window[-1].yaw, -_ALWAYS)
    return FIELD_DETECTORS[p.detector](getattr(p, p.detector), window, north)
