"""Initial alignment: the first attitude from a standing start, and the check of it later (Wang 2018).

The start is computed once for each parameter set and recording, from the rest with which it begins. Later,
whenever the field is as strong and as steep as the earth's, the magnetic heading less what the gyroscope has
turned since says what the first yaw should have been. Wang's own check (Eq. 5), made at the start, cannot: in
the same field it is zero whatever the attitude.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from pedjax import rotations
from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.aids.magnetic_heading import MAGNETIC_HEADING
from pedjax.aids.zero_velocity import TELL_NO_YAW
from pedjax.calibration import attitude
from pedjax.calibration.attitude import Earth, Stand
from pedjax.detectors import field as detectors
from pedjax.filters import compass, rivals
from pedjax.filters.covariance import Covariance
from pedjax.filters.filter import Opening
from pedjax.lanes import align, dot, lane_shape, matmul, matvec, transpose

_CLEAN_LOOKS = 3.0  # so many looks in the earth's field before a start is mended
_CLEARLY = 4.0  # standard deviations from which on it is


def _is_on(p: Any) -> bool:
    return bool(p.initial.alignment != "levelling")


def stand_of(p: Any, opening: Opening, lanes: int) -> Stand:
    """The rest with which a recording begins, with a calibrated field, in so many lane axes."""
    assert opening.field is not None
    assert opening.stands is not None
    dt = align(opening.dt * opening.stands, 1, lanes)
    force, rate, field = (align(x, 2, lanes) for x in (opening.force, opening.rate, opening.field))
    mag = jnp.moveaxis(compass.in_body(p.compass.body, jnp.moveaxis(field, 1, 0)), 0, 1)
    up = jnp.sum(dt[:, None] * force, axis=0)
    level = rotations.levelled(up, 0 * up[0])
    lying = jnp.moveaxis(mag, 1, 0)  # the calibration of a walked loop is told in a levelled body
    flat = compass.levelled(level[:, :, None], up[:, None], lying, p.compass.level)
    mag = jnp.moveaxis(matvec(transpose(level)[:, :, None], flat), 0, 1)
    return Stand(dt, force, rate, mag)


def earth_of(p: Any, stand: Stand) -> Earth:
    """The undisturbed field: as given, or else the middle of what the stand shows."""
    like = jnp.zeros_like(stand.dt[0])
    if p.compass.reference == "given":
        found: Earth = p.compass.earth(like)
        return found
    up = jnp.sum(stand.dt[:, None] * stand.force, axis=0)
    size = detectors.strength(jnp.moveaxis(stand.field, 1, 0))
    steep = attitude.dip(up[None], stand.field)
    known = stand.dt > 0
    strength, inclination = (jnp.nanmedian(jnp.where(known, x, jnp.nan), axis=0) for x in (size, steep))
    return Earth(strength + like, inclination + like, p.compass.north() + like)


class State(NamedTuple):
    """What later fields say: the gyroscope's first `bias (3, *L)`, the yaw that was `corrected` so far, what
    the compass corrects at this sample (`pending`), the `information` 1/rad² about the start's error and its
    `moment` 1/rad, the number of `clean` looks, and whether the start was `mended`; `(*L)` each."""

    bias: Array
    corrected: Array
    pending: Array
    information: Array
    moment: Array
    clean: Array
    mended: Array


def _align(p: Any, site: Any, opening: Opening, nav: Any, P: Covariance) -> tuple[tuple[()], Any, Covariance]:
    """The first attitude by `initial.alignment`; yaw as given where `compass.start` is "given"."""
    like = jnp.zeros(lane_shape(p, nav.position[0]), nav.position.dtype)
    stand = stand_of(p, opening, like.ndim)
    earth = Earth(*(x + like for x in earth_of(p, stand)))
    how = p.initial.align
    found = attitude.aligned(how, p.initial.alignment, stand, earth)
    turned = found.attitude + 0 * like
    given = p.compass.start == "given"
    if given:
        yaw = jnp.arctan2(turned[1, 0], turned[0, 0] + 1e-15)
        turn = rotations.from_euler(like, like, p.initial.heading - yaw)
        turned = matmul(turn, turned)
    tilt, heading = p.initial.attitude**2 + like, p.initial.heading_sigma**2 + like
    if not given:
        heading = p.compass.start_sigma**2 + like
    if how.covariance == "measured":
        tilt = tilt + found.tilt
        heading = heading if given else heading + found.heading
    tt = P["tt"]
    for k, variance in enumerate((tilt, tilt, heading)):
        tt = tt.at[k, k].set(variance)
    return (), nav._replace(attitude=turned), P | {"tt": tt}


def _nothing(p: Any, site: Any, state: Any, seen: Seen) -> Measured:
    return Measured(state, None, None)


INITIAL_ALIGNMENT = Aid(
    name="initial_alignment",
    wants=("t", "g"),
    groups=MAGNETIC_HEADING.groups,
    field=True,
    is_on=_is_on,
    start=_align,
    step=_nothing,
    stand_s=lambda p: p.initial.align.seconds,
)
"""The first attitude from the field of a standing start; before the compass, which begins from it."""


def _unchecked(p: Any, site: Any, opening: Opening, nav: Any, P: Covariance) -> tuple[State, Any, Covariance]:
    like = jnp.zeros_like(P["tt"][2, 2] + nav.position[0])
    return State(nav.gyroscope_bias + like, like, like, like, like, like, like), nav, P


def _check(p: Any, site: Any, state: State, seen: Seen) -> Measured:
    """A look at the earth's field, carried back to the start; and once they are sure, a turn of the path."""
    told, how, nav = seen.more, p.initial.align, seen.estimate
    field, now, sigma = told["magnetic_field"], told["look_of_stance"], told["heading_sigma"]
    odd = (detectors.strength(field) - told["reference"][0]) / (2 * how.strength_spread)
    steep = (detectors.inclination(field) - told["reference"][1]) / (2 * how.dip_spread)
    clean = now * (1 + odd * odd + steep * steep) ** -2
    drift = p.initial.gyroscope_bias * told["look_time"]
    plain = p.compass.north() - detectors.azimuth(field)  # whatever the start's disturbance makes of it
    away = rotations.wrap(plain + state.corrected)
    share = clean / (sigma * sigma + drift * drift)
    information, moment = state.information + share, state.moment + share * away
    error = moment / jnp.maximum(information, 1e-9)
    variance = 1 / jnp.maximum(information, 1e-6)
    count = state.clean + clean
    turned = dot(nav.attitude[2], nav.gyroscope_bias - state.bias) * seen.sample.dt  # by a bias learnt since
    corrected = state.corrected + state.pending - turned
    moved, mended = None, state.mended
    if how.check == "mend":
        left = rotations.wrap(error - corrected)
        wrong = left * left > _CLEARLY**2 * variance
        over = jnp.where(wrong & (count >= _CLEAN_LOOKS) & (mended < 0.5) & (now > 0), 1.0, 0.0)
        best = rivals.Rival(left, variance, 0 * left, 0 * nav.position)
        moved = rivals.taken_over(seen.P, best, over, nav.position, nav.velocity)
        mended = jnp.maximum(mended, over)
    more = {"start_error": error, "start_error_sigma": jnp.sqrt(variance), "start_mended": mended}
    new = State(state.bias, corrected, 0 * corrected, information, moment, count, mended)
    return Measured(new, None, None, more=more, moved=moved)


def _after(p: Any, state: State, by: str, correction: dict[str, Array], nav: Any) -> State:
    yaw = correction["t"][2]
    if by in TELL_NO_YAW:
        return state
    if by == "magnetic_heading":  # its innovation was from before that
        return state._replace(pending=state.pending + yaw)
    return state._replace(corrected=state.corrected + yaw)


START_CHECK = Aid(
    name="start_check",
    wants=("t", "g"),
    groups=MAGNETIC_HEADING.groups,
    reads=("stance", "field"),
    field=True,
    is_on=_is_on,
    start=_unchecked,
    step=_check,
    after=_after,
)
"""What later clean fields say of the first yaw; behind the compass."""
