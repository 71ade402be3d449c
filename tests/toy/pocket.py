"""A toy: heading from a pocket, steps from the waist, the field of the place as a site. No stance anywhere.

One file, registered from outside: what a user's own system looks like. It is no good navigator.
"""

import tomllib
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

import pedjax
from pedjax import rotations
from pedjax.filters import covariance, kalman
from pedjax.filters.kalman import Rows
from pedjax.gates import SoftGate, gate, log_positive
from pedjax.lanes import align, dot, eye, lane_shape, matmul, matvec
from pedjax.parameters import group, leaf, parameters, setting
from pedjax.system import Gated, Inputs, Need, Output, Status, System
from pedjax.windows import trailing_mean


@parameters
class Test(SoftGate):
    """A gate with a threshold, and the noise of what it lets through."""

    threshold: Array = leaf(
        1.0, unit="1", low=1e-3, high=1e3, source="toy", tune=True, point=True,
        meaning="Statistic below which the gate opens; raised, it opens more often.",
    )  # fmt: skip
    sigma: Array = leaf(
        1.0, unit="1", low=1e-3, high=1e3, source="toy", tune=True,
        meaning="Noise of what the gate lets through; raised, it corrects less.",
    )  # fmt: skip


@parameters
class PocketParameters:
    gravity: Test = group(Test)
    field: Test = group(Test)
    gyroscope: Array = leaf(
        1e-3, unit="rad/s/sqrt(Hz)", low=1e-6, high=1.0, source="toy", tune=True,
        meaning="White noise of the gyroscope; raised, force and field turn the attitude more.",
    )  # fmt: skip
    bias: Array = leaf(
        1e-5, unit="rad/s^2/sqrt(Hz)", low=1e-9, high=1.0, source="toy",
        meaning="How fast the gyroscope's bias may wander; raised, its estimate follows sooner.",
    )  # fmt: skip
    bias_time: Array = leaf(
        100.0, unit="s", low=1.0, high=1e6, source="toy",
        meaning="Correlation time of the bias; raised, its estimate is kept for longer.",
    )  # fmt: skip
    start: Array = leaf(
        0.1, unit="rad", low=1e-3, high=3.0, source="toy",
        meaning="Standard deviation of the first attitude; raised, early readings turn it more.",
    )  # fmt: skip
    step_length: Array = leaf(
        0.7, unit="m", low=0.1, high=2.0, source="toy", tune=True,
        meaning="Length of a step; raised, the track is longer.",
    )  # fmt: skip
    opening_s: float = setting(
        1.0, source="toy",
        meaning="Length of the stretch at the start that levels and gives the first yaw.",
    )  # fmt: skip
    bounce: float = setting(
        1.0, source="toy: m/s^2 above gravity that make a step",
        meaning="Force above gravity that makes a step; higher, fewer steps are counted.",
    )  # fmt: skip


class Site(NamedTuple):
    """The undisturbed field `(3,)` µT in navigation axes."""

    field: Array


class Opening(NamedTuple):
    dt: Array
    force: Array
    field: Array


class Sample(NamedTuple):
    dt: Array
    force: Array
    rate: Array
    field: Array
    step: Array


class Estimate(NamedTuple):
    position: Array
    attitude: Array
    gyroscope_bias: Array


class State(NamedTuple):
    estimate: Estimate
    P: covariance.Covariance


def read_site(path):
    """A TOML file with `field = [east, north, up]`."""
    return Site(jnp.asarray(tomllib.loads(path.read_text())["field"]))


def prepare(p, sensors, dt, rate_hz, length=None):
    pocket, waist = sensors["pocket"], sensors["waist"]
    norm = trailing_mean(jnp.sqrt(jnp.sum(waist.force**2, axis=1)), max(round(0.2 * rate_hz), 1))
    high = norm > 9.8 + p.bounce
    begins = (high & ~jnp.roll(high, 1).at[0].set(True)).astype(dt.dtype)
    first = max(round(p.opening_s * rate_hz), 1)
    opening = Opening(dt[:first], pocket.force[:first], pocket.field[:first])
    return Inputs(Sample(dt, pocket.force, pocket.rate, pocket.field, begins), opening)


def _mean(values, dt):
    counts = (dt > 0)[:, None]
    return jnp.sum(jnp.where(counts, values, 0.0), axis=0) / jnp.sum(dt > 0, axis=0)


def start(p, site, opening):
    force, mag = _mean(opening.force, opening.dt), _mean(opening.field, opening.dt)
    shape = lane_shape(p, force[0])
    zero = jnp.zeros((3, *shape), force.dtype)
    force, mag = (align(x, 1, len(shape)) + zero for x in (force, mag))
    level = matvec(rotations.levelled(force, zero[0]), mag)
    true = align(site.field.astype(force.dtype), 1, len(shape))
    yaw = jnp.arctan2(true[1], true[0]) - jnp.arctan2(level[1], level[0])
    P = covariance.diagonal({"e": p.start + zero, "g": 0.01 + zero})
    return State(Estimate(zero, rotations.levelled(force, yaw), zero), P)


def _passes(own, statistic):
    ratio = log_positive(statistic) - jnp.log(own.threshold)
    return Gated(gate(ratio, own.width, own.straight_through), ratio)


def step(p, site, state, sample):
    position, C, bias = state.estimate
    lanes = position.ndim - 1
    dt, step_now = align(sample.dt, 0, lanes), align(sample.step, 0, lanes)
    force, rate, mag = (align(x, 1, lanes) for x in (sample.force, sample.rate, sample.field))
    C = matmul(C, rotations.exp(dt * (rate - bias)))
    keep = jnp.exp(-dt / p.bias_time)
    one = eye(3, position[0])
    P = covariance.predict(
        state.P,
        {"e": {"e": None, "g": -dt * C}, "g": {"g": keep}},
        {"e": p.gyroscope**2 * dt * one, "g": p.bias**2 * dt * one},
    )
    estimate = Estimate(position, C, keep * bias)
    gates = {}
    size = jnp.sqrt(dot(mag, mag) + 1e-12)
    true = align(site.field.astype(mag.dtype), 1, lanes) + 0 * mag
    up = align(jnp.array([0.0, 0.0, 9.8], mag.dtype), 1, lanes) + 0 * mag
    for name, own, seen, known in (("gravity", p.gravity, force, up), ("field", p.field, mag, true)):
        length = jnp.sqrt(dot(seen, seen) + 1e-12) - jnp.sqrt(dot(known, known) + 1e-12)
        gates[name] = _passes(own, length * length)
        found = matvec(estimate.attitude, seen)
        rows = Rows(known - found, own.sigma**2 * one, {"e": -rotations.skew(found)})
        P, correction = kalman.update(P, rows, gates[name].weight * (dt > 0))
        turned = matmul(rotations.exp(correction["e"]), estimate.attitude)
        estimate = Estimate(position, turned, estimate.gyroscope_bias + correction["g"])
    ahead = jnp.arctan2(estimate.attitude[1, 0], estimate.attitude[0, 0] + 1e-12)
    moved = step_now * p.step_length
    forward = jnp.stack([jnp.cos(ahead), jnp.sin(ahead), 0 * ahead])
    estimate = estimate._replace(position=position + moved * forward)
    gates["step"] = Gated(step_now + 0 * size, jnp.where(step_now > 0, -1.0, 1.0) + 0 * size)
    sound = jnp.isfinite(estimate.position[0]) & covariance.is_positive(P)
    status = jnp.where(sound, Status.HEALTHY, Status.DIVERGED).astype(jnp.int32)
    sigma = {"attitude": covariance.sigma(P, "e"), "gyroscope_bias": covariance.sigma(P, "g")}
    return State(estimate, P), Output(estimate, sigma, gates, status, {"field_strength": size})


POCKET: Any = pedjax.register_system(
    System(
        name="toy_pocket",
        title="heading from a pocket, steps from the waist",
        needs=(Need("pocket", field=True), Need("waist")),
        gates=("field", "gravity", "step"),
        defaults=PocketParameters,
        prepare=prepare,
        start=start,
        step=step,
        shortest=lambda p: (p.opening_s, "opening_s"),
        read_site=read_site,
    )
)
