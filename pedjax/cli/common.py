"""What several commands need."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pedjax import __version__, parameters, prior
from pedjax.calibration import files as calibration_files
from pedjax.config import Config, load, load_plugin, override, resolve, resolved
from pedjax.detection import looks_at_field
from pedjax.errors import InputError
from pedjax.filters.compass import calibrated_by
from pedjax.output import write_json, write_toml
from pedjax.sources import spelled_out
from pedjax.systems import SYSTEMS


def configured(args: argparse.Namespace) -> Config:
    """Defaults, then configs, then what the command line says."""
    config = loaded(args)
    for name in ("clock", "alignment", "seed", "out", "map"):
        if getattr(args, name, None) is not None:
            config = replace(config, **{name: getattr(args, name)})
    if args.sensor:
        config = replace(config, sensor=_sensors(args.sensor))
    if args.recordings:
        config = replace(config, recordings=tuple(args.recordings))
    if getattr(args, "held_back", None):
        config = replace(config, held_back=tuple(args.held_back))
    if getattr(args, "split", None) is not None:
        config = replace(config, split=args.split)
    if getattr(args, "names", None):
        config = replace(config, tune={**config.tune, "names": list(args.names)})
    if getattr(args, "augment", None) is not None:
        table = {**config.tune.get("augment", {}), "copies": args.augment}
        config = replace(config, tune={**config.tune, "augment": table})
    if args.no_figures:
        config = replace(config, figures=False)
    if getattr(args, "calibration", None):
        config = _calibrated(config, args.calibration)
    if getattr(args, "prior", None):
        config = _with_prior(config, args.prior)
    config = override(config, args.set)
    if not config.recordings:
        raise InputError("no recording was given; name files, or demo:0 for a walk made by the package")
    recordings, held_back = (tuple(spelled_out(names)) for names in (config.recordings, config.held_back))
    return replace(config, recordings=recordings, held_back=held_back)


def loaded(args: argparse.Namespace) -> Config:
    """The configs that are named, with the plugins and the system that the command line names."""
    for plugin in args.plugins:
        load_plugin(plugin)
    config = load(*args.config)
    config = replace(config, plugins=tuple(dict.fromkeys([*config.plugins, *args.plugins])))
    return config if args.system is None else replace(config, system=args.system)


def _sensors(given: Sequence[str]) -> str | dict[str, str]:
    """`NAME`, or `ROLE=NAME` for each role."""
    if len(given) == 1 and "=" not in given[0]:
        return given[0]
    pairs = [text.partition("=") for text in given]
    for text, (role, equals, name) in zip(given, pairs, strict=True):
        if not (role and equals and name):
            raise InputError(f"--sensor {text}: with several, say which role each plays, as in waist={text}")
    return {role: name for role, _, name in pairs}


def _calibrated(config: Config, path: str) -> Config:
    """The config with a calibration file's numbers as parameters."""
    calibration = calibration_files.read(path)
    chosen, params = resolve(config)
    new = calibrated_by(params, calibration)
    if not new:
        magnetic = [s.name for s in SYSTEMS.values() if s.magnetic]
        raise InputError(
            f"--calibration {path}: the system '{chosen.name}' does not use a magnetometer; choose another "
            f"--system ({', '.join(magnetic)})"
        )
    return replace(config, parameters={**parameters.flatten(config.parameters), **new})


def _with_prior(config: Config, path: str) -> Config:
    """The config with what an earlier walk told of the sensor as parameters."""
    _, params = resolve(config)
    new = prior.changes(params, prior.read(path), f"--prior {path}")
    return replace(config, parameters={**parameters.flatten(config.parameters), **new})


def looking() -> list[str]:
    """The systems that look at the field."""
    return [name for name, each in SYSTEMS.items() if looks_at_field(each.defaults())]


def say(*lines: str) -> None:
    """Lines on standard output, at once."""
    print(*lines, sep="\n", flush=True)


def write_metrics(out: Path, config: Config, entries: list[dict[str, Any]], **extra: Any) -> None:
    """`metrics.json`: what was done, and an entry for each recording."""
    whole = {"pedjax_version": __version__, "system": config.system, "seed": config.seed}
    write_json(out / "metrics.json", {**whole, **extra, "recordings": entries})


def write_parameters(path: Path, config: Config, params: Any, chosen_on: Sequence[str], heading: str) -> None:
    """Parameters as a config that every command takes, with the fingerprints of all they were chosen on."""
    tuned_on = tuple(dict.fromkeys([*config.tuned_on, *chosen_on]))
    alone = replace(config, recordings=(), held_back=(), split=None, tuned_on=tuned_on)
    write_toml(path, resolved(alone, params), heading)
