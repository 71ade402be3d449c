"""Made walks, and what is known of them: the true yaw, and yaw that is forced to be wrong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import pedjax
from experiments import presets
from pedjax.simulation.scenarios import load_scenario
from pedjax.simulation.world import simulate

CALIBRATED = {"teaching-building": 0.6, "turned-field": 0.6}
"""How much of a sensor's errors a calibration has taken away, where it is not the scenario's: with 0.6 the
kit's IEZ closes the paper's walk at 1.8 %, as the paper's does (1.84 %)."""


def walk(place: str, seed: int, **changes: Any) -> pedjax.Simulated:
    scenario = replace(load_scenario(place), **changes)
    calibrated = CALIBRATED.get(place, scenario.calibrated)
    return simulate(replace(scenario, calibrated=calibrated), seed)


def true_yaw(walked: pedjax.Simulated) -> np.ndarray:
    """Of the foot at every sample, rad, without jumps."""
    attitude = walked.truth["foot"].motion.attitude
    return np.unwrap(np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0]))


def given_yaw(walked: pedjax.Simulated) -> dict[str, Any]:
    """The first yaw as it truly is, instead of the field's."""
    return {"compass.start": "given", "initial.heading": float(true_yaw(walked)[0])}


def run(
    recording: pedjax.Recording, preset: str, changes: Mapping[str, Any], given: Mapping[str, Any]
) -> pedjax.Track:
    """A preset with changes; `given` only where its system has such parameters (IEZ has no compass)."""
    known = presets.params_of(preset)
    some = {path: value for path, value in given.items() if hasattr(known, path.partition(".")[0])}
    return presets.run(recording, preset, {**some, **changes})


def yaw_error(walked: pedjax.Simulated, track: pedjax.Track) -> np.ndarray:
    """Degrees, at every sample."""
    yaw = np.interp(track.time, walked.truth["foot"].time, true_yaw(walked))
    return np.degrees(np.angle(np.exp(1j * (track.euler[:, 2] - yaw))))


def end_error(walked: pedjax.Simulated, track: pedjax.Track) -> float:
    """Horizontal distance of the track's end from the true one, m; the starts are the same."""
    place = walked.truth["foot"].motion.position
    return float(np.linalg.norm(track.position[-1, :2] - (place[-1] - place[0])[:2]))


def field_error(walked: pedjax.Simulated, track: pedjax.Track) -> np.ndarray:
    """By how many degrees the field's direction is wrong at every sample."""
    truth = walked.truth["foot"]
    here, plain = truth.magnetic_field, truth.magnetic_field - truth.disturbance
    turn = np.arctan2(here[:, 1], here[:, 0]) - np.arctan2(plain[:, 1], plain[:, 0])
    return np.interp(track.time, truth.time, np.abs(np.degrees(np.angle(np.exp(1j * turn)))))


def forced(
    walked: pedjax.Simulated, degrees: float, at: float, axis: int = 2, among: pedjax.Recording | None = None
) -> tuple[pedjax.Recording, float]:
    """The recording (or one `among` others of the walk) with a glitch of one sample that turns the gyroscope
    by so much about a navigation axis, up unless said otherwise, in the stance nearest to `at` s; and when
    that was."""
    truth, recording = walked.truth["foot"], among or walked.recording
    still = np.flatnonzero(truth.stance)
    k = int(still[np.argmin(np.abs(truth.time[still] - truth.time[0] - at))])
    sensor = recording.sensors["foot"]
    rate = sensor.gyroscope.values.copy()
    rate[k] += np.radians(degrees) * walked.scenario.rate_hz * truth.motion.attitude[k, axis]
    gyroscope = replace(sensor.gyroscope, values=rate)
    return replace(recording, sensors={"foot": replace(sensor, gyroscope=gyroscope)}), float(truth.time[k])


def recovery_s(error: np.ndarray, time: np.ndarray, begin: float, below: float = 10.0) -> float:
    """Seconds after `begin` until the yaw's error is below so many degrees and stays so for ten seconds."""
    after = time > begin + 0.05
    time, bad = time[after] - begin, np.abs(error[after]) >= below
    last_bad = -np.inf
    for now, wrong in zip(time, bad, strict=True):
        if wrong:
            last_bad = now
        elif now - max(last_bad, 0.0) >= 10.0:
            return max(float(last_bad), 0.0)
    return np.inf
