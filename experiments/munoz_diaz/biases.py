"""Munoz Diaz 2017, section 3.1: the biases of the gyroscope from gravity and from fields, Figures 8 to 11.

The published filter beside two that know what it leaves out: `moving average`, that two differences of
readings share the noise of the one between; and `state`, where the field is estimated, with or without a
deviation from it that comes and goes. Settings were chosen on seeds 0 to 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.munoz_diaz import biases_told as told
from experiments.munoz_diaz.emulated import Back, Place
from experiments.munoz_diaz.lanes import Told
from experiments.munoz_diaz.scenes import SPREADS, Measured, Ready, Scene, Variant, measured, yaw_error
from experiments.table import Row
from pedjax.runtime import double_precision

PLACES: tuple[Place, ...] = ("north_pole", "equator", "munich")
GRAVITY = Variant("munoz_diaz", {"reference.form": "none"})
PUBLISHED = Variant("munoz_diaz")
DETECTED = PUBLISHED.with_(**{"reference.detector": "steady"})
TWIN = Variant("munoz_diaz_twin", {"reference.form": "differential"})
"""The same without angles, of which the forms that the paper lacks have no need: five times faster."""
STEADY = {"reference.detector": "steady"}
AVERAGED = TWIN.with_(**{"reference.noise": "moving_average"})
ANCHORED = TWIN.with_(**{"reference.form": "anchored"}, **STEADY)
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
    "moving average, detector": AVERAGED.with_(**STEADY),
    "anchored, detector": ANCHORED,
    "state, deviation": DEVIATING,
    "state, deviation, detector": DEVIATING.with_(**STEADY),
    "state, street's deviation": OF_STREET,
    "state, street's deviation, detector": OF_STREET.with_(**STEADY),
    "state, twice that": OF_STREET.with_(**{"reference.state.deviation": 0.56}),
}
SKIPPING = ("published, detector", "anchored, detector", "state, street's deviation")
BACKS: dict[str, Back] = {"same line": "same", "other lines": "other"}
START: dict[str, dict[str, float]] = {
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
        found, start = everything(seeds)
    told.write(found, out)
    told.write_start(start, out)
    return [*told.rows(found), *told.start_rows(start)]


def everything(seeds: range, **size: Any) -> tuple[dict[Key, Found], dict[Key, Found]]:
    """All variants of all scenes, and the first seconds in Munich."""
    found: dict[Key, Found] = {}

    def of(scene: str, ready: Ready, variants: Mapping[str, Variant], skips: bool = False) -> None:
        for variant, how in variants.items():
            for spread in ("0.57",) if skips else SPREADS:
                found[scene, variant, spread] = _found(ready, how, spread, skips)

    for place in PLACES:
        ready = Ready(Scene(place, **size), seeds)
        of(place, ready, HOMOGENEOUS)
        if place == "munich":
            of(place, ready, {"gravity": GRAVITY})
            start = of_the_start(ready)
    of("munich, north", Ready(Scene("munich", "north", **size), seeds), {"published": PUBLISHED})
    for scene, back in BACKS.items():
        ready = Ready(Scene("street", back=back, **size), seeds)
        of(scene, ready, PERTURBED)
        of(f"{scene}, skips", ready, {name: PERTURBED[name] for name in SKIPPING}, skips=True)
    return found, start


def _found(ready: Ready, how: Variant, spread: str, skips: bool = False) -> Found:
    how = how.with_(**{"initial.gyroscope_bias": float(SPREADS[spread])})
    ran = ready.run(how, skips=skips)
    axes = (measured(ran, axis=0), measured(ran, axis=1), measured(ran))
    return Found(ran, axes, yaw_error(ran, ready.attitude))


def of_the_start(ready: Ready) -> dict[Key, Found]:
    """The differential form and the state by what they make of the first seconds."""
    found = {}
    for how, changes in START.items():
        for name, variant in (("differential", TWIN), ("state", PLAIN)):
            for spread in SPREADS:
                found[how, name, spread] = _found(ready, variant.with_(**changes), spread)
    return found
