"""Field detectors against true labels: what a foot saw, the statistic of every window, and the ROC."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.aids.magnetic_heading import looking_of, north_of
from pedjax.detectors.field import FieldParameters, Look, log_ratio
from pedjax.errors import InputError
from pedjax.evaluation.resampling import Labelled
from pedjax.evaluation.roc import Reached, Roc, Wanted
from pedjax.recording import Clock, Recording
from pedjax.running import Track
from pedjax.running import run as run_system
from pedjax.shapes import bucket
from pedjax.simulation.footsteps import GAITS
from pedjax.simulation.labels import largest_changes, stance_edges, stance_middles
from pedjax.simulation.truth import SensorTruth

STRAIGHT, CURVED = np.radians(10.0), np.radians(30.0)
"""Turn of the foot within a window below which its path counts as straight, above which as curved (kit)."""


class Windows(NamedTuple):
    """N + 1 looks at the field each, the oldest first: `field (N + 1, 3, K)` µT in navigation axes, `yaw` rad
    and `time (N + 1, K)` s."""

    field: np.ndarray
    yaw: np.ndarray
    time: np.ndarray


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


def field_walk(
    recording: Recording,
    truth: SensorTruth,
    params: Any,
    system: Any = "ma2018",
    *,
    sensor: str = "foot",
    clock: Clock | None = None,
) -> FieldWalk:
    """Run the filter with nothing made of the field, so that no detector has a say in what it is given, and
    put what is true beside each window of looks."""
    if params.compass.looking.per == "sample":
        raise InputError("an ROC of field detectors judges steps: set compass.looking.per = step")
    changes = {"compass.update": "none", "compass.gyroscope_rows": False}
    levelling = {"compass.looking.levelling": looking_of(params.compass).levelling}
    alone = parameters.replace(params, {**changes, **levelling})
    track = run_system(recording, system, alone, sensor=sensor, clock=clock)
    steps = params.field.window
    at = np.flatnonzero(track.more["look"] > 0)
    if len(at) <= steps:
        raise InputError(
            f"{recording.name}: {len(at)} looks at the field are too few for a window of {steps} steps; walk "
            "longer or raise the stance detector's threshold"
        )
    here = stance_at(track.time[at], truth)
    return FieldWalk(recording.name, _windows(track, at, steps), *_truths(truth, here, steps))


def _windows(track: Track, at: np.ndarray, steps: int) -> Windows:
    def slid(x: np.ndarray) -> np.ndarray:
        return np.moveaxis(np.lib.stride_tricks.sliding_window_view(x[at], steps + 1, axis=0), -1, 0)

    field = np.moveaxis(slid(track.more["magnetic_field"]), 1, 2)
    return Windows(field, slid(track.euler[:, 2]), slid(track.time))


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
    """The statistics of detectors in all windows, in units of their thresholds (`vector`: over the threshold
    in force), with labels and parts."""
    ends = np.cumsum([len(w.moved) for w in walks])[:-1]
    windows, north = together(walks), float(north_of(params.compass))
    found = {}
    for name in detectors:
        chosen = parameters.replace(params.field, {"detector": name})
        with np.errstate(over="ignore"):
            value = np.exp(log_ratios(chosen, windows, north)) * _unit(params.field, name)
        found[name] = np.split(value, ends)
    return Labelled(found, [w.label(field_uT, heading_deg) for w in walks], parts(walks))


def _unit(p: FieldParameters, detector: str) -> float:
    named = {"magyq": "variance", "vector": None}.get(detector, "threshold")
    return float(getattr(getattr(p, detector), named)) if named else 1.0


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
    """A detector at an operating point of its ROC, as far as its bounds let it. The vector detector has no
    threshold of its own: what it has is found such that as many windows pass."""
    windows, north = together(walks), float(north_of(params.compass))
    own, threshold = f"field.{detector}", curve.at(wanted)
    values: dict[str, float]
    if detector == "vector":
        those = label if wanted.keep == "detection" else ~label
        some = Windows(*(x[..., those] for x in windows))
        values = _vector_at(params, threshold, some, north)
    elif detector == "magyq":
        limits = params.field.magyq
        scale = threshold / float(limits.variance)
        values = {f"{own}.variance": threshold, f"{own}.outlier": float(limits.outlier) * np.sqrt(scale)}
    else:
        values = {f"{own}.threshold": threshold}
    inside: dict[str, float | str] = {"field.detector": detector, **parameters.within(params, values)}
    passed = log_ratios(parameters.replace(params, inside).field, windows, north) < 0
    return Reached(inside, float(passed[label].mean()), float(passed[~label].mean()))


def _vector_at(params: Any, threshold: float, windows: Windows, north: float) -> dict[str, float]:
    """The false alarm with which as many windows pass as with the one in force and that threshold; the
    `change` where no false alarm does it. More windows pass the larger either is."""
    from scipy.special import ndtr, ndtri

    chosen = parameters.replace(params, {"field.detector": "vector"})
    wanted = int((np.exp(log_ratios(chosen.field, windows, north)) < threshold).sum())
    ways: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
        "field.vector.false_alarm": (ndtri, ndtr),
        "field.vector.change": (np.log, np.exp),
    }
    for path, (there, back) in ways.items():

        def passing(x: float, path: str = path, back: Callable[[Any], Any] = back) -> int:
            tried = parameters.replace(chosen, {path: float(back(x))})
            return int((log_ratios(tried.field, windows, north) < 0).sum())

        spec = parameters.specs(params)[path]
        low, high = float(there(spec.low)), float(there(spec.high))
        if not passing(low) <= wanted <= passing(high):
            continue
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (low, middle) if passing(middle) >= wanted else (middle, high)
        return {path: float(back(high))}
    return {path: float(back(high if wanted else low))}
