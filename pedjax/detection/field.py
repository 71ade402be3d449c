"""Field detectors against true labels: what a foot saw, and the statistic of every window."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.detection.bands import Labelled
from pedjax.detection.curves import Roc, Wanted
from pedjax.detection.judged import Judged
from pedjax.detection.points import Reached, is_searched, moved, searched, unit_of
from pedjax.detectors.field import FIELD_DETECTORS, FieldParameters, Look, log_ratio
from pedjax.errors import InputError
from pedjax.recording import Clock, Recording
from pedjax.running import run as run_system
from pedjax.shapes import bucket
from pedjax.simulation.footsteps import GAITS
from pedjax.simulation.labels import largest_changes, stance_edges, stance_middles
from pedjax.simulation.truth import SensorTruth
from pedjax.system import System

STRAIGHT, CURVED = np.radians(10.0), np.radians(30.0)
"""Turn of the foot within a window below which its path counts as straight, above which as curved (kit)."""


class Windows(NamedTuple):
    """N + 1 looks at the field each, the oldest first: `field (N + 1, 3, K)` µT in navigation axes, `yaw`
    rad, `time (N + 1, K)` s and the `variance` rad² of that yaw to the filter."""

    field: np.ndarray
    yaw: np.ndarray
    time: np.ndarray
    variance: np.ndarray


class FieldWalk(NamedTuple):
    """What a foot saw on one walk, window by window, and what is true of each `(K,)`: the largest change of
    the field from one stance to the next, `moved` µT and `heading` rad, the `turn` of the foot in rad, its
    `speed` in m/s, and the `anomaly` of the field's strength in µT."""

    name: str
    windows: Windows
    moved: np.ndarray
    heading: np.ndarray
    turn: np.ndarray
    speed: np.ndarray
    anomaly: np.ndarray

    def label(self, field_uT: float = 3.0, heading_deg: float = 5.0) -> np.ndarray:
        """Whether the field was quasi-static, as `pedjax.simulation.labels.quasi_static`."""
        return (self.moved < field_uT) & (self.heading < np.radians(heading_deg))

    def only(self, keep: np.ndarray) -> FieldWalk:
        """The windows of a mask `(K,)`."""
        windows = Windows(*(x[..., keep] for x in self.windows))
        return FieldWalk(self.name, windows, *(x[keep] for x in self[2:]))


def looks_at_field(params: Any) -> bool:
    """Whether a system with these parameters can be asked: they have those of detectors in `field`, and a
    `compass` that can do `only_looking` and knows `north`."""
    return hasattr(params, "field") and hasattr(getattr(params, "compass", None), "only_looking")


def field_walk(
    recording: Recording,
    truth: SensorTruth,
    system: str | System,
    params: Any,
    *,
    sensor: str = "foot",
    clock: Clock | None = None,
) -> FieldWalk:
    """What a foot saw on one walk, see `seen_windows`, with what is true beside each window of looks."""
    windows = seen_windows(recording, system, params, sensor=sensor, clock=clock)
    here = stance_at(np.append(windows.time[:-1, 0], windows.time[-1]), truth)  # of every look, once
    return FieldWalk(recording.name, windows, *_truths(truth, here, params.field.window))


def seen_windows(
    recording: Recording,
    system: str | System,
    params: Any,
    *,
    sensor: str = "foot",
    clock: Clock | None = None,
) -> Windows:
    """Run a system that looks at the field with nothing made of it, so that no detector has a say in what it
    is given, and put its looks into windows.

    `params` are the system's, see `looks_at_field`.
    """
    if params.compass.looking.per == "sample":
        raise InputError("field detectors are judged step by step: set compass.looking.per = step")
    alone = replace(params, compass=params.compass.only_looking())
    track = run_system(recording, system, alone, sensor=sensor, clock=clock)
    steps = params.field.window
    at = np.flatnonzero(track.more["look"] > 0)
    if len(at) <= steps:
        raise InputError(
            f"{recording.name}: {len(at)} looks at the field are too few for a window of {steps} steps; walk "
            "longer or raise the stance detector's threshold"
        )

    def slid(x: np.ndarray) -> np.ndarray:
        return np.moveaxis(np.lib.stride_tricks.sliding_window_view(x[at], steps + 1, axis=0), -1, 0)

    field = np.moveaxis(slid(track.more["magnetic_field"]), 1, 2)
    variance = track.sigma["attitude"][:, 2] ** 2
    return Windows(field, slid(track.euler[:, 2]), slid(track.time), slid(variance))


def stance_at(time: np.ndarray, truth: SensorTruth) -> np.ndarray:
    """The number of the true stance that each time `(K,)` s lies in or next to."""
    begin, end = stance_edges(truth.stance)
    first, last = truth.time[begin], truth.time[end - 1]
    before = np.clip(np.searchsorted(first, time, "right") - 1, 0, len(first) - 1)
    after = np.minimum(before + 1, len(first) - 1)
    return np.where(np.abs(first[after] - time) < time - last[before], after, before)


def _truths(truth: SensorTruth, here: np.ndarray, steps: int) -> list[np.ndarray]:
    """The largest changes, turn, speed and anomaly of the windows of looks in the stances `here (K,)`."""
    middles = stance_middles(truth.stance)
    field, attitude = truth.magnetic_field[middles], truth.motion.attitude[middles]
    yaw = np.unwrap(np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0]))[here]
    place, time = truth.motion.position[middles, :2][here], truth.time[middles][here]
    usual = np.linalg.norm(field - truth.disturbance[middles], axis=1)
    odd = np.abs(np.linalg.norm(field, axis=1) - usual)[here]
    path = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1)))
    looks = np.lib.stride_tricks.sliding_window_view(np.stack([yaw, odd]), steps + 1, axis=1)
    seconds = np.maximum(time[steps:] - time[:-steps], 1e-3)
    changes = [x[steps:] for x in largest_changes(field[here], steps)]  # of what the window looked at
    return [
        *changes,
        np.ptp(looks[0], axis=1),
        (path[steps:] - path[:-steps]) / seconds,
        looks[1].mean(axis=1),
    ]


@jax.jit
def _log_ratio(p: FieldParameters, windows: Any, north: Any) -> jax.Array:
    return log_ratio(p, tuple(Look(*each) for each in zip(*windows, strict=True)), north)


_AT_ONCE = 4096
"""Windows: few shapes to compile."""


def log_ratios(p: FieldParameters, windows: Windows, north: float = np.pi / 2) -> np.ndarray:
    """Log of the chosen detector's statistic over its threshold `(K,)` in each window."""
    count, dtype = windows.time.shape[1], jnp.result_type(float)
    found = []
    for first in range(0, count, _AT_ONCE):
        some = [x[..., first : first + _AT_ONCE] for x in windows]
        length = some[0].shape[-1]
        index = np.minimum(np.arange(bucket(length)), length - 1)
        given = tuple(jnp.asarray(x[..., index], dtype) for x in some)
        ratio = _log_ratio(parameters.cast(p, dtype), given, jnp.asarray(north, dtype))
        found.append(np.asarray(ratio, float)[:length])
    return np.concatenate(found)


def together(walks: Sequence[FieldWalk]) -> Windows:
    """The windows of all walks, end to end."""
    return Windows(*(np.concatenate(x, axis=-1) for x in zip(*(w.windows for w in walks), strict=True)))


def labelled(
    params: Any,
    detectors: Sequence[str],
    walks: Sequence[FieldWalk],
    field_uT: float = 3.0,
    heading_deg: float = 5.0,
) -> Labelled:
    """The statistics of detectors in all windows, to be held against the first of their operating points
    (where that is searched: over the threshold in force), with labels and parts."""
    ends = np.cumsum([len(w.moved) for w in walks])[:-1]
    windows, north = together(walks), float(params.compass.north())
    found = {}
    for name in detectors:
        chosen = parameters.replace(params.field, {"detector": name})
        with np.errstate(over="ignore"):
            value = np.exp(log_ratios(chosen, windows, north)) * unit_of(getattr(params.field, name), name)
        found[name] = np.split(value, ends)
    return Labelled(found, [w.label(field_uT, heading_deg) for w in walks], parts(walks))


def parts(walks: Sequence[FieldWalk]) -> dict[str, list[np.ndarray]]:
    """All windows; those on straight and on curved paths; by the gait whose speed is nearest, where there are
    several; and by thirds of the anomaly of the field's strength."""
    found = {
        "all": [np.full(len(w.turn), True) for w in walks],
        "straight": [w.turn < STRAIGHT for w in walks],
        "curved": [w.turn > CURVED for w in walks],
    }
    names = ("slow", "walk", "fast", "run")
    middle = np.log([GAITS[name].speed for name in names])
    edges = np.exp((middle[1:] + middle[:-1]) / 2)
    gait = [np.searchsorted(edges, w.speed) for w in walks]
    present = np.unique(np.concatenate(gait))
    if len(present) > 1:
        found |= {f"gait_{names[k]}": [g == k for g in gait] for k in present}
    thirds = np.quantile(np.concatenate([w.anomaly for w in walks]), [1 / 3, 2 / 3])
    third = [np.searchsorted(thirds, w.anomaly) for w in walks]
    return found | {
        f"anomaly_{name}": [t == k for t in third] for k, name in enumerate(("low", "mid", "high"))
    }


def at_point(
    params: Any,
    detector: str,
    curve: Roc,
    wanted: Wanted,
    walks: Sequence[FieldWalk],
    label: np.ndarray,
) -> Reached:
    """A detector at an operating point of its ROC, as far as its bounds let it. Where no threshold is among
    its points, they are found such that as many windows pass as with the statistic below that threshold."""
    windows, north = together(walks), float(params.compass.north())
    own, threshold = getattr(params.field, detector), curve.at(wanted)
    chosen = parameters.replace(params, {"field.detector": detector})
    prefix = f"field.{detector}"
    if is_searched(own, detector):
        those = label if wanted.keep == "detection" else ~label
        some = Windows(*(x[..., those] for x in windows))

        def passing(new: dict[str, float]) -> int:
            tried = parameters.replace(chosen, _below(prefix, new))
            return int((log_ratios(tried.field, some, north) < 0).sum())

        count = int((np.exp(log_ratios(chosen.field, some, north)) < threshold).sum())
        values = searched(own, detector, passing, count)
    else:
        values = moved(own, detector, threshold, unit_of(own, detector))
    inside = parameters.within(params, _below(prefix, values))
    passed = log_ratios(parameters.replace(chosen, inside).field, windows, north) < 0
    found = float(passed[label].mean()), float(passed[~label].mean())
    return Reached({"field.detector": detector, **inside}, *found)


def _below(prefix: str, values: dict[str, float]) -> dict[str, float]:
    return {f"{prefix}.{path}": value for path, value in values.items()}


def judge_field(
    system: System,
    params: Any,
    made: Iterable[tuple[Recording, SensorTruth]],
    detectors: Sequence[str] | None = None,
    *,
    sensor: str = "foot",
    clock: Clock | None = None,
    same_field: float = 3.0,
    same_heading: float = 5.0,
) -> Judged:
    """Field detectors (None: all) in a system that looks at the field, on made walks.

    The field is quasi-static where it changed by less than `same_field` µT, and its direction by less than
    `same_heading` degrees, from stance to stance. The walks may come one at a time: their truth is large, and
    not kept.
    """
    if not looks_at_field(params):
        raise InputError(f"the system '{system.name}' does not look at the field; choose another system")
    names = tuple(FIELD_DETECTORS) if detectors is None else detectors
    recordings, walks = [], []
    for recording, truth in made:
        recordings.append(recording)
        walks.append(field_walk(recording, truth, system, params, sensor=sensor, clock=clock))
    given = labelled(params, names, walks, same_field, same_heading)
    label = np.concatenate(given.label)
    entries = [
        {"duration_s": r.duration, "windows": len(y), "quasi_static_fraction": float(y.mean())}
        for r, y in zip(recordings, given.label, strict=True)
    ]
    return Judged(
        params,
        recordings,
        given,
        entries,
        {"same_field_uT": same_field, "same_heading_deg": same_heading},
        lambda name, curve, wanted: at_point(params, name, curve, wanted, walks, label),
    )
