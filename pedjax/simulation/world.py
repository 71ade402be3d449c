"""A scenario come true: recordings with exact truth at every sample."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pedjax.recording import Landmarks, Recording, Sensor, Stream, Truth
from pedjax.runtime import double_precision
from pedjax.shapes import bucket
from pedjax.simulation import earth, fields, sensors
from pedjax.simulation.fields import Field
from pedjax.simulation.footsteps import GAITS, Leg, Plan, footsteps
from pedjax.simulation.labels import stance_middles
from pedjax.simulation.motion import Motion, motion, standing
from pedjax.simulation.presets import calibrated, preset
from pedjax.simulation.scenarios import Scenario, load_scenario, stretches_of
from pedjax.simulation.truth import SensorTruth

_PASSING = 2.0
"""m within which a walker passes a landmark."""


@dataclass(frozen=True)
class Simulated:
    """A `recording` as a reader would give it, the `truth` of each of its sensors, the `plan` of the walk,
    the `field` that it went through, and `steps`, `(N,)` s, when feet were put down."""

    scenario: Scenario
    seed: int
    recording: Recording
    truth: dict[str, SensorTruth]
    plan: Plan
    field: Field
    steps: np.ndarray

    def survey(self, height: float = 1.0) -> dict[str, np.ndarray]:
        """`survey_position`, `survey_field (M, 3)` in m and microtesla on the scenario's grid over the site,
        at a height in m; nothing where the scenario has no survey."""
        step = self.scenario.survey_m
        if not step:
            return {}
        low, high = self.plan.route[:, :2].min(axis=0) - 1.0, self.plan.route[:, :2].max(axis=0) + 1.0
        sides = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
        grid = np.stack([a.ravel() for a in np.meshgrid(*sides, indexing="ij")], axis=1)
        place = np.column_stack([grid, np.full(len(grid), height)])
        return {"survey_position": place, "survey_field": self.field_at(place)}

    def field_at(self, position: np.ndarray) -> np.ndarray:
        """The field `(M, 3)` in microtesla at places `(M, 3)` in m, at time 0."""
        with double_precision():
            return _field_along(self.field, position, np.zeros(len(position)), self.scenario.mode)


def simulate(scenario: str | Scenario, seed: int = 0) -> Simulated:
    """Walk a scenario: the same bits for the same seed, independent ones for another."""
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    legs = _paced(scenario, seed) * int(scenario.rounds)
    plan = footsteps(legs, seed, scenario.standing_s, f"scenario '{scenario.name}'")
    with double_precision():
        field = field_of(scenario, plan, seed)
        found = {
            place: _sensor(scenario, plan, field, place, name, seed)
            for place, name in scenario.sensors.items()
        }
    first = next(iter(found))
    truth = found[first][1]
    origin = truth.motion.position[0]
    paths = {place: _path(each, place, origin) for place, (_, each) in found.items()}
    recording = Recording(
        name=f"{scenario.name}:{seed}",
        sensors={place: sensor for place, (sensor, _) in found.items()},
        landmarks=_landmarks(scenario, truth, first),
        truth=paths.pop(first),
        truths=paths,
        format="simulated",
    )
    lands = np.sort(np.concatenate([plan.walker.left.lands, plan.walker.right.lands]))
    return Simulated(
        scenario=scenario,
        seed=seed,
        recording=recording,
        truth={place: each for place, (_, each) in found.items()},
        plan=plan,
        field=field,
        steps=lands[lands < plan.seconds],
    )


def _paced(scenario: Scenario, seed: int) -> tuple[Leg, ...]:
    """The legs, at the pace of this seed."""
    if not scenario.speeds:
        return scenario.legs
    low, high = scenario.speeds
    speed = float(np.random.default_rng([37, seed]).uniform(low, high))
    gait = min(("slow", "walk", "fast", "run"), key=lambda name: abs(math.log(GAITS[name].speed / speed)))
    own = [leg.kind != "walk" or leg.speed is not None for leg in scenario.legs]
    paced = (replace(leg, gait=gait, speed=speed) for leg in scenario.legs)
    return tuple(a if keep else b for keep, a, b in zip(own, scenario.legs, paced, strict=True))


def field_of(scenario: Scenario, plan: Plan, seed: int) -> Field:
    """The magnetic field of a scenario; that of a building is drawn with the seed."""
    given = dict(scenario.field)
    kind = given.pop("kind")
    given.pop("mode", None)
    munich = earth.homogeneous("munich")
    if kind == "building":
        low, high = plan.route[:, :2].min(axis=0) - 4.0, plan.route[:, :2].max(axis=0) + 4.0
        extent = ((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))
        path = jnp.asarray(plan.route.T)
        return _near(fields.building(jax.random.key(seed + 7919), extent, path=path, **given), plan.route)
    if kind == "street":
        return fields.street_template(**given)
    if kind == "floor_magnet":
        return fields.compose(munich, fields.floor_magnet(**given))
    if kind == "magnetised_walls":
        given["stretches"] = stretches_of(given, f"scenario '{scenario.name}'")
        return fields.compose(munich, fields.magnetised_walls(background=munich, **given))
    if kind == "outdoors":
        groups = fields.outdoors(plan.route, seed, standing_s=scenario.standing_s, **given)
        return fields.compose(munich, *groups)
    if kind == "earth":
        return fields.compose(
            earth.earth(given["latitude"], given["longitude"], given.get("height", 0.0), given["date"])
        )
    return fields.compose(jnp.zeros(3) if kind == "none" else earth.homogeneous(kind))


_FELT = 0.016
"""A/m: the least moment over cubed distance (3 nT) for which a piece of steel is kept."""

_AWAY = 1e4  # m, where the dipoles are that fill up


def _near(field: Field, route: np.ndarray) -> Field:
    """The field without the dipoles that are nowhere felt along the route: still free of divergence and
    curl, at a fraction of the cost."""
    from scipy.spatial import KDTree

    place = np.asarray(field.dipoles.position)
    apart, _ = KDTree(route[:, :2]).query(place[:, :2])
    size = np.linalg.norm(np.asarray(field.dipoles.moment), axis=1)
    keep = np.flatnonzero((size >= _FELT * apart**3) & (size > 0))
    spare = bucket(len(keep), 2) - len(keep)  # few counts to compile: no moment, no field
    position = np.concatenate([place[keep], np.full((spare, 3), _AWAY)])
    moment = np.concatenate([np.asarray(field.dipoles.moment)[keep], np.zeros((spare, 3))])
    return field._replace(
        dipoles=field.dipoles._replace(position=jnp.asarray(position), moment=jnp.asarray(moment))
    )


def _sensor(
    scenario: Scenario, plan: Plan, field: Field, place: str, name: str, seed: int
) -> tuple[Sensor, SensorTruth]:
    imu = calibrated(preset(name), 1.0 - scenario.calibrated)
    imu = replace(imu, clock=replace(imu.clock, rate=scenario.rate_hz))
    if scenario.iron:
        names = {"hard": "hard_iron", "soft": "soft_iron", "platform": "platform", "floor": "floor"}
        iron: dict[str, Any] = {names[k]: np.asarray(v, float) for k, v in scenario.iron.items()}
        imu = replace(imu, magnetometer=replace(imu.magnetometer, **iron))
    number = sorted(scenario.sensors).index(place)
    ticks = sensors.clock(imu.clock, seed * 16 + number, plan.seconds)
    moved = motion(plan.walker, ticks.time, place)
    there = np.asarray(_field_along(field, moved.position, ticks.time, scenario.mode))
    background = np.asarray(field.background, float)
    stance = standing(plan.walker, ticks.time, place)
    key = jax.random.fold_in(jax.random.key(seed), number)
    steps = np.diff(ticks.time, prepend=ticks.time[0] - 1 / scenario.rate_hz)
    count = len(ticks.time)
    spare = bucket(count, 2) - count  # few lengths to compile

    def padded(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x, np.repeat(x[-1:], spare, axis=0)])

    seen = np.einsum("tji,tj->ti", moved.attitude, there)
    given = (steps, moved.specific_force, moved.angular_rate, seen, moved.attitude, stance.astype(float))
    measured = _measure(imu, key, *map(padded, given))
    kept = ticks.kept
    stamps = ticks.stamps[kept]

    def arrived(x: Any) -> np.ndarray:
        return np.asarray(x, float)[:count][kept]

    streams = [Stream(stamps, arrived(x.values)) for x in measured[:2]]
    magnetic = measured.magnetometer
    assert magnetic is not None
    compass = None
    if scenario.field["kind"] != "none":
        compass = Stream(stamps, arrived(magnetic.values))
    truth = SensorTruth(
        time=stamps,
        motion=Motion(*(np.asarray(x)[kept] for x in moved)),
        gyroscope_bias=arrived(measured.gyroscope.bias),
        accelerometer_bias=arrived(measured.accelerometer.bias),
        magnetic_field=there[kept],
        disturbance=there[kept] - background,
        stance=stance[kept],
    )
    return Sensor(streams[0], streams[1], compass, up="+z"), truth


@jax.jit
def _measure(*given: Any) -> sensors.MeasuredImu:
    imu, key, steps, force, rate, magnetic, attitude, stance = given
    return sensors.apply_imu(imu, key, steps, force, rate, magnetic, attitude=attitude, stance=stance)


_AT_ONCE = 4096


def _field_along(field: Field, position: np.ndarray, time: np.ndarray, mode: str) -> np.ndarray:
    """The field `(T, 3)` along a path, some samples at a time: a building has thousands of dipoles."""
    parts = []
    for first in range(0, len(time), _AT_ONCE):
        place, at = position[first : first + _AT_ONCE], time[first : first + _AT_ONCE]
        spare = _AT_ONCE - len(at)
        place = np.concatenate([place, np.repeat(place[-1:], spare, axis=0)])
        at = np.concatenate([at, np.repeat(at[-1:], spare)])
        parts.append(np.asarray(_field_at(field, place.T, at, mode)).T[: _AT_ONCE - spare])
    return np.concatenate(parts)


_field_at = jax.jit(fields.field_at, static_argnames="mode")


def _path(truth: SensorTruth, place: str, origin: np.ndarray) -> Truth:
    """Position of the sensor at that place, seen from an origin `(3,)` in m, and orientation."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(truth.motion.attitude).as_quat(scalar_first=True)
    return Truth(truth.time, truth.motion.position - origin, turned, place)


def _landmarks(scenario: Scenario, truth: SensorTruth, sensor: str) -> Landmarks | None:
    """Where the sensor truly was each time the walker passed a landmark: in the stance that was nearest."""
    if not scenario.landmarks:
        return None
    place, time = truth.motion.position[:, :2], truth.time
    middles = stance_middles(truth.stance)
    marks = []
    for mark in scenario.landmarks:
        apart = np.linalg.norm(place[middles] - np.asarray(mark), axis=1)
        near = apart < _PASSING
        edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            marks.append(int(middles[begin + int(np.argmin(apart[begin:end]))]))
    if not marks:
        return None
    index = np.unique(marks)
    return Landmarks(time[index], truth.motion.position[index] - truth.motion.position[0], sensor)
