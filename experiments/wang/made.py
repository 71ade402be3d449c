"""Made walks outdoors as Wang's: 7 s of standing, a sensor as in Table 1, bumps of the field along the way;
and their errors, by exact truth and by a GPS of 1 m."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

import pedjax
from experiments import presets
from experiments.aiez.made import true_yaw, yaw_error
from pedjax.simulation.scenarios import load_scenario
from pedjax.simulation.world import simulate

PATHS = ("rectangle", "circle", "irregular")
BUMPS = {"bumps": 12, "low": 6.0, "high": 18.0}
GPS_M = 1.0
"""Standard deviation of a GPS position along each axis, one a second."""
GIVEN = np.radians(10.0)
"""Within which the first yaw is given to whoever has no alignment."""

EARTH = {"compass.strength": 48.0, "compass.inclination": float(np.radians(64.0)), "compass.declination": 0.0}
"""The undisturbed field of the simulator's Munich, as one looks it up."""


def walk(
    path: str, seed: int, calibrated: float = 0.0, along: float = 0.0, **field: float
) -> pedjax.Simulated:
    """A path with the field's numbers beside BUMPS; `calibrated` is the part of the sensor's constant errors
    that a calibration has taken away (0: Table 1, a gyroscope's bias of 0.2 deg/s); `along` µT is there
    whenever the foot stands, in a direction of the seed's."""
    scenario = load_scenario(path)
    where = {"kind": "outdoors", **BUMPS, **field}
    if along:
        way = np.random.default_rng([83, seed]).normal(size=3)
        scenario = replace(scenario, iron={"floor": tuple(along * way / np.linalg.norm(way))})
    return simulate(
        replace(scenario, sensors={"foot": "mti_g_710"}, calibrated=calibrated, field=where), seed
    )


def given_yaw(walked: pedjax.Simulated, seed: int) -> float:
    """The first yaw as somebody would tell it, rad."""
    return float(true_yaw(walked)[0] + np.random.default_rng([47, seed]).uniform(-GIVEN, GIVEN))


class Error(NamedTuple):
    """RMS and last distance from the exact truth, and the RMS from a GPS, in the plane, m."""

    exact: float
    end: float
    gps: float


def error(walked: pedjax.Simulated, track: pedjax.Track, seed: int) -> Error:
    """At every second; nothing is aligned: where the walk began is known, north is north."""
    truth = walked.truth["foot"]
    place = truth.motion.position[:, :2] - truth.motion.position[0, :2]
    at = np.arange(track.time[0] + 1.0, track.time[-1], 1.0)

    def seen(time: np.ndarray, position: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(at, time, position[:, k]) for k in range(2)], axis=1)

    true, found = seen(truth.time, place), seen(track.time, track.position)
    gps = true + np.random.default_rng([53, seed]).normal(0.0, GPS_M, true.shape)
    rms = (float(np.sqrt(np.mean(np.sum((found - x) ** 2, axis=1)))) for x in (true, gps))
    end = float(np.linalg.norm(track.position[-1, :2] - place[-1]))
    exact, by_gps = rms
    return Error(exact, end, by_gps)


def run(walked: pedjax.Simulated, preset: str, changes: Mapping[str, Any], seed: int) -> pedjax.Track:
    """A preset in the field of Munich; the first yaw is given where the preset does not align."""
    params = presets.params_of(preset)
    given = {} if params.compass.start == "field" else {"initial.heading": given_yaw(walked, seed)}
    return presets.run(walked.recording, preset, {**EARTH, **given, **changes})


__all__ = ["BUMPS", "EARTH", "PATHS", "Error", "error", "given_yaw", "run", "true_yaw", "walk", "yaw_error"]
