"""The walks and the variants of the filter that the experiments run, and what is measured of a bias."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from experiments.munoz_diaz import lanes
from experiments.munoz_diaz.emulated import BIAS, Along, Back, Emulated, Place, emulated
from pedjax import parameters
from pedjax.systems import system

LANES = 4
"""Recordings of one program: the processor's registers hold so many numbers, and more take longer each."""

SPREADS = {"0.57": np.radians(0.57), "0.039": np.radians(0.039)}
"""Standard deviation of the first bias, rad/s: a unit that nobody calibrated, and a good one."""

COMMON: dict[str, Any] = {"zero_acceleration.sigma": 20.0, "zero_acceleration.threshold": 0.3}
"""What is not printed. The force of a moment within 0.3 m/s² of 9.8 is off gravity by 2 m/s² along the
thigh's x (12 degrees of pitch), and for a few samples on end alike: sums over 10 s spread as if each sample
had 5.5 m/s² of its own."""


class Variant(NamedTuple):
    """A system and what is changed of it."""

    system: str
    changes: Mapping[str, Any] = {}

    def with_(self, **changes: Any) -> Variant:
        return self._replace(changes={**self.changes, **changes})

    def tree(self) -> Any:
        return parameters.replace(system(self.system).defaults(), {**COMMON, **self.changes})


class Scene(NamedTuple):
    """A walk: the field, where the first leg leads, and whether all legs are on one line."""

    place: Place
    along: Along = "east"
    back: Back = "same"
    length: float = 500.0
    rounds: int = 3

    def made(self, seed: int) -> Emulated:
        return emulated(seed, self.place, self.along, self.back, self.length, self.rounds)


class Ready:
    """Inputs of a scene over seeds, by system and settings made once, in groups of `LANES`."""

    def __init__(self, scene: Any, seeds: Sequence[int]) -> None:
        self.seeds = tuple(seeds)
        self._made = [scene.made(seed) for seed in seeds]
        self._kept: dict[Any, list[lanes.Inputs]] = {}
        some = slice(lanes.EVERY - 1, None, lanes.EVERY)
        self.attitude = self._made[0].exact.attitude[some]
        self.place = self._made[0].exact.position[some] - self._made[0].exact.position[0]
        self.bias = np.stack([m.bias[some] for m in self._made], axis=-1)  # (K, 3, R)

    def run(self, variant: Variant, more: Sequence[str] = (), skips: bool = False) -> lanes.Told:
        """A variant over all seeds; with `skips`, the samples at which another post becomes the nearest have
        no reading."""
        chosen, tree = system(variant.system), variant.tree()
        key = (tree.reference.form == "none", tree.initial.levelling_s, skips)
        if key not in self._kept:
            lost = self._made[0].crossing if skips else None
            self._kept.clear()  # a walk of 20 seeds takes most of a gigabyte
            self._kept[key] = [
                lanes.inputs(chosen, tree, [m.recording for m in some], least=LANES, lost=lost)
                for k in range(0, len(self._made), LANES)
                if (some := self._made[k : k + LANES])
            ]
        parts = [lanes.run(chosen, tree, given, more) for given in self._kept[key]]
        count = len(self._made)

        def joined(*found: np.ndarray) -> np.ndarray:
            return np.concatenate(found, axis=-1)[..., :count]

        first = parts[0]
        gates = {name: joined(*(p.weight[name] for p in parts)) for name in first.weight}
        told = {name: joined(*(p.more[name] for p in parts)) for name in first.more}
        bias, sigma, attitude, position = (joined(*x) for x in zip(*(p[1:5] for p in parts), strict=True))
        status = joined(*(p.status for p in parts))
        return lanes.Told(first.time, bias, sigma, attitude, position, gates, status, told)


class Measured(NamedTuple):
    """Of the bias along an axis of each run `(R,)`: `sure` min, when the filter's own deviation falls under
    0.02 deg/s, `reach` when the estimate comes to -0.08, `settle` from when it stays within 0.02 of the
    truth (infinite where it never does), the bias at the `end`, deg/s, and the mean squared error in units of
    the covariance, `nees`, after the first minute."""

    sure: np.ndarray
    reach: np.ndarray
    settle: np.ndarray
    end: np.ndarray
    nees: np.ndarray


NEAR = 0.02  # deg/s


def measured(told: lanes.Told, truth: np.ndarray | None = None, axis: int = 2) -> Measured:
    """What is measured of a run; the true bias is `(K, 3, R)`, or that of Table 2."""
    minutes = told.time / 60
    true = np.degrees(BIAS[axis] if truth is None else truth[: len(minutes), axis])
    bias, sigma = np.degrees(told.bias[:, axis]), np.degrees(told.sigma[:, axis])
    error = bias - true
    within = np.abs(error) < NEAR
    last_out = len(minutes) - 1 - np.argmax(~within[::-1], axis=0)
    settle = np.where(within.all(axis=0), minutes[0], minutes[np.minimum(last_out + 1, len(minutes) - 1)])
    settle = np.where(within[-1], settle, np.inf)
    late = minutes >= 1 if minutes[-1] > 1.5 else minutes >= 0
    return Measured(
        first_time(minutes, sigma < NEAR),
        first_time(minutes, bias <= -0.08),
        settle,
        bias[-1],
        ((error / sigma)[late] ** 2).mean(axis=0),
    )


def first_time(minutes: np.ndarray, where: np.ndarray) -> np.ndarray:
    """When it is first true, `(R,)`; infinite where it never is."""
    return np.where(where.any(axis=0), minutes[where.argmax(axis=0)], np.inf)


def yaw_error(told: lanes.Told, attitude: np.ndarray) -> np.ndarray:
    """`(K, R)` deg, unwrapped, from the end of the first block on."""

    def yaw(c: np.ndarray) -> np.ndarray:
        return np.arctan2(c[:, 1, 0], c[:, 0, 0])

    true = yaw(attitude[: len(told.time)])[:, None]
    off = np.unwrap(yaw(told.attitude) - true, axis=0)
    return np.degrees(off - off[:1])
