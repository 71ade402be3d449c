"""Straight-walking detectors against the true path of the foot."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.detection.bands import Labelled
from pedjax.detection.curves import Roc, Wanted
from pedjax.detection.field import stance_at
from pedjax.detection.judged import Judged
from pedjax.detection.points import Reached
from pedjax.detectors.straight import STRAIGHT_DETECTORS
from pedjax.errors import InputError
from pedjax.recording import Clock, Recording
from pedjax.running import run as run_system
from pedjax.simulation.labels import stance_middles
from pedjax.simulation.truth import SensorTruth
from pedjax.system import System


class StraightWalk(NamedTuple):
    """Of each window of strides `(K,)` on a walk: the `headings (N + 1, K)` rad that a filter gave them, the
    oldest first, and by how much the true path `bent` in it, rad."""

    name: str
    headings: np.ndarray
    bent: np.ndarray


def counts_strides(params: Any) -> bool:
    """Whether a system with these parameters can be asked: it has those of the heading heuristic,
    which can do `only_counting`."""
    return hasattr(getattr(params, "heuristic", None), "only_counting")


def straight_walk(
    recording: Recording,
    truth: SensorTruth,
    system: str | System,
    params: Any,
    *,
    sensor: str = "foot",
    clock: Clock | None = None,
) -> StraightWalk:
    """Run a system with nothing made of straight strides, nor of a field that it looks at, and put its
    strides into windows. The path bends by the angle between the first and the second half of the true way
    from stance to stance."""
    alone = replace(params, heuristic=params.heuristic.only_counting())
    if hasattr(getattr(params, "compass", None), "only_looking"):
        alone = replace(alone, compass=params.compass.only_looking())
    track = run_system(recording, system, alone, sensor=sensor, clock=clock)
    width = params.heuristic.straight.strides + 1
    ends = np.flatnonzero(track.more["stride_end"] > 0)
    whole = track.gates["straight"].log_ratio[ends] != 10.0  # no standing about in between
    last = np.flatnonzero(whole & (np.arange(len(ends)) >= width))
    if not len(last):
        raise InputError(
            f"{recording.name}: there is no window of {width} strides in a row; walk longer, or lower "
            "heuristic.straight.strides"
        )
    index = last - np.arange(width)[::-1, None]  # (N + 1, K)
    headings = track.more["stride_heading"][ends][index]
    here = stance_at(track.time[ends], truth)
    middles = stance_middles(truth.stance)
    place = truth.motion.position[middles, :2]
    first, half, now = (place[here[last - k]] for k in (width, width // 2, 0))
    ahead, before = now - half, half - first
    turn = np.arctan2(ahead[:, 1], ahead[:, 0]) - np.arctan2(before[:, 1], before[:, 0])
    return StraightWalk(recording.name, headings, np.abs(np.angle(np.exp(1j * turn))))


def judge_straight(
    system: System,
    params: Any,
    made: Iterable[tuple[Recording, SensorTruth]],
    detectors: Sequence[str] | None = None,
    *,
    sensor: str = "foot",
    clock: Clock | None = None,
    bent_below: float = 5.0,
) -> Judged:
    """Straight-walking detectors (None: all) of a system with a heading heuristic, on made walks. A window of
    strides is straight where the true path bends by less than `bent_below` degrees in it."""
    if not counts_strides(params):
        raise InputError(f"the system '{system.name}' has no heading heuristic; choose another system")
    names = tuple(STRAIGHT_DETECTORS) if detectors is None else detectors
    recordings, walks = [], []
    for recording, truth in made:
        recordings.append(recording)
        walks.append(straight_walk(recording, truth, system, params, sensor=sensor, clock=clock))
    label = [walk.bent < np.radians(bent_below) for walk in walks]

    def statistics(name: str) -> list[np.ndarray]:
        of = STRAIGHT_DETECTORS[name]
        return [np.asarray(of(list(jnp.asarray(walk.headings))), float) for walk in walks]

    entries = [
        {"duration_s": r.duration, "windows": len(y), "straight_fraction": float(y.mean())}
        for r, y in zip(recordings, label, strict=True)
    ]

    def at_point(name: str, curve: Roc, wanted: Wanted) -> Reached:
        inside = parameters.within(params, {"heuristic.straight.angle": curve.at(wanted)})
        angle = float(inside["heuristic.straight.angle"])
        reached = curve.detection_at(angle), curve.false_alarm_at(angle)
        return Reached({"heuristic.straight.detector": name, **inside}, *reached)

    return Judged(
        params,
        recordings,
        Labelled(
            {name: statistics(name) for name in names}, label, {"all": [np.full(len(y), True) for y in label]}
        ),
        entries,
        {"bent_below_deg": bent_below},
        at_point,
    )
