"""A TOML config: a system, its parameters, recordings, and what to do with them. Unknown keys are errors."""

from __future__ import annotations

import importlib.util
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pedjax import parameters
from pedjax.errors import InputError, suggest
from pedjax.evaluation.scores import score_kind
from pedjax.recording import Clock
from pedjax.sources import is_made
from pedjax.sweeping.designs import (
    DESIGNS,
    Axis,
    Design,
    axes_around,
    axes_of,
    lay_out,
    listed_sets,
    with_settings,
)
from pedjax.system import System
from pedjax.systems import assembled
from pedjax.systems import system as find_system
from pedjax.tables import filled, loaded
from pedjax.tuning import Augment, TuneSettings
from pedjax.walks import sensor_names


@dataclass(frozen=True)
class SweepSettings:
    """What a sweep varies.

    `ranges`: dotted path to `[low, high]`, `[low, high, steps]` or a table with `scale` (empty: the bounds);
    `values`: path to the only values it takes; `settings`: path of a setting to its choices, all sets for
    each combination of them; `file`: a csv or Parquet table of whole sets instead; `count` sets in a round of
    the `design` (sobol, latin, grid, random); `refine` further rounds, each on ranges `shrink` times as long
    around the best set so far; `loss` decides what is best.
    """

    ranges: Mapping[str, Any] = field(default_factory=dict)
    values: Mapping[str, Sequence[float]] = field(default_factory=dict)
    settings: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    file: str = ""
    count: int = 1024
    design: str = "sobol"
    refine: int = 0
    shrink: float = 0.3
    loss: str = "armse"


@dataclass(frozen=True)
class Config:
    """Everything a command needs. `held_back` lists recordings; or `split` is the part to tune on.

    `system` is the name of one, or a table with `name`, `filter` and `aids`, from which it is made;
    `sensor` the name of the one that plays its first role, or a table of names by role; `map` a file of
    what the system is to know of the place; `plugins` Python files that register systems, detectors or
    losses of your own.
    """

    system: str | Mapping[str, Any] = "iez"
    recordings: tuple[str, ...] = ()
    held_back: tuple[str, ...] = ()
    split: float | None = None
    sensor: str | Mapping[str, str] | None = None
    clock: Clock | None = None
    alignment: str = "auto"
    seed: int = 0
    out: str = "out"
    figures: bool = True
    parameters: Mapping[str, Any] = field(default_factory=dict)
    tune: Mapping[str, Any] = field(default_factory=dict)
    sweep: Mapping[str, Any] = field(default_factory=dict)
    tuned_on: tuple[str, ...] = ()
    map: str = ""
    plugins: tuple[str, ...] = ()
    origin: str = "defaults"


_KINDS: dict[str, tuple[type, ...]] = {
    "system": (str, dict),
    "recordings": (list,),
    "held_back": (list,),
    "split": (float, int),
    "sensor": (str, dict),
    "clock": (str,),
    "alignment": (str,),
    "seed": (int,),
    "out": (str,),
    "figures": (bool,),
    "parameters": (dict,),
    "tune": (dict,),
    "sweep": (dict,),
    "tuned_on": (list,),
    "map": (str,),
    "plugins": (list,),
}


def load(*paths: str | Path) -> Config:
    """Read and check configs, files or those that come with the package (`presets`): a later one overrides
    an earlier one key by key, parameters one by one. Recordings are relative to their config's folder."""
    merged: dict[str, Any] = {}
    for path in paths:
        raw = _read(presets().get(str(path), Path(path)))
        for key in ("tune", "sweep", "parameters"):
            if key in raw:
                flatten = parameters.flatten if key == "parameters" else dict
                raw[key] = {**merged.get(key, {}), **flatten(raw[key])}
        tables = [section.get("tune", {}).get("augment") for section in (merged, raw)]
        if all(isinstance(table, dict) for table in tables):
            raw["tune"]["augment"] = tables[0] | tables[1]
        for key in ("tuned_on", "plugins"):
            raw[key] = tuple(dict.fromkeys([*merged.get(key, ()), *raw.get(key, ())]))
        merged |= raw
    config = Config(**merged, origin=", ".join(map(str, paths)) or "defaults")
    for plugin in config.plugins:
        load_plugin(plugin)
    check(config)
    return config


_LOADED: set[Path] = set()


def load_plugin(path: str | Path) -> None:
    """Run a Python file that registers something of your own; once, however often it is named."""
    place = Path(path).resolve()
    if place in _LOADED:
        return
    spec = importlib.util.spec_from_file_location(f"pedjax_plugin_{place.stem}", place)
    if spec is None or spec.loader is None or not place.exists():
        raise InputError(f"{path}: there is no such Python file to load")
    module = importlib.util.module_from_spec(spec)
    try:
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: cannot be loaded: {type(error).__name__}: {error}") from error
    _LOADED.add(place)


def _read(path: Path) -> dict[str, Any]:
    """The keys of one file, each known and of its kind."""
    raw = loaded(path, f"{path}: there is no such config file{suggest(str(path), presets())}")
    for key, value in raw.items():
        if key not in _KINDS:
            raise InputError(f"{path}: key '{key}' is unknown{suggest(key, _KINDS)}")
        if not isinstance(value, _KINDS[key]) or (isinstance(value, bool) and key != "figures"):
            kinds = " or ".join(kind.__name__ for kind in _KINDS[key])
            raise InputError(f"{path}: {key} = {value!r} must be a {kinds}")
    for key in ("recordings", "held_back", "plugins"):
        if key in raw:
            raw[key] = tuple(_beside(path.parent, str(name)) for name in raw[key])
    if raw.get("map"):
        raw["map"] = _beside(path.parent, raw["map"])
    if raw.get("sweep", {}).get("file"):
        raw["sweep"] = {**raw["sweep"], "file": _beside(path.parent, str(raw["sweep"]["file"]))}
    return raw


def presets() -> dict[str, Path]:
    """Configs that come with the package, by name: `iez`, `iez_adaptive`."""
    package = Path(__file__).parent
    homes = (package / "configs", package.parent / "configs")  # installed, or a checkout
    return {path.stem: path for home in homes for path in sorted(home.glob("*.toml"))}


def _beside(home: Path, name: str) -> str:
    return name if is_made(name) or Path(name).is_absolute() else str(home / name)


def check(config: Config) -> None:
    """Everything that can be wrong with a config, before any data is read."""
    resolve(config)
    tune_settings(config)
    sweep_axes(config)
    if config.seed < 0:
        raise InputError(f"{config.origin}: seed = {config.seed} must not be negative")
    if config.split is not None and not 0 < config.split < 1:
        raise InputError(f"{config.origin}: split = {config.split} must lie between 0 and 1")


def resolve(config: Config) -> tuple[System, Any]:
    """The system and its parameter tree with the config's values in it."""
    chosen = _system(config)
    if config.sensor is not None:
        sensor_names(chosen.needs, config.sensor)
    if config.map and chosen.read_site is None:
        raise InputError(f"--map {config.map}: the system '{chosen.name}' uses no map; leave it out")
    flat = parameters.flatten(config.parameters)
    return chosen, parameters.replace(chosen.defaults(), flat, f"{config.origin}: parameters")


def _system(config: Config) -> System:
    if isinstance(config.system, str):
        return find_system(config.system)
    table = dict(config.system)
    for key in table:
        if key not in ("name", "filter", "aids"):
            known = suggest(key, ("name", "filter", "aids"))
            raise InputError(f"{config.origin}: key 'system.{key}' is unknown{known}")
    if not isinstance(table.get("name"), str) or not isinstance(table.get("aids"), list):
        raise InputError(f"{config.origin}: system needs a name and a list of aids, or is itself a name")
    return assembled(table["name"], table.get("filter", "inertial"), table["aids"])


def site_of(config: Config) -> Any:
    """What the system is to know of the place, read from the config's map; None without one."""
    chosen = _system(config)
    if not config.map or chosen.read_site is None:
        return None
    return chosen.read_site(Path(config.map))


def override(config: Config, assignments: Sequence[str]) -> Config:
    """Apply `path=value` options: to `tune.` and `sweep.` settings, and to parameters otherwise."""
    for text in assignments:
        path, equals, value = text.partition("=")
        if not equals or not path.strip():
            raise InputError(f"--set {text}: write path=value, as in --set stance.shoe.threshold=5e7")
        parsed = _parse(value.strip())
        head, _, rest = path.strip().partition(".")
        if head in ("tune", "sweep") and rest:
            section = _with(getattr(config, head), rest, parsed)
            config = replace(config, tune=section) if head == "tune" else replace(config, sweep=section)
        else:
            flat = {**parameters.flatten(config.parameters), path.strip(): parsed}
            config = replace(config, parameters=flat)
    config = replace(config, origin="--set" if assignments else config.origin)
    check(config)
    return config


def _with(section: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A section with one key set; `ranges.PATH` and the like set one row of a table in it."""
    table, _, path = key.partition(".")
    if path:
        if not isinstance(section.get(table, {}), Mapping):
            raise InputError(f"--set: '{table}' is no table, so that '{table}.{path}' cannot be set")
        return {**section, table: {**section.get(table, {}), path: value}}
    return {**section, key: value}


def _parse(text: str) -> Any:
    try:
        return tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        return text


def tune_settings(config: Config) -> TuneSettings:
    """The config's tuning settings, with names by default those of the system's gate and noises."""
    _, params = resolve(config)
    given = dict(config.tune)
    given.setdefault("names", list(parameters.tunable(params)))
    given.setdefault("seed", config.seed)
    if config.alignment != "auto":
        given.setdefault("alignment", config.alignment)
    table = given.get("augment", {})
    if not isinstance(table, Mapping):
        raise InputError(f"{config.origin}: tune.augment must be a table, as in tune.augment.copies = 2")
    table = {"seed": config.seed, **table}
    given["augment"] = filled(Augment, table, config.origin, "tune.augment.")
    return filled(TuneSettings, given, config.origin, "tune.")


def sweep_settings(config: Config) -> SweepSettings:
    """The config's sweep settings, each section of its kind."""
    given = dict(config.sweep)
    for key in ("ranges", "values", "settings"):
        if not isinstance(given.get(key, {}), Mapping):
            raise InputError(f"{config.origin}: sweep.{key} must be a table with a dotted path in each row")
        given[key] = dict(given.get(key, {}))
    settings = filled(SweepSettings, given, config.origin, "sweep.")
    for name, low, high in (("count", 1, 1e8), ("refine", 0, 100), ("shrink", 1e-3, 1.0)):
        value = getattr(settings, name)
        if not low <= value <= high:
            raise InputError(
                f"{config.origin}: sweep.{name} = {value!r} must lie between {low:g} and {high:g}"
            )
    if settings.design not in DESIGNS:
        known = suggest(settings.design, DESIGNS)
        raise InputError(f"{config.origin}: sweep.design = '{settings.design}' is unknown{known}")
    try:
        score_kind(settings.loss)
    except InputError as error:
        raise InputError(f"{config.origin}: sweep.{error}") from None
    if settings.file and (settings.ranges or settings.values or settings.refine):
        raise InputError(
            f"{config.origin}: sweep.file lists whole parameter sets; leave ranges, values and refine out"
        )
    return settings


def sweep_axes(config: Config) -> tuple[SweepSettings, tuple[Axis, ...]]:
    """What is swept, checked. Without ranges, values or a file, the parameters that tuning would vary, from a
    tenth to ten times their values (a quarter of the bounds each way where linear)."""
    settings = sweep_settings(config)
    _, params = resolve(config)
    origin = f"{config.origin}: sweep"
    for path, options in settings.settings.items():
        distinct = {repr(option) for option in options} if isinstance(options, list | tuple) else set()
        if not distinct or len(distinct) < len(options):
            raise InputError(f"{origin}.settings.{path} must list choices, each once")
        if path not in parameters.choices(params):
            parameters.get(params, path)
            raise InputError(f"{origin}.settings: '{path}' is a number; sweep it in sweep.values")
        for option in options:
            parameters.replace(params, {path: option}, f"{origin}.settings")
    ranges = dict(settings.ranges)
    if not ranges and not settings.values:
        ranges = {path: _around(params, path) for path in parameters.tunable(params)}
    return settings, axes_of(params, ranges, settings.values, origin)


def sweep_design(config: Config) -> tuple[SweepSettings, Design]:
    """The first round's parameter sets."""
    settings, axes = sweep_axes(config)
    if settings.file:
        _, params = resolve(config)
        values = listed_sets(Path(settings.file), params)
        axes = axes_around(params, values)
    else:
        values = lay_out(axes, settings.count, settings.design, config.seed)
    return settings, with_settings(axes, values, settings.settings)


def _around(params: Any, path: str) -> list[float]:
    """A decade each way on a log scale, a quarter of the bounds each way on a linear one."""
    spec, centre = parameters.specs(params)[path], float(parameters.get(params, path))
    step = 0.25 * (spec.high - spec.low)
    ends = (centre / 10, centre * 10) if spec.scale == "log" else (centre - step, centre + step)
    return [max(ends[0], spec.low), min(ends[1], spec.high)]


def resolved(config: Config, params: Any, **extra: Any) -> dict[str, Any]:
    """The config with every parameter spelled out, as it is written to `config.toml`."""
    whole: dict[str, Any] = {"system": config.system}
    for key in ("recordings", "held_back", "tuned_on"):
        names = getattr(config, key)
        if names:  # files by their whole path: the config may be loaded from anywhere
            here = key == "tuned_on"
            whole[key] = [n if here or is_made(n) else str(Path(n).resolve()) for n in names]
    for key in ("split", "clock", "sensor"):
        if getattr(config, key) is not None:
            whole[key] = getattr(config, key)
    if config.map:
        whole["map"] = str(Path(config.map).resolve())
    if config.plugins:
        whole["plugins"] = [str(Path(name).resolve()) for name in config.plugins]
    whole |= {"alignment": config.alignment, "seed": config.seed}
    whole |= {k: v for k, v in extra.items() if v}
    whole["parameters"] = parameters.to_nested(params)
    return whole
