"""The first attitude of a foot that stands, from specific force and magnetic field (Wang 2018, Section 3).

Everything has lanes last, as filters have: a stand is `force`, `rate` and `field (n, 3, *L)` and the steps
`dt (n, *L)`, 0 for rows that do not count. C maps body to navigation axes (ENU); `north` is the azimuth of
the undisturbed horizontal field.

- `triad`: up by the mean force, magnetic north by the mean field. Closed, and exact for clean data.
- `weighted`: the same with the mean of those fields that are as strong and as steep as the earth's,
  w = (1 + ((‖m‖ − F)/σ_F)² + ((dip − I)/σ_I)²)⁻²: what passes by during a part of the stand is left out.
- `gauss_newton`: from sample to sample, with a gain that falls to a running mean of a second.
- `gda`: gradient descent on a quaternion (Madgwick), and `agda`, Wang's adaptive form,

      q ← q + ((d/(1 + d)) ½ q ⊗ ω − (1/(1 + d)) β ∇/‖∇‖) dt,   d = |‖m‖/F − 1|,   β = β₀/(1 + (t/t₀)²),

  with t₀ the `decay`, and less in proportion in a stand shorter than 5 s, which would end far from done; and
  with ∇/√(‖∇‖² + ε²) for ∇/‖∇‖, which is the limit ε = 0: steps that never get shorter zigzag about the
  solution, and what comes of them says nothing of how it moves with the gain.

What Wang prints and what is here (checked against finite differences and TRIAD):

- Eq. 3a stacks two gradients to a vector of eight; a quaternion's is Jᵀ h, with J 6 × 4.
- h and J have q₁q₂ for q₁q₃ twice and q₃ for q₄ once; here the gradient is taken of ½ ‖h‖² itself.
- The reference (cos κ, 0, + sin κ) beside a force that points up leads to an attitude that is degrees to tens
  of degrees wrong: with z up the field of the north has −sin κ.
- m is "normalised", which would make d zero: it is scaled by the earth's strength.
- Eq. 3e has no step dt and no normalisation (a superscript T stands for the step).
- ω is the rate less its mean over the stand: a bias of 0.2 deg/s would pull the descent after it.
- Eq. 4 has the disturbance with the wrong sign for Eq. 5; here δ = C m − mⁿ.

A constant β jitters by 2 β dt, or does not arrive. β₀/(1 + k/50), too, leaves one start in ten more than 20
degrees off after 5 s; with the square all of them arrive.

No method takes away a disturbance that is there all the time: the azimuth of C m is turned to north whatever
m is, so that δ has no part across north, by construction. And with the earth's known reference (`fixed`) a
disturbance tilts, too; with the reference as the data show it (`data`) tilt is the force's alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pedjax import rotations
from pedjax.lanes import constant, cross, dot, hypotenuse, matmul, matvec, norm, solve, transpose
from pedjax.parameters import leaf, parameters, setting

_KIT = "kit choice"
_DEGREE = 0.017453292519943295

METHODS = ("levelling", "triad", "weighted", "gauss_newton", "gda", "agda")
"""How a standing start gives the first attitude; `levelling` is the one that needs no field."""
SAMPLEWISE = ("gauss_newton", "gda", "agda")
"""Those that go from sample to sample; the mean of their last second counts."""

LAST_S = 1.0
"""How much of the end of a samplewise alignment is averaged, s."""
WHOLE_S = 5.0
"""A stand for which the descent's `decay` is told, s."""


@parameters
class Align:
    """Numbers of the alignment."""

    seconds: float = setting(
        7.0, source="Wang 2018: 7 s of standing",
        meaning="How much of the standing start is used, at most; longer, noise and sway average out, and "
        "what passes by matters less.",
    )  # fmt: skip
    reference: str = setting(
        "data", choices=("data", "fixed"), source="data: Madgwick; fixed: Wang 2018",
        meaning="Whether samplewise methods take the field's dip as the data show it, so that tilt is the "
        "force's alone, or as known.",
    )  # fmt: skip
    seed: str = setting(
        "triad", choices=("triad", "level"), source=_KIT,
        meaning="Where samplewise methods begin: at TRIAD of the first 0.2 s, or level and heading east.",
    )  # fmt: skip
    gain: Array = leaf(
        20.0, unit="1/s", low=1e-3, high=100.0, source=f"{_KIT}; Wang 2018: not printed", tune=True,
        when={"alignment": ("gda", "agda")},
        meaning="First gain of the descent; raised, far starts arrive sooner, and the end is noisier.",
    )  # fmt: skip
    decay: Array = leaf(
        1.0, unit="s", low=0.01, high=1e3, source=_KIT, tune=True, when={"alignment": ("gda", "agda")},
        meaning="Time at which the descent's gain is half (in a short stand, sooner); raised, far starts "
        "arrive more surely, and the end is noisier.",
    )  # fmt: skip
    softness: Array = leaf(
        0.05, unit="1", low=1e-6, high=10.0, source=f"{_KIT}; Madgwick: 0", tune=True,
        when={"alignment": ("gda", "agda")},
        meaning="Length of the gradient below which steps shrink with it; towards 0 they are as long as the "
        "gain says, raised the end is smoother and later.",
    )  # fmt: skip
    field_weight: Array = leaf(
        0.3, unit="1", low=1e-3, high=10.0, source=_KIT, tune=True, when={"alignment": "gauss_newton"},
        meaning="Weight of the field beside the force in Gauss-Newton; raised with a fixed reference, a "
        "disturbed field tilts more.",
    )  # fmt: skip
    strength_spread: Array = leaf(
        1.0, unit="uT", low=1e-3, high=100.0, source=_KIT, tune=True, when={"alignment": "weighted"},
        meaning="Distance from the earth's strength at which a field of the start counts for a quarter; "
        "raised, disturbed ones count, too.",
    )  # fmt: skip
    dip_spread: Array = leaf(
        1.0 * _DEGREE, unit="rad", low=1e-4, high=1.6, source=_KIT, tune=True, when={"alignment": "weighted"},
        meaning="Distance from the earth's dip at which a field of the start counts for a quarter; raised, "
        "disturbed ones count, too.",
    )  # fmt: skip
    covariance: str = setting(
        "measured", choices=("measured", "given"), source=_KIT,
        meaning="Whether the first attitude is as sure as the alignment shows, disturbance included, or as "
        "initial.attitude and compass.start_sigma say.",
    )  # fmt: skip
    check: str = setting(
        "tell", choices=("tell", "mend"), source=_KIT,
        meaning="What later clean fields, carried back by the gyroscope, make of a start that they say is "
        "wrong: they tell it, or turn the path.",
    )  # fmt: skip


class Stand(NamedTuple):
    """What is measured of a standing body: steps `dt (n, *L)` s, 0 where a row does not count; `force` m/s²,
    `rate` rad/s and calibrated `field` µT in body axes, `(n, 3, *L)`."""

    dt: Array
    force: Array
    rate: Array
    field: Array


class Earth(NamedTuple):
    """The undisturbed field: `strength` µT, `inclination` rad below the horizon and azimuth `north` rad,
    `(*L)` each."""

    strength: Array
    inclination: Array
    north: Array

    def field(self) -> Array:
        """In navigation axes, `(3, *L)` µT."""
        level = self.strength * jnp.cos(self.inclination)
        across = [level * jnp.cos(self.north), level * jnp.sin(self.north)]
        down = -self.strength * jnp.sin(self.inclination)
        return jnp.stack([x + 0 * down for x in (*across, down)])


class Aligned(NamedTuple):
    """The first `attitude (3, 3, *L)`, and how sure it is.

    `tilt` and `heading (*L)` rad² are the variances that the stand shows: by the unrest of force and field,
    the tilt's part in the heading, and the disturbance, see `heading_variance`. Unrest counts as of a single
    sample, since sway and what passes by are the same for many. `spread (2, *L)` rad is how
    far tilt and heading of single samples lie from it, RMS, in the last second. `field (3, *L)` is the mean
    field in navigation axes and `disturbance (3, *L)` that less the earth's, µT.
    """

    attitude: Array
    tilt: Array
    heading: Array
    spread: Array
    field: Array
    disturbance: Array


def _mean(x: Array, weights: Array) -> Array:
    """Of `x (n, 3, *L)`; zero where nothing counts."""
    total = jnp.maximum(jnp.sum(weights, axis=0), 1e-12)
    return jnp.sum(jnp.where(weights[:, None] > 0, weights[:, None] * x, 0.0), axis=0) / total


def _middles(dt: Array) -> Array:
    """The middle of each sample in time: a stretch of whole samples ends between two of them, however sums
    are rounded."""
    return jnp.cumsum(dt, axis=0) - 0.5 * dt


def triad(up: Array, field: Array, north: Array) -> Array:
    """C `(3, 3, *L)` of a body that sees `up` and `field (3, *L)`, of any length: the horizontal field points
    to the azimuth `north`. Where they are parallel yaw is arbitrary."""
    z = up / norm(up, small=1e-24)
    level = field - dot(z, field) * z
    x = level / norm(level, small=1e-24)
    y = matvec(rotations.skew(z), x)
    cos, sin = jnp.cos(north), jnp.sin(north)
    return jnp.stack([cos * x - sin * y, sin * x + cos * y, z + 0 * cos])


def dip(up: Array, field: Array) -> Array:
    """By how much a field points below the level of a body that sees `up`, rad: no attitude is needed. Both
    `(n, 3, *L)`."""
    along = jnp.sum(up * field, axis=1) / norm(up, axis=1, small=1e-24)
    across = jnp.sum(field * field, axis=1) - along * along
    return jnp.arctan2(-along, jnp.sqrt(jnp.maximum(across, 1e-12)))


def purity(p: Align, stand: Stand, earth: Earth) -> Array:
    """Weights `(n, *L)` of the fields of a stand, of sum 1: large where strength and dip are the earth's."""
    up = _mean(stand.force, stand.dt)
    odd = (norm(stand.field, axis=1, small=1e-12) - earth.strength) / p.strength_spread
    steep = (dip(up[None], stand.field) - earth.inclination) / p.dip_spread
    far = 1 + odd * odd + steep * steep
    least = jax.lax.stop_gradient(jnp.min(jnp.where(stand.dt > 0, far, 1e12), axis=0))
    weights = stand.dt * (least / far) ** 2  # over the largest, so that small ones keep their digits
    return weights / jnp.maximum(jnp.sum(weights, axis=0), 1e-12)


def body_from_navigation(q: Array) -> Array:
    """C_n^b `(3, 3, *L)` of a scalar-first quaternion `(4, *L)`, as Madgwick writes it: of one that is not of
    length 1 it is no rotation, and the descent's gradient is the one of this form."""
    w, x, y, z = q
    return jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]),
            jnp.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]),
            jnp.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def mismatch(q: Array, up: Array, field: Array, reference: Array) -> Array:
    """½ ‖h‖² `(*L)`: how badly q explains the unit force `up` and the `field`, `(3, *L)`, whose reference is
    `(3, *L)` with magnetic north along x and z up."""
    seen = body_from_navigation(q)
    h_up, h_field = seen[:, 2] - up, matvec(seen, reference) - field
    return 0.5 * (dot(h_up, h_up) + dot(h_field, h_field))


def _quaternion(c: Array) -> Array:
    """Of a rotation matrix C, scalar first: the row of the matrix q qᵀ whose diagonal is the largest."""
    t = c[0, 0] + c[1, 1] + c[2, 2]
    diagonal = [1 + t] + [1 - t + 2 * c[k, k] for k in range(3)]
    w = [c[2, 1] - c[1, 2], c[0, 2] - c[2, 0], c[1, 0] - c[0, 1]]
    xy, xz, yz = c[0, 1] + c[1, 0], c[0, 2] + c[2, 0], c[1, 2] + c[2, 1]
    rows = [
        [diagonal[0], *w],
        [w[0], diagonal[1], xy, xz],
        [w[1], xy, diagonal[2], yz],
        [w[2], xz, yz, diagonal[3]],
    ]
    best = jnp.argmax(jnp.stack(diagonal), axis=0)
    q = jnp.stack(rows[0])
    for k in range(1, 4):
        q = jnp.where(best == k, jnp.stack(rows[k]), q)
    return q / norm(q, small=1e-24)


def path(p: Align, method: str, stand: Stand, earth: Earth, first: Array | None = None) -> Array:
    """The attitude after each sample, `(n, 3, 3, *L)`, of a samplewise method, from `first (3, 3, *L)` or
    from where `initial.align.seed` says."""
    time = jnp.cumsum(stand.dt, axis=0)
    like = jnp.zeros_like(time[0] + sum(earth) + p.gain + p.decay + p.softness + p.field_weight)
    if first is None:
        early = jnp.where(_middles(stand.dt) < jnp.maximum(0.2, stand.dt[0]), stand.dt, 0.0)
        level = constant(np.eye(3), like) + 0 * like
        by_triad = triad(_mean(stand.force, early), _mean(stand.field, early), earth.north)
        first = by_triad if p.seed == "triad" else level
    turn = rotations.from_euler(like, like, earth.north + like)  # from axes with magnetic north along x
    start = matmul(transpose(turn), first + 0 * like)
    rate = stand.rate - _mean(stand.rate, stand.dt)  # what is there all the time is no turn but a bias
    given = (stand.dt, time, stand.force, rate, stand.field)
    if method == "gauss_newton":
        found = jax.lax.scan(lambda c, at: _newton(p, earth, c, at), start, given)[1]
    else:
        brief = jnp.minimum(time[-1] / WHOLE_S, 1.0)
        step = _descending(p, earth, jnp.maximum(p.decay * brief, 1e-3), method == "agda")
        found = jax.lax.scan(step, _quaternion(start), given)[1]
    return jnp.moveaxis(matmul(turn[:, :, None], jnp.moveaxis(found, 0, 2)), 2, 0)


_At = tuple[Array, Array, Array, Array, Array]


def _reference(p: Align, earth: Earth, seen: Array) -> Array:
    """The undisturbed field over the earth's strength, with magnetic north along x: known, or as steep as
    what is `seen (3, *L)`."""
    if p.reference == "data":
        level = hypotenuse(seen[0], seen[1], small=1e-12)
        return jnp.stack([level, 0 * level, seen[2]])
    flat, down = jnp.cos(earth.inclination), -jnp.sin(earth.inclination)
    return jnp.stack([flat + 0 * seen[0], 0 * seen[0], down + 0 * seen[0]])


def _newton(p: Align, earth: Earth, c: Array, at: _At) -> tuple[Array, Array]:
    """A step of Gauss and Newton on a small rotation in navigation axes."""
    dt, time, force, _, field = at
    up = matvec(c, force / norm(force, small=1e-24))
    seen = matvec(c, field / earth.strength)
    wanted = _reference(p, earth, seen)
    vertical = constant(np.array([0.0, 0.0, 1.0]), up[0]) + 0 * up

    def normal(a: Array, b: Array) -> tuple[Array, Array]:
        """JᵀJ and Jᵀh for a small turn that takes a to b, at b: J = −[b×]."""
        one = constant(np.eye(3), a[0])
        return dot(b, b) * one - b[:, None] * b[None], cross(a, b)

    (of_up, by_up), (of_field, by_field) = normal(up, vertical), normal(seen, wanted)
    if p.reference == "data":  # the field tells of yaw alone
        only = constant(np.diag([0.0, 0.0, 1.0]), up[0])
        of_field, by_field = wanted[0] ** 2 * only, by_field * constant(np.array([0.0, 0.0, 1.0]), up[0])
    ridge = 1e-9 * constant(np.eye(3), up[0])
    move = solve(of_up + p.field_weight * of_field + ridge, by_up + p.field_weight * by_field)
    gain = jnp.maximum(1 / (1 + 10 * time), dt / LAST_S)
    c = matmul(rotations.exp(jnp.where(dt > 0, gain, 0.0) * move), c)
    return c, c


def _descending(
    p: Align, earth: Earth, decay: Array, adaptive: bool
) -> Callable[[Array, _At], tuple[Array, Array]]:
    """A step of the gradient descent."""

    def total(q: Array, up: Array, field: Array, reference: Array) -> Array:
        return jnp.sum(mismatch(q, up, field, reference))

    def step(q: Array, at: _At) -> tuple[Array, Array]:
        dt, time, force, rate, field = at
        up, scaled = force / norm(force, small=1e-24), field / earth.strength
        seen = matvec(transpose(body_from_navigation(q)), scaled)
        slope = jax.grad(total)(q, up, scaled, _reference(p, earth, seen))
        down = slope / jnp.sqrt(dot(slope, slope) + p.softness**2)
        turning = 0.5 * jnp.concatenate([-dot(q[1:], rate)[None], q[0] * rate + cross(q[1:], rate)])
        beta = p.gain / (1 + (time / decay) ** 2)
        if adaptive:
            d = jnp.abs(norm(scaled, small=1e-12) - 1)
            move = (d * turning - beta * down) / (1 + d)
        else:
            move = turning - beta * down
        q = q + move * dt
        q = q / norm(q, small=1e-24)
        return q, transpose(body_from_navigation(q))

    return step


def heading_variance(field: Array, earth: Earth, tilt: Array, unrest: Array) -> Array:
    """Variance `(*L)` rad² of the heading that a mean `field (3, *L)` in navigation axes gives: by the
    variance of its `tilt` in rad², the readings' `unrest` in µT² along each axis, and the disturbance. Of a
    disturbance strength and inclination tell two components; the third, across, which turns the heading, is
    taken to be as large."""
    level = field[0] ** 2 + field[1] ** 2 + 1e-6
    size = level + field[2] ** 2
    steep = jnp.arctan2(-field[2], jnp.sqrt(level))
    odd = (jnp.sqrt(size) - earth.strength) ** 2 + size * (steep - earth.inclination) ** 2
    return (tilt * field[2] ** 2 + unrest + 0.5 * odd) / level


def aligned(p: Align, method: str, stand: Stand, earth: Earth, first: Array | None = None) -> Aligned:
    """The attitude of a stand by one of `METHODS` but levelling; `first (3, 3, *L)` is where a samplewise one
    begins, if not where its seed says."""
    dt = stand.dt
    middles = _middles(dt)
    last = jnp.where(middles > jnp.sum(dt, axis=0) - LAST_S, dt, 0.0)
    if method in SAMPLEWISE:
        attitudes = path(p, method, stand, earth, first)
        attitude = _middle(attitudes, last)
        weights = of_force = last
    else:
        of_force = dt
        weights = purity(p, stand, earth) if method == "weighted" else dt
        attitude = triad(_mean(stand.force, dt), _mean(stand.field, weights), earth.north)
        attitudes = jax.vmap(triad, in_axes=(0, 0, None))(stand.force, stand.field, earth.north)
    force, field = _mean(stand.force, of_force), _mean(stand.field, weights)
    sway = _variance(stand.force, force, of_force)
    tilt = sway / jnp.maximum(dot(force, force), 1e-12)
    seen = matvec(attitude, field)
    heading = heading_variance(seen, earth, tilt, _variance(stand.field, field, weights))
    return Aligned(attitude, tilt, heading, _spread(attitudes, attitude, last), seen, seen - earth.field())


def _variance(x: Array, mean: Array, weights: Array) -> Array:
    """Along an axis, mean of the three, `(*L)`."""
    away = (x - mean) ** 2
    return jnp.sum(_mean(away, weights), axis=0) / 3


def _middle(attitudes: Array, weights: Array) -> Array:
    """The rotation nearest to the weighted mean of `(n, 3, 3, *L)` that lie close together."""
    mean = jnp.sum(weights[:, None, None] * attitudes, axis=0)
    mean = mean / jnp.maximum(jnp.sum(weights, axis=0), 1e-12)
    for _ in range(4):
        mean = rotations.orthonormalise(mean)
    return mean


def _spread(attitudes: Array, middle: Array, weights: Array) -> Array:
    """RMS of tilt and heading about the middle, `(2, *L)` rad."""
    apart = jax.vmap(lambda c: rotations.log(matmul(c, transpose(middle))))(attitudes)
    square = _mean(apart * apart, weights)
    return jnp.sqrt(jnp.stack([square[0] + square[1], square[2]]) + 1e-24)


def left_over(field: Array, attitude: Array, disturbance: Array, earth: Earth) -> Array:
    """Wang's check τ (Eq. 5), µT: ‖mⁿ‖ − ‖m − C_n^b δ‖ of a later `field (3, *L)` in body axes, whose signs
    fit δ = C m − mⁿ.

    At the sample that δ comes from it is 0 whatever the attitude, and in the same field it stays so: it tells
    that the field has changed, never that the start was wrong.
    """
    still = field - matvec(transpose(attitude), disturbance)
    return earth.strength - norm(still, small=1e-12)


def oddity(up: Array, field: Array, earth: Earth) -> Array:
    """How far a field is from the earth's in strength and dip, µT `(*L)`: the part of a disturbance that can
    be seen without knowing the heading. What only turns the field about up is not seen."""
    size = norm(field, small=1e-12)
    steep = dip(up[None], field[None])[0] - earth.inclination
    return jnp.sqrt((size - earth.strength) ** 2 + (size * steep) ** 2 + 1e-24)


def converged(attitudes: Array, time: Array, final: Array, within: float) -> Array:
    """When, in s `(*L)`, the attitudes `(n, 3, 3, *L)` at `time (n, *L)` have come to within so many rad of
    the `final` one and stay there: the first of the samples from which on all are."""
    apart = jax.vmap(lambda c: norm(rotations.log(matmul(c, transpose(final)))))(attitudes)
    bad = apart > within
    index = jnp.arange(1, len(time) + 1).reshape(-1, *(1,) * (time.ndim - 1))
    after = jnp.max(jnp.where(bad, index, 0), axis=0)
    padded = jnp.concatenate([time, jnp.full_like(time[:1], jnp.inf)])
    return jnp.take_along_axis(padded, after[None], axis=0)[0]
