"""A TOML config: a system, its parameters, recordings, and what to do with them. Unknown keys are errors."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from pedjax import parameters
from pedjax.errors import InputError, suggest
from pedjax.recording import Clock
from pedjax.sources import is_demo
from pedjax.sweeping import DESIGNS
from pedjax.system import System
from pedjax.systems import system as find_system
from pedjax.tuning import ADAPTIVE_NAMES, TuneSettings


@dataclass(frozen=True)
class SweepSettings:
    """`ranges`: dotted path to `[low, high]` (empty: the bounds); `count` parameter sets; `design` grid,
    random or sobol; all on each parameter's own scale."""

    ranges: Mapping[str, Sequence[float]] = field(default_factory=dict)
    count: int = 64
    design: str = "sobol"
    loss: str = "armse"


@dataclass(frozen=True)
class Config:
    """Everything a command needs. `held_back` lists recordings; or `split` is the part to tune on."""

    system: str = "iez"
    recordings: tuple[str, ...] = ()
    held_back: tuple[str, ...] = ()
    split: float | None = None
    sensor: str = "foot"
    clock: Clock | None = None
    alignment: str = "auto"
    seed: int = 0
    out: str = "out"
    figures: bool = True
    parameters: Mapping[str, Any] = field(default_factory=dict)
    tune: Mapping[str, Any] = field(default_factory=dict)
    sweep: Mapping[str, Any] = field(default_factory=dict)
    tuned_on: tuple[str, ...] = ()
    origin: str = "defaults"


_KINDS: dict[str, tuple[type, ...]] = {
    "system": (str,),
    "recordings": (list,),
    "held_back": (list,),
    "split": (float, int),
    "sensor": (str,),
    "clock": (str,),
    "alignment": (str,),
    "seed": (int,),
    "out": (str,),
    "figures": (bool,),
    "parameters": (dict,),
    "tune": (dict,),
    "sweep": (dict,),
    "tuned_on": (list,),
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
        raw["tuned_on"] = (*merged.get("tuned_on", ()), *raw.get("tuned_on", ()))
        merged |= raw
    config = Config(**merged, origin=", ".join(map(str, paths)) or "defaults")
    check(config)
    return config


def _read(path: Path) -> dict[str, Any]:
    """The keys of one file, each known and of its kind."""
    try:
        with path.open("rb") as file:
            raw = tomllib.load(file)
    except FileNotFoundError:
        known = suggest(str(path), presets())
        raise InputError(f"{path}: there is no such config file{known}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is not valid TOML: {error}") from None
    for key, value in raw.items():
        if key not in _KINDS:
            raise InputError(f"{path}: key '{key}' is unknown{suggest(key, _KINDS)}")
        if not isinstance(value, _KINDS[key]) or (isinstance(value, bool) and key != "figures"):
            kinds = " or ".join(kind.__name__ for kind in _KINDS[key])
            raise InputError(f"{path}: {key} = {value!r} must be a {kinds}")
    for key in ("recordings", "held_back"):
        if key in raw:
            raw[key] = tuple(_beside(path.parent, str(name)) for name in raw[key])
    return raw


def presets() -> dict[str, Path]:
    """Configs that come with the package, by name: `iez`, `iez_adaptive`."""
    package = Path(__file__).parent
    homes = (package / "configs", package.parent / "configs")  # installed, or a checkout
    return {path.stem: path for home in homes for path in sorted(home.glob("*.toml"))}


def _beside(home: Path, name: str) -> str:
    return name if is_demo(name) or Path(name).is_absolute() else str(home / name)


def check(config: Config) -> None:
    """Everything that can be wrong with a config, before any data is read."""
    resolve(config)
    tune_settings(config)
    sweep_settings(config)
    if config.seed < 0:
        raise InputError(f"{config.origin}: seed = {config.seed} must not be negative")
    if config.split is not None and not 0 < config.split < 1:
        raise InputError(f"{config.origin}: split = {config.split} must lie between 0 and 1")


def resolve(config: Config) -> tuple[System, Any]:
    """The system and its parameter tree with the config's values in it."""
    chosen = find_system(config.system)
    flat = parameters.flatten(config.parameters)
    return chosen, parameters.replace(chosen.defaults(), flat, f"{config.origin}: parameters")


def override(config: Config, assignments: Sequence[str]) -> Config:
    """Apply `path=value` options: to `tune.` and `sweep.` settings, and to parameters otherwise."""
    for text in assignments:
        path, equals, value = text.partition("=")
        if not equals or not path.strip():
            raise InputError(f"--set {text}: write path=value, as in --set stance.shoe.threshold=5e7")
        parsed = _parse(value.strip())
        head, _, rest = path.strip().partition(".")
        if head in ("tune", "sweep") and rest:
            section = {**getattr(config, head), rest: parsed}
            config = replace(config, tune=section) if head == "tune" else replace(config, sweep=section)
        else:
            flat = {**parameters.flatten(config.parameters), path.strip(): parsed}
            config = replace(config, parameters=flat)
    config = replace(config, origin="--set" if assignments else config.origin)
    check(config)
    return config


def _parse(text: str) -> Any:
    try:
        return tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        return text


def _settings(cls: type, given: Mapping[str, Any], origin: str, section: str) -> Any:
    known = {f.name: f for f in fields(cls)}
    for key in given:
        if key not in known:
            raise InputError(f"{origin}: key '{section}.{key}' is unknown{suggest(key, known)}")
    clean: dict[str, Any] = {}
    for key, value in given.items():
        default = known[key].default
        if isinstance(default, bool) != isinstance(value, bool) and not callable(default):
            raise InputError(f"{origin}: {section}.{key} = {value!r} must be of the kind of {default!r}")
        if isinstance(default, float) and isinstance(value, int):
            value = float(value)
        if isinstance(default, int | float | str) and not isinstance(value, type(default)):
            raise InputError(f"{origin}: {section}.{key} = {value!r} must be of the kind of {default!r}")
        clean[key] = tuple(value) if isinstance(value, list) else value
    return cls(**clean)


DEFAULT_NAMES = (
    "stance.shoe.threshold",
    "updates.zero_velocity",
    "process.accelerometer",
    "process.gyroscope",
    "initial.accelerometer_bias",
    "initial.gyroscope_bias",
    "initial.attitude",
)
"""What `tune` tunes unless told otherwise, beside the coefficients of an adaptive gate."""


def tune_settings(config: Config) -> TuneSettings:
    """The config's tuning settings, with names by default those of the system's gate and noises."""
    _, params = resolve(config)
    given = dict(config.tune)
    if "names" not in given:
        detector = params.stance.detector
        names = [n.replace(".shoe.", f".{detector}.") for n in DEFAULT_NAMES]
        if detector == "eps":
            names[0:1] = ["stance.eps.energy", "stance.eps.rate_energy"]
        given["names"] = [*names, *(ADAPTIVE_NAMES if params.gate.kind == "adaptive" else ())]
    given.setdefault("seed", config.seed)
    if config.alignment != "auto":
        given.setdefault("alignment", config.alignment)
    return _settings(TuneSettings, given, config.origin, "tune")


def sweep_settings(config: Config) -> SweepSettings:
    """The config's sweep settings; without ranges, a sensible pair is swept."""
    _, params = resolve(config)
    given = dict(config.sweep)
    if not isinstance(given.get("ranges", {}), Mapping):
        raise InputError(f"{config.origin}: sweep.ranges must be a table of path = [low, high]")
    if not given.get("ranges"):
        detector = params.stance.detector
        first = "stance.eps.energy" if detector == "eps" else f"stance.{detector}.threshold"
        centre = float(parameters.get(params, first))
        spec = parameters.specs(params)[first]
        ends = [max(centre / 30, spec.low), min(centre * 10, spec.high)]
        given["ranges"] = {first: ends, "updates.zero_velocity": [0.003, 0.1]}
    settings = _settings(SweepSettings, given, config.origin, "sweep")
    specs = parameters.specs(params)
    for path, ends in settings.ranges.items():
        if path not in specs:
            parameters.get(params, path)
            raise InputError(f"{config.origin}: sweep.ranges: '{path}' is a setting; sweep numbers only")
        if not isinstance(ends, Sequence) or len(ends) not in (0, 2):
            raise InputError(f"{config.origin}: sweep.ranges.{path} must be [low, high]")
        for end in ends:
            parameters.replace(params, {path: end}, f"{config.origin}: sweep.ranges")
    if settings.design not in DESIGNS:
        known = suggest(settings.design, DESIGNS)
        raise InputError(f"{config.origin}: sweep.design = '{settings.design}' is unknown{known}")
    return settings


def resolved(config: Config, params: Any, **extra: Any) -> dict[str, Any]:
    """The config with every parameter spelled out, as it is written to `config.toml`."""
    whole: dict[str, Any] = {"system": config.system}
    for key in ("recordings", "held_back", "tuned_on"):
        names = getattr(config, key)
        if names:  # files by their whole path: the config may be loaded from anywhere
            here = key == "tuned_on"
            whole[key] = [n if here or is_demo(n) else str(Path(n).resolve()) for n in names]
    for key in ("split", "clock"):
        if getattr(config, key) is not None:
            whole[key] = getattr(config, key)
    whole |= {"sensor": config.sensor, "alignment": config.alignment, "seed": config.seed}
    whole |= {k: v for k, v in extra.items() if v}
    whole["parameters"] = parameters.to_nested(params)
    return whole
