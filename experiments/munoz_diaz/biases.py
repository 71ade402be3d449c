"""Munoz Diaz 2017, section 3.1: the biases of the gyroscope from gravity and from fields, Figures 8 to 11.

The published filter beside two that know what it leaves out: `moving average`, that two differences of
readings share the noise of the one between; and `state`, where the field is estimated, with or without a
deviation from it that comes and goes. Settings were chosen on seeds 0 to 5.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.munoz_diaz import biases_told as told
from experiments.munoz_diaz.lanes import Told
from experiments.munoz_diaz.scenes import SPREADS, Measured, Ready, Scene, Variant, measured, yaw_error
from experiments.table import Row
from pedjax.runtime import double_precision

PLACES = ("north_pole", "equator", "munich")
GRAVITY = Variant("munoz_diaz", {"reference.form": "none"})
PUBLISHED = Variant("munoz_diaz")
DETECTED = PUBLISHED.with_(**{"reference.detector": "steady"})
AVERAGED = PUBLISHED.with_(**{"reference.noise": "moving_average"})
ANCHORED = DETECTED.with_(**{"reference.form": "anchored"})
PLAIN = Variant("munoz_diaz_twin", {"reference.state.deviates": False})
DEVIATING = Variant("munoz_diaz_twin")
STREET = {"reference.state.deviation": 0.28, "reference.state.deviation_time": 1.8}
"""µT and s: standard deviation along each axis of what the street adds along its one line, and the time in
which its autocorrelation falls to a third."""
OF_STREET = DEVIATING.with_(**STREET)

HOMOGENEOUS = {
    "published": PUBLISHED,
    "moving average": AVERAGED,
    "state": PLAIN,
    "state, deviation": DEVIATING,
    "state, street's deviation": OF_STREET,
}
PERTURBED = {
    "published": PUBLISHED,
    "published, detector": DETECTED,
    "moving average, detector": DETECTED.with_(**{"reference.noise": "moving_average"}),
    "anchored, detector": ANCHORED,
    "state, deviation": DEVIATING,
    "state, deviation, detector": DEVIATING.with_(**{"reference.detector": "steady"}),
    "state, street's deviation": OF_STREET,
    "state, street's deviation, detector": OF_STREET.with_(**{"reference.detector": "steady"}),
}
START = {
    "as it is": {},
    "0.1 s of standing": {"initial.levelling_s": 0.1},
    "4 s of standing": {"initial.levelling_s": 4.0},
    "attitude 0.2 deg": {"initial.attitude": float(np.radians(0.2))},
    "attitude 10 deg": {"initial.attitude": float(np.radians(10.0))},
}


class Found(NamedTuple):
    """A run, of each axis what is `measured`, and the yaw's error `(K, R)` deg."""

    told: Told
    axes: tuple[Measured, Measured, Measured]
    yaw: np.ndarray


Key = tuple[str, str, str]
"""Scene, variant, spread of the first bias."""


def run(seeds: range, out: Path) -> list[Row]:
    with double_precision():
        found = everything(seeds)
        start = of_the_start(seeds)
    told.write(found, out)
    told.write_start(start, out)
    return [*told.rows(found), *told.start_rows(start)]


def scenes(**size: Any) -> dict[str, tuple[Scene, dict[str, Variant]]]:
    every = {"gravity": GRAVITY, **HOMOGENEOUS}
    return {
        "munich": (Scene("munich", **size), every),
        "north_pole": (Scene("north_pole", **size), HOMOGENEOUS),
        "equator": (Scene("equator", **size), HOMOGENEOUS),
        "munich, north": (Scene("munich", "north", **size), {"published": PUBLISHED}),
        "equator, north": (Scene("equator", "north", **size), {"published": PUBLISHED}),
        "same line": (Scene("street", **size), PERTURBED),
        "same line, skips": (Scene("street", skips=True, **size), PERTURBED),
        "other lines": (Scene("street", back="other", **size), PERTURBED),
        "other lines, skips": (Scene("street", back="other", skips=True, **size), PERTURBED),
    }


def everything(seeds: range, **size: Any) -> dict[Key, Found]:
    """All variants of all scenes, with both spreads."""
    found = {}
    for name, (scene, variants) in scenes(**size).items():
        ready = Ready(scene, seeds)
        for variant, how in variants.items():
            for spread, sigma in SPREADS.items():
                found[name, variant, spread] = _found(ready, how, **{"initial.gyroscope_bias": float(sigma)})
    return found


def _found(ready: Ready, how: Variant, **changes: Any) -> Found:
    ran = ready.run(how, **changes)
    axes = (measured(ran, axis=0), measured(ran, axis=1), measured(ran))
    return Found(ran, axes, yaw_error(ran, ready.attitude))


def of_the_start(seeds: range, **size: Any) -> dict[Key, Found]:
    """The published filter and the state in Munich, by what they make of the first seconds."""
    found = {}
    ready = Ready(Scene("munich", **size), seeds)
    for how, changes in START.items():
        for name, variant in (("published", PUBLISHED), ("state", PLAIN)):
            for spread, sigma in SPREADS.items():
                more = {**changes, "initial.gyroscope_bias": float(sigma)}
                found[how, name, spread] = _found(ready, variant, **more)
    return found
