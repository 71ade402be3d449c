"""How sure an ROC is: whole walks drawn again with replacement, thousands of curves at once.

Windows of one walk are alike, so it is walks that are drawn, never windows. The same draws serve every
detector, which makes the difference of two of them a paired one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pedjax.detection.curves import Roc, roc

LEVEL = 0.95
"""Of all intervals and bands."""


class Interval(NamedTuple):
    """A value, and where it lies with 95 %: NaN unless two walks at least have windows of either label, and
    too narrow where few of them have."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        known = np.isfinite(self.low)
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}]" if known else f"{self.value:.3f} [?]"

    def columns(self, title: str) -> dict[str, float]:
        """As columns of a table."""
        return {title: self.value, f"{title}_low": self.low, f"{title}_high": self.high}


class Band(NamedTuple):
    """Some points of a curve, `(M,)` each, from threshold to threshold, and between which `low` and `high`
    the probability of detection lies at that probability of false alarm (where a curve rises straight up, its
    highest)."""

    threshold: np.ndarray
    p_false_alarm: np.ndarray
    p_detection: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Banded(NamedTuple):
    """The `roc` of all walks, its `band`, the area under it, the standardised `partial` area at few false
    alarms (McClish: 1/2 by chance, 1 at best), and both `(2, B)` for each draw of walks."""

    roc: Roc
    band: Band
    auc: Interval
    partial: Interval
    drawn: np.ndarray


class Labelled(NamedTuple):
    """What several detectors say about the same labelled windows: by detector the `statistic`, the `label`,
    and by name the `parts` that a window may belong to (the first holds all). Each has one array `(K,)` a
    walk."""

    statistic: Mapping[str, Sequence[np.ndarray]]
    label: Sequence[np.ndarray]
    parts: Mapping[str, Sequence[np.ndarray]]

    def counts(self, part: str) -> tuple[int, int]:
        """How many windows of a part are what the detectors look for, and how many there are."""
        label = np.concatenate([y[keep] for y, keep in zip(self.label, self.parts[part], strict=True)])
        return int(label.sum()), len(label)


def compare(
    given: Labelled, *, draws: int = 2000, seed: int = 0, upto: float = 0.1
) -> dict[str, dict[str, Banded]]:
    """Every detector in every part that has windows of both labels."""
    chosen = draw(len(given.label), draws, seed)
    found: dict[str, dict[str, Banded]] = {}
    for part, masks in given.parts.items():
        label = [y[keep] for y, keep in zip(given.label, masks, strict=True)]
        whole = np.concatenate(label)
        if part != next(iter(given.parts)) and (whole.all() or not whole.any()):
            continue
        found[part] = {
            name: banded([t[keep] for t, keep in zip(each, masks, strict=True)], label, chosen, upto=upto)
            for name, each in given.statistic.items()
        }
    return found


def draw(walks: int, count: int = 2000, seed: int = 0) -> np.ndarray:
    """How often each walk comes in each draw, `(count, walks)`."""
    return np.random.default_rng(seed).multinomial(walks, np.full(walks, 1 / walks), count).astype(float)


def banded(
    statistic: Sequence[np.ndarray],
    label: Sequence[np.ndarray],
    draws: np.ndarray,
    *,
    upto: float = 0.1,
    most: int = 1000,
) -> Banded:
    """ROC with its band, from a statistic and labels walk by walk (small means yes).

    The curve of all walks is exact; the draws are taken at `most` of its thresholds, evenly along the curve.
    Draws without windows of both labels count for nothing.
    """
    curve = roc(np.concatenate(statistic), np.concatenate(label))
    along = curve.p_false_alarm + curve.p_detection
    if len(along) > most:
        kept = np.unique(np.searchsorted(along, np.linspace(0, 2, most), "left").clip(max=len(along) - 1))
    else:
        kept = np.arange(len(along))
    threshold = curve.threshold[kept]
    detected = np.stack([_below(t[y], threshold) for t, y in zip(statistic, label, strict=True)])
    alarmed = np.stack([_below(t[~y], threshold) for t, y in zip(statistic, label, strict=True)])
    of = np.array([[y.sum(), (~y).sum()] for y in label], float)
    yes, no = (draws @ of).T
    enough = bool(((of > 0).sum(axis=0) > 1).all())
    good = (yes > 0) & (no > 0)
    p_detection = np.pad(draws[good] @ detected / yes[good, None], ((0, 0), (1, 0)))
    p_false_alarm = np.pad(draws[good] @ alarmed / no[good, None], ((0, 0), (1, 0)))
    drawn = np.full((2, len(draws)), np.nan)
    drawn[:, good] = areas(p_false_alarm, p_detection, upto)
    at = curve.p_false_alarm[kept]
    if enough:
        low, high = _bounds(detection_at(p_false_alarm, p_detection, at))
    else:
        low = high = np.full(len(at), np.nan)
    exact = areas(np.pad(curve.p_false_alarm, (1, 0))[None], np.pad(curve.p_detection, (1, 0))[None], upto)
    auc, partial = (_interval(float(value[0]), d, enough) for value, d in zip(exact, drawn, strict=True))
    return Banded(curve, Band(threshold, at, curve.p_detection[kept], low, high), auc, partial, drawn)


def difference(a: Banded, b: Banded) -> tuple[Interval, Interval]:
    """Area and partial area of `a` less those of `b`, from the same draws of the same walks."""
    enough = bool(np.isfinite(a.auc.low))
    pairs = ((a.auc, b.auc), (a.partial, b.partial))
    auc, partial = (
        _interval(x.value - y.value, apart, enough)
        for (x, y), apart in zip(pairs, a.drawn - b.drawn, strict=True)
    )
    return auc, partial


def areas(p_false_alarm: np.ndarray, p_detection: np.ndarray, upto: float) -> np.ndarray:
    """Area under curves `(B, M)` that begin at the origin, and the standardised area up to a probability of
    false alarm: `(2, B)`."""
    width = np.diff(p_false_alarm)
    whole = (width * (p_detection[:, 1:] + p_detection[:, :-1])).sum(axis=1) / 2
    end = detection_at(p_false_alarm, p_detection, np.array([upto]))
    cut = np.where(p_false_alarm > upto, end, p_detection)
    width = np.diff(np.minimum(p_false_alarm, upto))
    partial = (width * (cut[:, 1:] + cut[:, :-1])).sum(axis=1) / 2
    chance = upto**2 / 2
    return np.stack([whole, (1 + (partial - chance) / (upto - chance)) / 2])


def detection_at(p_false_alarm: np.ndarray, p_detection: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Detection `(B, G)` of curves `(B, M)` that begin at the origin and end in 1 at given probabilities of
    false alarm `(G,)`: the highest, and straight between points."""
    rows, length = p_false_alarm.shape
    row = 2.0 * np.arange(rows)[:, None]  # one ascending array, so that one search serves all curves
    flat, height = (p_false_alarm + row).ravel(), p_detection.ravel()
    before = np.searchsorted(flat, (at + row).ravel(), "right") - 1
    after = np.minimum(before + 1, np.repeat((np.arange(rows) + 1) * length - 1, len(at)))
    alarm = p_false_alarm.ravel()
    width = alarm[after] - alarm[before]
    part = (np.tile(at, rows) - alarm[before]) / np.where(width > 0, width, 1.0)
    found = height[before] + part * (height[after] - height[before])
    return found.reshape(rows, len(at))


def _below(statistic: np.ndarray, threshold: np.ndarray) -> np.ndarray:
    """How many values lie below each threshold; all of them below an infinite one, as in `roc`."""
    ordered = np.sort(np.where(np.isnan(statistic), np.inf, statistic))
    count = np.searchsorted(ordered, threshold, "left")
    return np.where(np.isinf(threshold), len(ordered), count).astype(float)


def _bounds(drawn: np.ndarray) -> np.ndarray:
    low, high = 50 * (1 - LEVEL), 50 * (1 + LEVEL)
    return np.percentile(drawn, [low, high], axis=0)


def _interval(value: float, drawn: np.ndarray, enough: bool) -> Interval:
    ends = _bounds(drawn[np.isfinite(drawn)]) if enough else (np.nan, np.nan)
    return Interval(value, float(ends[0]), float(ends[1]))
