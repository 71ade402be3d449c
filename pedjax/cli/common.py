"""What several commands need."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pedjax import __version__, parameters
from pedjax.calibration import files as calibration_files
from pedjax.config import Config, load, override, resolved
from pedjax.errors import InputError
from pedjax.filters.compass import calibrated_by
from pedjax.output import write_json, write_toml
from pedjax.systems import system as find_system


def configured(args: argparse.Namespace) -> Config:
    """Defaults, then configs, then what the command line says."""
    config = load(*args.config)
    for name in ("system", "sensor", "clock", "alignment", "seed", "out"):
        if getattr(args, name, None) is not None:
            config = replace(config, **{name: getattr(args, name)})
    if args.recordings:
        config = replace(config, recordings=tuple(args.recordings))
    if getattr(args, "held_back", None):
        config = replace(config, held_back=tuple(args.held_back))
    if getattr(args, "split", None) is not None:
        config = replace(config, split=args.split)
    if getattr(args, "names", None):
        config = replace(config, tune={**config.tune, "names": list(args.names)})
    if args.no_figures:
        config = replace(config, figures=False)
    if getattr(args, "calibration", None):
        config = _calibrated(config, args.calibration)
    config = override(config, args.set)
    if not config.recordings:
        raise InputError("no recording was given; name files, or demo:0 for a walk made by the package")
    return config


def _calibrated(config: Config, path: str) -> Config:
    """The config with a calibration file's numbers as parameters."""
    calibration = calibration_files.read(path)
    if not find_system(config.system).magnetic:
        raise InputError(
            f"--calibration {path}: the system '{config.system}' does not use a magnetometer; choose another "
            "--system (ma2018)"
        )
    new = {f"compass.{name}": value for name, value in calibrated_by(calibration).items()}
    return replace(config, parameters={**parameters.flatten(config.parameters), **new})


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
