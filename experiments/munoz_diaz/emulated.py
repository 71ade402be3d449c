"""The walks of Munoz Diaz 2017 with a sensor in the pocket, as the paper emulates them: the exact motion of a
thigh, to which errors of a MEMS unit and one of several magnetic fields are added.

The walk is made once, with `WALK_SEED`; a seed draws the noises and the accelerometer's bias, and the same
ones for every field, so that the field is all that differs between two runs of a seed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from pedjax.errors import InputError, suggest
from pedjax.recording import Recording, Sensor, Stream, Truth
from pedjax.runtime import double_precision
from pedjax.simulation import fields
from pedjax.simulation.earth import homogeneous
from pedjax.simulation.footsteps import Leg, footsteps
from pedjax.simulation.motion import motion

Place = Literal["north_pole", "equator", "munich", "street"]
"""A homogeneous field of Table 1, or that of the Equator with lights and cars."""
Along = Literal["east", "north"]
"""Where the first leg leads."""
Back = Literal["same", "other"]
"""Whether all legs are walked on one line, or each on its own."""
Iron = Literal["none", "calibrated", "raw"]

RATE = 100.0
WALK_SEED = 0
STANDING = 5.0  # s, before and after
LENGTH, ROUNDS = 500.0, 3  # m a leg: the 600 m and the 3 km of the paper do not agree
SPEED = {"same": 1.31, "other": 1.345}
"""m/s, for 39 minutes, the turns included: 1.28 m/s over all."""

GYRO_NOISE = np.radians(0.1)  # of a sample, Table 2
BIAS = np.radians([-0.1, 0.1, -0.1])  # Table 2
FIELD_NOISE = 0.015  # µT of a sample, Table 2
FORCE_NOISE, FORCE_BIAS = 0.02, 0.03
"""m/s² of a sample, and the standard deviation of each axis' bias: as the preset xsens_mtw, for
what the paper does not print."""
TRUTH_EVERY = 5  # samples: truth at 20 Hz

LINES = (-17.0, -13.0, 0.0, 12.0, -9.0, 9.0)
"""m to the north, of each leg that has its own: so far apart that a light is felt on one of them only, a car
on one strongly."""
MET = ((2, 0.46, "car"), (3, 0.31, "lights"), (4, 0.92, "car"), (5, 0.62, "lights"))
"""On which leg a tile of the street is met, at which part of its length from the start, and what of it is
felt: for disturbances at 16, 24, 32 and 35 minutes, as in the paper's Fig. 10."""
_LINE_IN_TILE = {"car": -6.0, "lights": -12.85}
"""m to the north in the template, where the line runs: the car 3 m beside it and the lights out of reach, or
two lights 0.45 m beside it and the car out of reach."""
_TILE, _MIDDLE = 16.0, 14.0  # m along Easting: a tile's length, and the middle of the first one

MTW_LENGTH, MTW_ROUNDS, MTW_SPEED = 180.0, 12, 1.76  # 4.3 km in 44 minutes
MTW_BIAS = np.radians([-0.12, 0.05, -0.22])  # Table 3 as the text has it; y is chosen
MTW_WANDER, MTW_TIME = np.radians(10.0 / 3600) / 0.617, 200.0  # rad/s and s, as the preset xsens_mtw
IRON: dict[str, tuple[Any, Any]] = {
    "none": (np.zeros(3), np.eye(3)),
    "calibrated": (np.array([0.4, -0.3, 0.5]), np.eye(3) + 0.1 * np.array(_SOFT := (
        (0.04, 0.02, -0.01), (0.02, -0.03, 0.015), (-0.01, 0.015, 0.02),
    ))),
    "raw": (np.array([25.0, -18.0, 32.0]), np.eye(3) + np.array(_SOFT)),
}  # fmt: skip
"""Hard iron (µT) and soft iron of the magnetometer: none, what a calibration leaves of it, and all."""


class Exact(NamedTuple):
    """What is true of the pocket at `time (T,)` s: `position (T, 3)` m and `attitude (T, 3, 3)`, body to
    navigation (ENU); in body axes specific `force` at each sample, m/s², and the mean `rate` over the step
    that ends there, rad/s, as one reads off a fibre gyroscope: C_k = C_{k-1} exp(rate_k dt), exactly."""

    time: np.ndarray
    position: np.ndarray
    attitude: np.ndarray
    rate: np.ndarray
    force: np.ndarray


class Emulated(NamedTuple):
    """A `recording` of sensor "pocket", and what it is made of: the `exact` motion, the true `bias (T, 3)`
    of the gyroscope in rad/s, the `field (T, 3)` in navigation axes in µT, and the number of the `nearest`
    post (T,), -1 without: where it changes from one sample to the next, the field jumps."""

    recording: Recording
    exact: Exact
    bias: np.ndarray
    field: np.ndarray
    nearest: np.ndarray

    @property
    def crossing(self) -> np.ndarray:
        """Samples `(T,)` at which another post has become the nearest."""
        return np.concatenate([[False], np.diff(self.nearest) != 0])


def emulated(
    seed: int,
    field: Place = "munich",
    along: Along = "east",
    back: Back = "same",
    length: float = LENGTH,
    rounds: int = ROUNDS,
) -> Emulated:
    """The walk of section 3.1 in a field; `length` m of a leg, two legs a round."""
    for value, known in ((field, Place), (along, Along), (back, Back)):
        if value not in get_args(known):
            raise InputError(f"'{value}' is unknown{suggest(value, get_args(known))}")
    if field == "street" and along != "east":
        raise InputError("the street runs east: take along = 'east' with it")
    exact = walk(along, back, length, rounds)
    there, nearest = _field(field, along, back, length, rounds)
    count = len(exact.time)
    name = f"{field}-{along}-{back}:{seed}"
    return _measured(name, seed, exact, np.broadcast_to(BIAS, (count, 3)), there, nearest, "none")


def mtw(seed: int, iron: Iron = "none", length: float = MTW_LENGTH, rounds: int = MTW_ROUNDS) -> Emulated:
    """The walk of section 3.2 in Munich, its biases wandering about Table 3 (first-order Gauss-Markov)."""
    if iron not in get_args(Iron):
        raise InputError(f"iron '{iron}' is unknown{suggest(iron, get_args(Iron))}")
    exact = _mtw_walk(length, rounds)
    count = len(exact.time)
    bias = MTW_BIAS + wandering(np.random.default_rng([97, seed]), count, MTW_WANDER, MTW_TIME)
    field = np.broadcast_to(np.asarray(homogeneous("munich")), (count, 3))
    return _measured(f"mtw-{iron}:{seed}", seed, exact, bias, field, np.full(count, -1), iron)


def wandering(
    rng: np.random.Generator, count: int, std: float, time: float, rate: float = RATE
) -> np.ndarray:
    """A stationary first-order Gauss-Markov process of three axes, `(count, 3)`."""
    c = np.exp(-1 / (rate * time))
    kicks = std * rng.normal(size=(count, 3))
    kicks[1:] *= np.sqrt(1 - c**2)
    return np.asarray(lfilter([1.0], [1.0, -c], kicks, axis=0))


@lru_cache(maxsize=4)
def walk(along: Along = "east", back: Back = "same", length: float = LENGTH, rounds: int = ROUNDS) -> Exact:
    """The exact motion of the walk of section 3.1, made once."""
    if along == "north":  # the same walk, turned
        return _turned(walk("east", back, length, rounds))
    return _exact(_legs(length, lines(back, rounds), SPEED[back], "walk"))


@lru_cache(maxsize=1)
def _mtw_walk(length: float, rounds: int) -> Exact:
    return _exact(_legs(length, (0.0,) * (2 * rounds), MTW_SPEED, "fast"))


def lines(back: Back, rounds: int = ROUNDS) -> tuple[float, ...]:
    """m to the north, of the line of each leg."""
    count = 2 * rounds
    if back == "same":
        return (0.0,) * count
    if count > len(LINES):
        raise InputError(f"there are lines for {len(LINES)} legs, not for {count}; take fewer rounds")
    return LINES[:count]


def _legs(length: float, north: tuple[float, ...], speed: float, gait: str) -> list[Leg]:
    """Out and back by turns, with a way across where the next line is another."""
    legs, x = [], 0.0
    for k, y in enumerate(north):
        legs.append(Leg(points=((x, y), (length - x, y)), speed=speed, gait=gait))
        x = length - x
        if k + 1 < len(north) and north[k + 1] != y:
            legs.append(Leg(points=((x, y), (x, north[k + 1])), speed=speed, gait=gait))
    return legs


def _exact(legs: list[Leg]) -> Exact:
    plan = footsteps(legs, WALK_SEED, STANDING)
    time = np.arange(int(plan.seconds * RATE)) / RATE
    moved = motion(plan.walker, time, "pocket")
    turned = np.einsum("tji,tjk->tik", moved.attitude[:-1], moved.attitude[1:])
    rate = RATE * Rotation.from_matrix(turned).as_rotvec()
    rate = np.concatenate([moved.angular_rate[:1], rate])
    return Exact(time, moved.position, moved.attitude, rate, moved.specific_force)


def _turned(exact: Exact) -> Exact:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return exact._replace(position=exact.position @ quarter.T, attitude=quarter @ exact.attitude)


def street(back: Back = "same", length: float = LENGTH, rounds: int = ROUNDS) -> fields.Field:
    """The Equator with tiles of the paper's template where they are met, each moved north beside its line."""
    north = lines(back, rounds)
    base, posts = fields.compose(homogeneous("equator")), []
    for leg, share, what in MET:
        if leg < len(north):
            tile = fields.street_template(1, round((share * length - _MIDDLE) / _TILE)).cylinders
            moved = jnp.array([0.0, north[leg] - _LINE_IN_TILE[what]])
            posts.append(tile._replace(place=tile.place + moved))
    return fields.compose(base, *posts)


@lru_cache(maxsize=4)
def _field(field: Place, along: Along, back: Back, length: float, rounds: int) -> tuple[Any, np.ndarray]:
    """The field `(T, 3)` along a walk, and the nearest post."""
    exact = walk(along, back, length, rounds)
    count = len(exact.time)
    if field != "street":
        return np.broadcast_to(np.asarray(homogeneous(field)), (count, 3)), np.full(count, -1)
    with double_precision():
        posts, place = street(back, length, rounds), jnp.asarray(exact.position.T)
        there, nearest = _along(posts, place)
        if bool(fields.inside(posts, place).any()):
            raise InputError("the walk leads through a post; move the lines or the tiles")
    return np.asarray(there).T, np.asarray(nearest)


@jax.jit
def _along(field: fields.Field, place: jax.Array) -> tuple[jax.Array, jax.Array]:
    return fields.field_at(field, place, mode="nearest"), fields.nearest_object(field, place)


def _measured(
    name: str, seed: int, exact: Exact, bias: np.ndarray, field: np.ndarray, nearest: np.ndarray, iron: Iron
) -> Emulated:
    rng = np.random.default_rng([89, seed])
    shape = exact.rate.shape
    force_bias = FORCE_BIAS * rng.normal(size=3)
    rate = exact.rate + bias + GYRO_NOISE * rng.normal(size=shape)
    hard, soft = IRON[iron]
    seen = np.einsum("tji,tj->ti", exact.attitude, field) @ soft.T + hard
    seen = seen + FIELD_NOISE * rng.normal(size=shape)
    force = exact.force + force_bias + FORCE_NOISE * rng.normal(size=shape)
    some = slice(None, None, TRUTH_EVERY)
    turned = Rotation.from_matrix(exact.attitude[some]).as_quat(scalar_first=True)
    truth = Truth(exact.time[some], exact.position[some] - exact.position[0], turned, "pocket")
    streams = [Stream(exact.time, x) for x in (force, rate, seen)]
    sensor = Sensor(streams[0], streams[1], streams[2], up="+z")
    recording = Recording(name, {"pocket": sensor}, truth=truth, format="simulated")
    return Emulated(recording, exact, bias, field, nearest)


class Meeting(NamedTuple):
    """A disturbance of the strength: when it is largest, s, by how much µT, from what (`car`, `light`), and
    how near m the sensor comes to its axis meanwhile."""

    time: float
    size: float
    what: str
    distance: float


def meetings(walked: Emulated, posts: fields.Field, least: float = 0.5, apart: float = 20.0) -> list[Meeting]:
    """Where the strength differs from the background's by `least` µT or more; what lies less than `apart` s
    apart is one."""
    usual = float(np.linalg.norm(np.asarray(posts.background)))
    off = np.linalg.norm(walked.field, axis=1) - usual
    index = np.flatnonzero(np.abs(off) >= least)
    if not len(index):
        return []
    place, radius = np.asarray(posts.cylinders.place), np.asarray(posts.cylinders.radius)
    found = []
    for part in np.split(index, np.flatnonzero(np.diff(index) > apart * RATE) + 1):
        k = part[np.abs(off[part]).argmax()]
        post = walked.nearest[k]
        distance = float(np.linalg.norm(walked.exact.position[part, :2] - place[post], axis=1).min())
        what = "car" if radius[post] > 0.5 else "light"
        found.append(Meeting(float(walked.exact.time[k]), float(off[k]), what, distance))
    return found


class Swing(NamedTuple):
    """How the thigh swings: half of its range in pitch, deg, and its frequency, Hz; in which `share` of the
    walk the specific force is within 0.5 m/s² of 9.8, by how much the z-axis is off upright in those moments
    and in all, deg, medians, and within 5 deg in which share of those."""

    amplitude: float
    frequency: float
    share: float
    off_upright: float
    off_upright_all: float
    upright: float


def swing(exact: Exact) -> Swing:
    """The swing over a minute of walking, or what there is of it."""
    first = int((STANDING + 5) * RATE)
    some = slice(first, first + int(60 * RATE))
    pitch = np.degrees(-np.arcsin(exact.attitude[some, 2, 0]))
    low, high = np.percentile(pitch, [2, 98])
    spectrum = np.abs(np.fft.rfft(pitch - pitch.mean()))
    away = np.degrees(np.arccos(np.clip(exact.attitude[some, 2, 2], -1, 1)))
    calm = np.abs(np.linalg.norm(exact.force[some], axis=1) - 9.8) < 0.5
    return Swing(
        float(high - low) / 2,
        float(spectrum.argmax() * RATE / len(pitch)),
        float(calm.mean()),
        float(np.median(away[calm])),
        float(np.median(away)),
        float((away[calm] < 5).mean()),
    )
