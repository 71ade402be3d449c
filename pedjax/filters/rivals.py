"""Rival headings: what a filter does when its compass says, again and again, that its yaw is wrong.

A compass that must agree with the gyroscope before it is believed is locked out for ever once the yaw is
wrong; one that is believed because it agrees with itself is fooled by a field that is turned over many
strides. Neither can be told from the other while it happens. So the filter keeps its heading, and beside it
two rivals: a `fresh` one, born of looks that disagree, and the `former` one that was last given up.
Each look moves the log odds of a rival against the filter's heading,

    Λ ← (Λ − Λ₀) m + Λ₀ + u log[ℓ(e − δ; σ² + V) / ℓ(e; σ² + P_ψψ)],   ℓ(x; S) = (1 − ε) N(x; 0, S) + ε/2π,

with e the heading's innovation, δ by how much the rival's yaw is the larger, V and P_ψψ the variances of the
two, ε the share of looks that say nothing, u the less the odder the strength of the field, and Λ never below
its start Λ₀. Above 0 the rival takes over: the filter turns by δ, and with it the path walked since the rival
was born, and the heading that was left becomes the former. A new heading starts at a low Λ₀ and takes several
looks; one that had been believed before, at a higher, so that a filter which was fooled comes back within a
few strides, path and all.

Taking over is a decision, without a soft form: gradients go through what was chosen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.filters.covariance import Covariance, states_of
from pedjax.lanes import constant, matmul, matmul_t, matvec
from pedjax.parameters import leaf, parameters

_KIT = "kit choice"
_NOTHING = 1e4  # rad², the variance of a rival that is none
_CLEARLY = 0.75  # how likely it is, at least, that a look of which no rival is born is about the own heading
_HINT = 3.0  # log odds gained, about one look's, without which a rival that a look contradicts is replaced


@parameters
class RivalParameters:
    """How much it takes for another heading to be believed."""

    fresh: Array = leaf(
        20.0, unit="1", low=0.1, high=1e3, source=f"{_KIT}: about six looks", tune=True,
        meaning="Log odds against a heading that was never believed; raised, it takes more looks that agree "
        "to turn the filter.",
    )  # fmt: skip
    former: Array = leaf(
        9.0, unit="1", low=0.1, high=1e3, source=f"{_KIT}: two or three looks", tune=True,
        meaning="Log odds against the heading that was last given up; raised, it takes more looks to return "
        "to it.",
    )  # fmt: skip
    outliers: Array = leaf(
        0.2, unit="1", low=1e-4, high=0.99, scale="linear", source=_KIT,
        meaning="Share of looks that say nothing of the heading; raised, each look moves the odds less.",
    )  # fmt: skip
    oddity: Array = leaf(
        5.0, unit="uT", low=0.1, high=100.0, source=_KIT,
        meaning="Distance of the field's strength from its reference at which a look counts for less; "
        "raised, odd fields move the odds more.",
    )  # fmt: skip
    memory: Array = leaf(
        0.95, unit="1", low=0.0, high=1.0, scale="linear", source=_KIT,
        meaning="Part of the odds gained that is kept from look to look; raised, looks that agree may lie "
        "further apart.",
    )  # fmt: skip
    wander: Array = leaf(
        0.005, unit="rad/sqrt(s)", low=1e-6, high=1.0, source=f"{_KIT}: 2.2 deg in a minute",
        meaning="How fast a rival's yaw becomes unsure; raised, a former heading is forgotten sooner.",
    )  # fmt: skip


class Rival(NamedTuple):
    """Another heading: its yaw is larger than the filter's by `turn (*L)` rad, with a `variance (*L)` rad² of
    its own; the log `odds (*L)` for it; and the position `since (3, *L)` m from which the paths differ."""

    turn: Array
    variance: Array
    odds: Array
    since: Array


class Rivals(NamedTuple):
    """The one that looks suggest, and the one that was last given up."""

    fresh: Rival
    former: Rival


class Look(NamedTuple):
    """What a look says: whether there is one, `now (*L)` 0 or 1; the heading's `innovation` rad and the
    `variance` rad² of its noise; the variance `of_yaw` rad² of the filter's yaw; by how much the strength of
    the field is `odd`, µT; and the filter's `position (3, *L)`."""

    now: Array
    innovation: Array
    variance: Array
    of_yaw: Array
    odd: Array
    position: Array


def none(p: RivalParameters, position: Array) -> Rivals:
    """No rival, of a filter at `position (3, *L)`."""
    like = jnp.zeros_like(position[0])
    return Rivals(*(Rival(like, like + _NOTHING, like - start, position) for start in (p.fresh, p.former)))


def _likelihood(p: RivalParameters, away: Array, variance: Array) -> tuple[Array, Array]:
    """Log of ℓ, and how likely it is that the look is about this heading."""
    about = (1 - p.outliers) * jnp.exp(-0.5 * away * away / variance) / jnp.sqrt(2 * math.pi * variance)
    whole = about + p.outliers / (2 * math.pi)
    return jnp.log(whole), about / whole


def judged(p: RivalParameters, rivals: Rivals, look: Look, dt: Array) -> tuple[Rivals, Rival, Array]:
    """The rivals after a sample of `dt` s, with or without a look; the one that does best, and whether it
    takes over, `(*L)` 0 or 1. `taken_over` says what the filter makes of that."""
    rivals = Rivals(*(x._replace(variance=x.variance + p.wander**2 * dt) for x in rivals))
    own, agrees = _likelihood(p, look.innovation, look.variance + look.of_yaw)
    count = look.now * jnp.exp(-0.5 * (look.odd / p.oddity) ** 2)
    kept = jnp.where(look.now > 0, p.memory, 1.0)

    def moved(rival: Rival, start: Array) -> tuple[Rival, Array]:
        is_one = rival.variance < 0.5 * _NOTHING
        away = rotations.wrap(look.innovation - rival.turn)
        likely, about = _likelihood(p, away, look.variance + rival.variance)
        gained = jnp.maximum(kept * (rival.odds + start) + count * is_one * (likely - own), 0.0)
        gain = look.now * about * rival.variance / (rival.variance + look.variance) * is_one
        turn = rotations.wrap(rival.turn + gain * away)
        new = Rival(turn, (1 - gain) * rival.variance, gained - start, rival.since)
        return new, about

    fresh, explains = moved(rivals.fresh, p.fresh)
    former, _ = moved(rivals.former, p.former)
    weak = (fresh.odds + p.fresh < _HINT) & (look.now > 0)
    strange = weak & (agrees < _CLEARLY) & (explains < 0.5)
    newborn = Rival(look.innovation, look.variance, 0 * fresh.odds - p.fresh, look.position)
    fresh = _where(weak & ~strange & (agrees > explains), none(p, look.position).fresh, fresh)
    fresh = _where(strange, newborn, fresh)
    best = _where(former.odds > fresh.odds, former, fresh)
    return Rivals(fresh, former), best, jnp.where((best.odds > 0) & (look.now > 0), 1.0, 0.0)


def _where(chosen: Array, a: Rival, b: Rival) -> Rival:
    return Rival(*(jnp.where(chosen, x, y) for x, y in zip(a, b, strict=True)))


def left(p: RivalParameters, rivals: Rivals, best: Rival, over: Array, of_yaw: Array) -> Rivals:
    """The rivals once `best` took over (`over (*L)`), seen from the filter before it turns: the heading that
    it leaves, of the variance `of_yaw`, is the former, and there is no fresh one."""
    nothing = none(p, best.since).fresh
    given_up = Rival(0 * best.turn, of_yaw, 0 * best.odds - p.former, best.since)
    return Rivals(_where(over > 0, nothing, rivals.fresh), _where(over > 0, given_up, rivals.former))


def turned(rivals: Rivals, yaw: Array) -> Rivals:
    """The same rivals beside a filter whose yaw was corrected by `yaw (*L)` rad."""
    return Rivals(*(x._replace(turn=rotations.wrap(x.turn - yaw)) for x in rivals))


def taken_over(
    P: Covariance, best: Rival, over: Array, position: Array, velocity: Array
) -> tuple[Covariance, dict[str, Array]]:
    """The covariance and the correction by state that turn a filter with states t, p and v by the rival's
    yaw, and its path since the rival was born; nothing where `over (*L)` is 0. What the filter did not know
    of its yaw is kept, and what the rival does not know is added along a turn of the whole: u = [z, z × d,
    z × v] with d the path."""
    yaw = over * best.turn
    up = constant(np.array([0.0, 0.0, 1.0]), yaw)
    turn = rotations.from_euler(0 * yaw, 0 * yaw, yaw)
    path = matvec(turn, position - best.since)
    speed = matvec(turn, velocity)
    across = rotations.skew(up + 0 * path)
    along = {"t": up + 0 * path, "p": matvec(across, path), "v": matvec(across, speed)}
    spread = over * best.variance
    found = {}
    for name, block in P.items():
        a, b = name[0], name[1]
        block = matmul(turn, block) if a in along else block
        block = matmul_t(block, turn) if b in along else block
        both = a in along and b in along
        found[name] = block + spread * along[a][:, None] * along[b][None] if both else block
    nothing = 0 * path
    moves = {"t": yaw * up, "p": path - (position - best.since), "v": speed - velocity}
    return found, {state: moves.get(state, nothing) + nothing for state in states_of(P)}
