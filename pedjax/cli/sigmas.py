"""The command `sigmas`: a field detector's sigmas from recordings."""

from __future__ import annotations

import argparse
from typing import Any

from pedjax import __version__, parameters
from pedjax.cli.common import configured, loaded, looking, say, write_metrics, write_parameters
from pedjax.config import resolve
from pedjax.detection import FieldSigmas, field_sigmas, looks_at_field
from pedjax.detection.sigmas import CHANNELS, KEEP
from pedjax.errors import InputError
from pedjax.identity import fingerprint
from pedjax.output import folder, write_figure
from pedjax.sources import read_with_truth
from pedjax.walks import sensor_names


def add_parser(commands: Any, both: list[argparse.ArgumentParser]) -> None:
    """`pedjax sigmas` and its options."""
    parser = commands.add_parser(
        "sigmas",
        parents=both,
        help="how much a quasi-static field changes from look to look: a detector's sigmas",
    )
    parser.add_argument(
        "--detector", metavar="NAME", help=f"one of {', '.join(CHANNELS)} (default: field.detector)"
    )
    parser.add_argument(
        "--keep", type=float, default=KEEP, metavar="P",
        help=f"part of the quasi-static windows to use; more takes in disturbed ones (default: {KEEP})",
    )  # fmt: skip


def sigmas(args: argparse.Namespace) -> int:
    """Sigmas beside their defaults, as a config; a picture of the changes."""
    _, params = resolve(loaded(args))
    if args.system is None and not looks_at_field(params):
        args.system = looking()[0]
    config = configured(args)
    if not 0 < args.keep < 1:
        raise InputError(f"--keep {args.keep:g} must lie between 0 and 1")
    system, params = resolve(config)
    if not looks_at_field(params):
        raise InputError(
            f"the system '{system.name}' does not look at the field; choose another --system "
            f"({', '.join(looking())})"
        )
    out = folder(config.out)
    sensor = next(iter(sensor_names(system.needs, config.sensor).values()))
    walks = (read_with_truth(path, args.format, sensor) for path in config.recordings)
    found = field_sigmas(
        system, params, walks, args.detector, keep=args.keep, sensor=sensor, clock=config.clock
    )
    table = _table(found, params, system.defaults())
    entries = [
        {"path": str(path), "duration_s": r.duration, "windows": windows, "used": used}
        for path, r, windows, used in zip(
            config.recordings, found.recordings, found.windows, found.used, strict=True
        )
    ]
    for entry, recording in zip(entries, found.recordings, strict=True):
        told = f"{entry['path']}: {entry['used']} of {entry['windows']} windows count as quasi-static"
        say(told, *(f"  look at: {finding}" for finding in recording.findings))
    lines = [_line(name, row) for name, row in table.items()]
    say(*lines, *(f"  look at: {line}" for line in found.warnings))
    all_of_it = {"windows": sum(found.windows), "used": sum(found.used)}
    if found.label is not None:
        all_of_it["quasi_static_by_truth"] = int(found.label.sum())
    write_metrics(
        out, config, entries, detector=found.detector, keep=args.keep, **all_of_it, sigmas=table,
        warnings=list(found.warnings),
    )  # fmt: skip
    write_parameters(
        out / "sigmas.toml",
        config,
        found.params,
        [fingerprint(r) for r in found.recordings],
        f"sigmas of {found.detector} by pedjax {__version__} from {all_of_it['used']} of "
        f"{all_of_it['windows']} windows of {len(found.recordings)} recordings",
    )
    if config.figures:
        from pedjax import plots

        before = {name: row["before"] for name, row in table.items()}
        unit = {name: row["unit"] for name, row in table.items()}
        write_figure(out / "sigmas.png", plots.field_changes(found, args.keep, before, unit))
    say(f"results in {out}")
    return 0


def _table(found: FieldSigmas, params: Any, defaults: Any) -> dict[str, dict[str, Any]]:
    """Each sigma as found, as it was set before, by default and where that comes from, and by truth."""
    specs, rows = parameters.specs(params), {}
    for name, value in found.fit.sigma.items():
        path = f"field.{found.detector}.{name}"
        rows[name] = {
            "value": value,
            "unit": specs[path].unit,
            "before": float(parameters.get(params, path)),
            "default": float(parameters.get(defaults, path)),
            "source": specs[path].source,
            "by_truth": found.by_truth.get(name),
        }
    return rows


def _line(name: str, row: dict[str, Any]) -> str:
    text = f"{name:17} {row['value']:.4g} {row['unit']}; default {row['default']:.4g} ({row['source']})"
    if row["before"] != row["default"]:
        text += f", before {row['before']:.4g}"
    return text if row["by_truth"] is None else f"{text}, by truth {row['by_truth']:.4g}"
