"""A scenario: a walk, a world and its sensors, from a few lines of TOML."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pedjax.errors import InputError, suggest
from pedjax.simulation.fields import Stretch
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.motion import MOUNTINGS
from pedjax.simulation.presets import PRESETS
from pedjax.tables import filled, loaded

FIELDS: dict[str, tuple[str, ...]] = {
    "none": (),
    "north_pole": (),
    "equator": (),
    "munich": (),
    "earth": ("latitude", "longitude", "height", "date"),
    "building": ("style", "strength"),
    "street": ("tiles", "first", "mode"),
    "floor_magnet": ("place", "depth", "moment"),
    "magnetised_walls": ("stretches", "height", "side"),
    "outdoors": ("bumps", "low", "high", "car", "start"),
}
"""Kinds of magnetic field, and what each takes beside."""


IRON = ("hard", "soft", "platform", "floor")
"""What may disturb a magnetometer."""


@dataclass(frozen=True)
class Scenario:
    """What `simulate` makes a recording of.

    `legs` are walked one after the other, all of them `rounds` times, with `standing_s` s of rest before and
    after; legs without a speed of their own at one between the two `speeds` in m/s, in the gait that goes
    with it, where those are given; `sensors` maps where a sensor is (foot, left_foot, waist, pocket) to the
    name of its preset; `field` has a `kind` and what that takes; `iron` the `hard` (3) and `soft` (3 x 3)
    iron of every magnetometer, and what acts while the foot stands only, `platform` in body and `floor` in
    navigation axes;
    `landmarks` are places (x, y) in m that are surveyed where the walker passes them;
    `calibrated` the part of each constant error (biases, scale) that a calibration has taken away;
    `survey_m` the spacing of a magnetic survey over the whole site (0: none).
    """

    name: str
    title: str = ""
    rate_hz: float = 100.0
    standing_s: float = 3.0
    rounds: int = 1
    speeds: tuple[float, ...] = ()
    legs: tuple[Leg, ...] = ()
    sensors: Mapping[str, str] = dataclasses.field(default_factory=lambda: {"foot": "xsens_mtw"})
    field: Mapping[str, Any] = dataclasses.field(default_factory=lambda: {"kind": "munich"})
    iron: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    landmarks: tuple[tuple[float, float], ...] = ()
    calibrated: float = 0.95
    survey_m: float = 0.0

    def __post_init__(self) -> None:
        _check(self)

    @property
    def mode(self) -> str:
        """How the cylinders of its field act together: `superpose` or `nearest`."""
        return str(self.field.get("mode", "superpose"))


def scenarios() -> dict[str, Path]:
    """Scenarios that come with the package, by name."""
    package = Path(__file__).parents[1]
    homes = (package / "configs" / "scenarios", package.parent / "configs" / "scenarios")
    return {path.stem: path for home in homes for path in sorted(home.glob("*.toml"))}


def load_scenario(name: str | Path) -> Scenario:
    """One that comes with the package, by name, or a TOML file."""
    known = scenarios()
    path = known.get(str(name), Path(name))
    raw = loaded(path, f"there is no scenario '{name}'{suggest(str(name), known)}")
    legs = raw.pop("legs", [])
    if not isinstance(legs, list) or not all(isinstance(leg, dict) for leg in legs):
        raise InputError(f"{path}: legs must be tables, [[legs]]")
    made = tuple(filled(Leg, leg, f"{path}: leg {n}") for n, leg in enumerate(legs, 1))
    return filled(Scenario, {"name": path.stem, **raw, "legs": made}, str(path))


def stretches_of(field: Mapping[str, Any], where: str) -> tuple[Stretch, ...]:
    """The stretches of a field of magnetised walls."""
    given = field.get("stretches", ())
    if not isinstance(given, list | tuple) or not given or not all(isinstance(x, Mapping) for x in given):
        one = "{ start = [0, 10], end = [0, 20], turn = 15 }"
        raise InputError(f"{where}: field 'magnetised_walls' needs stretches = [{one}], one or more")
    return tuple(filled(Stretch, x, f"{where}: stretch {n}") for n, x in enumerate(given, 1))


def _check_walls(field: Mapping[str, Any], where: str) -> None:
    stretches_of(field, where)
    for key in ("height", "side"):
        if type(field.get(key, 1.0)) not in (int, float):
            raise InputError(f"{where}: field.{key} = {field[key]!r} must be a number, in m")


def _check_outdoors(field: Mapping[str, Any], where: str) -> None:
    for key, value in field.items():
        if key != "kind" and (type(value) not in (int, float) or not 0 <= value <= 1e3):
            raise InputError(f"{where}: field.{key} = {value!r} must be a number from 0 to 1000")
    if field.get("bumps", 0) != int(field.get("bumps", 0)):
        raise InputError(f"{where}: field.bumps = {field['bumps']!r} must be a whole number")
    if field.get("low", 6.0) > field.get("high", 18.0):
        raise InputError(f"{where}: field.low must not be larger than field.high")


def _check(scenario: Scenario) -> None:
    where = f"scenario '{scenario.name}'"
    if not 10 <= scenario.rate_hz <= 2000:
        raise InputError(f"{where}: rate_hz = {scenario.rate_hz:g} must lie between 10 and 2000")
    if not 0 <= scenario.standing_s <= 3600:
        raise InputError(f"{where}: standing_s = {scenario.standing_s:g} must lie between 0 and 3600")
    if not 0 <= scenario.calibrated <= 1:
        raise InputError(f"{where}: calibrated = {scenario.calibrated:g} must lie between 0 and 1")
    if scenario.rounds < 1 or scenario.rounds != int(scenario.rounds):
        raise InputError(f"{where}: rounds = {scenario.rounds!r} must be a whole number from 1 on")
    two = len(scenario.speeds) == 2
    if scenario.speeds and not (two and 0.1 <= scenario.speeds[0] <= scenario.speeds[1] <= 6):
        raise InputError(f"{where}: speeds = {list(scenario.speeds)} must be two, rising, from 0.1 to 6 m/s")
    if not scenario.legs:
        raise InputError(f"{where}: has no legs; give at least one [[legs]]")
    if not scenario.sensors:
        raise InputError(f"{where}: has no sensor; give sensors = {{ foot = 'xsens_mtw' }}")
    for place, preset in scenario.sensors.items():
        if place not in MOUNTINGS:
            raise InputError(f"{where}: no sensor can be carried at '{place}'{suggest(place, MOUNTINGS)}")
        if preset not in PRESETS:
            raise InputError(f"{where}: sensor '{preset}' is unknown{suggest(str(preset), PRESETS)}")
    kind = scenario.field.get("kind")
    if kind not in FIELDS:
        raise InputError(f"{where}: field kind {kind!r} is unknown{suggest(str(kind), FIELDS)}")
    for key in scenario.field:
        if key != "kind" and key not in FIELDS[kind]:
            raise InputError(f"{where}: field '{kind}' takes no '{key}'{suggest(key, FIELDS[kind])}")
    if kind == "outdoors":
        _check_outdoors(scenario.field, where)
    if kind == "magnetised_walls":
        _check_walls(scenario.field, where)
    for key, value in scenario.iron.items():
        shape = {"hard": (3,), "soft": (3, 3), "platform": (3,), "floor": (3,)}.get(key)
        if shape is None:
            raise InputError(f"{where}: iron.{key} is unknown{suggest(key, IRON)}")
        if np.shape(value) != shape:
            raise InputError(f"{where}: iron.{key} must have the shape {shape}")
    if any(len(mark) != 2 for mark in scenario.landmarks):
        raise InputError(f"{where}: landmarks must be [x, y] in m")
