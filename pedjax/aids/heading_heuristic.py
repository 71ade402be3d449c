"""Heading heuristic: at the end of each stride, what straight walking says of the yaw.

The strides are counted by the clock of stances; a detector tells whether the last ones were straight, and the
form that is on (`heuristic.form`) makes a measurement of them. Beside a compass it counts as far as the
compass does not: two rows with the weights w and 1 − w. (Zhang, Eq. 31-32, mixes the two innovations, and the
two variances, of one row, which for 0 < w < 1 is a heading that neither of them told.) A stride ends before
its stance's look, so w is that of the look before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.aids.aid import Aid, Measured, Seen
from pedjax.aids.zero_velocity import TELL_NO_YAW
from pedjax.detectors import straight
from pedjax.detectors.clock import StanceClock, started, tick
from pedjax.detectors.straight import Straight
from pedjax.errors import InputError
from pedjax.filters import heuristics
from pedjax.filters.covariance import Covariance, states_of
from pedjax.filters.filter import Opening
from pedjax.filters.heuristics import Axis, Heuristic, Run, Walked
from pedjax.gates import gate
from pedjax.lanes import constant, hypotenuse
from pedjax.system import Gated


class State(NamedTuple):
    """The `clock` of stances; where the last stride ended, `place (3, *L)` m; the `headings` of the last
    strides and the `times` of their ends, the oldest first, and how many of them `follow` each other; the
    `axis` of the building and the straight `run` so far."""

    clock: StanceClock
    place: Array
    headings: tuple[Array, ...]
    times: tuple[Array, ...]
    follow: Array
    axis: Axis
    run: Run


def _start(
    p: Any, site: Any, opening: Opening, estimate: Any, P: Covariance
) -> tuple[State, Any, Covariance]:
    like = jnp.zeros_like(estimate.position[0])
    count = p.heuristic.straight.strides + 1
    run = Run(*(like,) * 7, jnp.zeros_like(estimate.position))
    state = State(
        started(like), estimate.position, (like,) * count, (like,) * count, like, Axis(*(like,) * 3), run
    )
    return state, estimate, P


def _step(p: Any, site: Any, state: State, from_: Seen) -> Measured:
    nav, q, dt = from_.estimate, p.heuristic, from_.sample.dt
    way: Straight = q.straight
    still = from_.gates["stance"].weight
    clock, (_, now) = tick(state.clock, still, dt, way.dwell_s, way.gap_s)
    stride = nav.position - state.place
    length = hypotenuse(stride[0], stride[1], small=1e-12)
    if way.heading == "stride":
        heading = jnp.arctan2(stride[1], stride[0] + 1e-12)
    else:
        heading = jnp.arctan2(nav.attitude[1, 0], nav.attitude[0, 0] + 1e-12)
    walks = length >= way.shortest
    ended, broken = (now > 0) & walks, (now > 0) & ~walks
    follow = jnp.where(broken, 0.0, state.follow + jnp.where(ended, 1.0, 0.0))

    def shifted(old: tuple[Array, ...], new: Array) -> tuple[Array, ...]:
        return tuple(jnp.where(ended, a, b) for a, b in zip((*old[1:], new), old, strict=True))

    headings, times = shifted(state.headings, heading), shifted(state.times, clock.time)
    ratio = straight.log_ratio(way, headings)
    whole = ended & (follow > way.strides)
    is_straight = jnp.where(whole, gate(ratio, way.width, way.straight_through), 0.0)

    run, over = _run(q, state.run, now, is_straight, headings[0], times[0], nav.attitude[2])
    axis = state.axis
    away, known = 0.0 * heading, 0.0 * heading
    if q.form in heuristics.DIRECTED:
        if "took_over" in from_.more:  # the yaw that they were learnt with was wrong
            axis = Axis(*((1 - from_.more["took_over"]) * x for x in axis))
        axis = heuristics.learnt(q.directions, axis, heading, is_straight, from_.P["tt"][2, 2])
        away, known = heuristics.away_from(q.directions, axis, heading)
    compass = from_.more.get("heading_innovation")
    if q.form == "mihde" and compass is None:
        raise InputError(
            "heuristic.form = mihde needs a magnetic heading, which this system has none of; take ihde, or a "
            "system with a compass"
        )
    bent = jnp.exp(jnp.minimum(ratio, 5.0))
    walked = Walked(
        headings,
        times[-1] - times[-2],
        is_straight,
        bent,
        away,
        known,
        run,
        over,
        nav.attitude[2],
        compass,
        from_.P,
    )
    told = heuristics.FORMS[q.form](q, walked)
    weight = jnp.where(whole | (over > 0), told.weight, 0.0)
    if q.beside == "complement" and "quasi_static" in from_.more:
        weight = weight * (1 - from_.more["quasi_static"])
    moved = None
    if told.bias is not None:
        nothing = jnp.zeros_like(nav.position)
        correction = dict.fromkeys(states_of(from_.P), nothing) | {"g": weight * told.bias + nothing}
        if told.yaw is not None:
            yaw = weight * told.yaw
            correction["t"] = constant(np.array([0.0, 0.0, 1.0]), yaw) * yaw + nothing
        moved = from_.P, correction
    run = jax.tree.map(lambda x: jnp.where(over > 0, 0.0, x), run)
    place = jnp.where(now > 0, nav.position, state.place)
    new = State(clock, place, headings, times, follow, axis, run)
    more = {
        "stride_end": jnp.where(ended, 1.0, 0.0),
        "stride_heading": headings[-1],
        "deviation": away,
        "straightness": bent,
    }
    rows = told.rows
    gated = Gated(is_straight, jnp.where(whole, ratio, 10.0))
    return Measured(new, rows, None if rows is None else weight, gated, more, moved)


def _run(
    q: Heuristic, run: Run, now: Array, is_straight: Array, heading: Array, time: Array, up: Array
) -> tuple[Run, Array]:
    """The straight run with the oldest stride of a straight window, and whether it is over, 0 or 1: where the
    walk bends, or it is long enough. The oldest, because the newest may be the first of a bend."""
    goes_on = (now > 0) & (is_straight > 0.5)
    begins = goes_on & (run.strides < 0.5)
    first = jnp.where(begins, heading, run.heading), jnp.where(begins, time, run.time)
    y, t = rotations.wrap(heading - first[0]), time - first[1]
    one = jnp.where(goes_on, is_straight, 0.0)  # a stride counts as far as it is straight
    new = Run(*first, jnp.ones_like(t), t, t * t, y, t * y, up)
    sums = [total + one * x for total, x in zip(run[2:], new[2:], strict=True)]
    run = Run(*first, *sums)
    bends = (now > 0) & ~goes_on & (run.strides > 0.5)
    return run, jnp.where(bends | (run.strides >= q.slope.longest), 1.0, 0.0)


def _after(p: Any, state: State, by: str, correction: dict[str, Array], nav: Any) -> State:
    """Headings turn with whatever turns the yaw: a stride is straight by the gyroscope. Zhang's HDR takes
    what it made of earlier strides for the truth, and so does not turn them."""
    own = by == "heading_heuristic" and p.heuristic.form == "hdr"
    if own or by in TELL_NO_YAW:
        return state
    yaw, run = correction["t"][2], state.run
    moved = jnp.where(run.strides > 0.5, yaw, 0.0)
    run = run._replace(heading=run.heading + moved)
    headings = tuple(x + yaw for x in state.headings)
    return state._replace(headings=headings, run=run, place=state.place + correction["p"])


HEADING_HEURISTIC = Aid(
    name="heading_heuristic",
    wants=("t", "g", "v"),
    groups=(("heuristic", Heuristic),),
    gate="straight",
    reads=("stance",),
    is_on=lambda p: p.heuristic.form != "none",
    start=_start,
    step=_step,
    after=_after,
)
"""What straight walking, or the building's directions, say of yaw and gyroscope bias."""
