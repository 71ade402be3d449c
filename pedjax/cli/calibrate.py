"""The command `calibrate`: hard and soft iron of a magnetometer, from a turned sensor or a walked loop."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from pedjax.calibration import ellipsoid, planar
from pedjax.cli.common import say
from pedjax.errors import InputError
from pedjax.output import folder, write_figure

CLOUDS, LOOPS = tuple(ellipsoid.FITS), tuple(planar.METHODS)


def add_parser(commands: Any, recordings: argparse.ArgumentParser) -> None:
    """Add `calibrate` to the commands; `recordings` is the parser that commands with recordings share."""
    parser = commands.add_parser(
        "calibrate", parents=[recordings],
        help="calibrate a magnetometer: turned through space, or walked round a loop",
    )  # fmt: skip
    parser.add_argument(
        "--method", choices=("auto", *CLOUDS, *LOOPS), default="auto",
        help=f"an ellipsoid ({', '.join(CLOUDS)}), or a loop ({', '.join(LOOPS)}); default: auto",
    )  # fmt: skip
    parser.add_argument(
        "--field", type=float, metavar="UT",
        help="strength of the field there, µT; of its horizontal part for a loop (default: keeps volumes)",
    )  # fmt: skip
    parser.add_argument(
        "--between", type=float, nargs=2, metavar=("START", "END"),
        help="use this stretch, s on the recording's clock (default: all of it)",
    )  # fmt: skip
    parser.add_argument(
        "--factor", choices=("symmetric", "upper"),
        help="form of the matrix of an ellipsoid (default: symmetric)",
    )  # fmt: skip
    parser.add_argument("--no-refine", action="store_true", help="leave the algebraic fit as it is")
    parser.add_argument("--no-align", action="store_true", help="do not turn it to the accelerometer")
    parser.add_argument(
        "--base", metavar="TOML", help="a calibration from turning, applied before a loop is fitted and kept"
    )


def calibrate(args: argparse.Namespace) -> int:
    """Fit, file and picture."""
    from pedjax.calibration import clouds, files, fitting  # here: the parser above is needed at every start
    from pedjax.plots.calibration import cloud_figure, loop_figure
    from pedjax.recording import inertial
    from pedjax.sources import read_any

    if len(args.recordings) != 1:
        raise InputError(f"calibrate takes one recording, {len(args.recordings)} were named; run it for each")
    if args.field is not None and not args.field > 0:
        raise InputError(f"--field {args.field:g} must be a positive strength in µT")
    path, loop, sensor = args.recordings[0], None, args.sensor or ""
    base = None
    if args.format is None and clouds.is_cloud(path):
        cloud = clouds.read(path)
        if args.method in LOOPS:
            raise InputError(f"{path}: it holds no walk for --method {args.method}; use {', '.join(CLOUDS)}")
        if args.between:
            cloud = cloud.between(*args.between)
    else:
        base = files.read(args.base) if args.base else None
        recording = read_any(path, args.format)
        only = next(iter(recording.sensors)) if len(recording.sensors) == 1 else "foot"
        sensor = args.sensor or only
        cloud = clouds.of_recording(recording, sensor)
        imu = inertial(recording, sensor)
        if args.between:
            cloud = cloud.between(*args.between)
            first, last = np.searchsorted(imu.time, args.between)
            imu = imu.crop(int(first), int(last))
        if args.method in (*LOOPS, "auto") and len(imu.time) > imu.rate:
            loop = fitting.walk_loop(imu, base)
    method, reason = args.method, "as asked"
    if method == "auto":
        method, reason = fitting.choose(cloud, loop)
    if args.base and method in CLOUDS:
        raise InputError(
            f"--base is for loops, and the method is {method}; leave it out, or use --method lsq"
        )
    given = {"--factor": args.factor, "--no-refine": args.no_refine, "--no-align": args.no_align}
    alien = [name for name, value in given.items() if value]
    if alien and method in LOOPS:
        raise InputError(
            f"{alien[0]} is for ellipsoids, and the method is {method}; leave it out, or use --method clsef"
        )
    title = f"{cloud.name}: {method}"
    if method in CLOUDS:
        fit = fitting.fit_cloud(
            cloud,
            method,
            args.field,
            args.factor or "symmetric",
            not args.no_refine,
            not args.no_align,
            reason,
        )
        matrix, away = fit.calibration.matrix, cloud.field - fit.calibration.hard_iron
        figure = None if args.no_figures else cloud_figure(cloud.field, away @ matrix.T, fit.strength, title)
    else:
        if loop is None:
            raise InputError(f"{path}: too short for a walked loop; record longer, or use --method algebraic")
        fit = fitting.fit_loop(cloud.name, loop, method, args.field, base, reason)
        before, after = fit.extra["points"], fit.extra["corrected"]
        figure = None if args.no_figures else loop_figure(before, after, loop.turn, fit.strength, title)
    say(f"{cloud.name}: {fit.method} ({fit.reason})", *_lines(fit))
    target = _target(args.out)
    files.write(target, fit, Path(path).name, sensor, cloud.recorded)
    if figure is not None:
        write_figure(target.with_suffix(".png"), figure)
    say(f"calibration in {target}")
    return 0


def _target(out: str | None) -> Path:
    """The file to write: `--out` itself where it ends in .toml, otherwise in that folder."""
    path = Path(out or "out")
    if path.suffix == ".toml":
        return folder(path.parent) / path.name
    return folder(path) / "calibration.toml"


def _lines(fit: Any) -> list[str]:
    """What was found, in words."""
    told, c = fit.diagnostics, fit.calibration
    if "stances" in told:
        lines = [
            f"  level offset {_vector(c.level_offset)} µT, "
            f"tau {told['tau']:.3f} at {told['eta_rad']:.3f} rad",
            f"  circle of {fit.strength:.2f} µT, residual {told['residual_ut']:.2f} µT over "
            f"{told['stances']} stances, largest gap {told['azimuth_gap_deg']:.0f} deg",
        ]
    else:
        lines = [
            f"  hard iron {_vector(c.hard_iron)} µT, half axes {_vector(told['half_axes_ut'])} µT",
            f"  field {fit.strength:.2f} µT, residual {told['residual_ut']:.2f} µT over {told['samples']} "
            f"samples, coverage {told['coverage']:.2f} of 0.33",
        ]
        if told.get("aligned"):
            lines.append(
                f"  turned by {told['alignment_deg']:.2f} deg to the accelerometer, inclination "
                f"{told['inclination_deg']:.1f} deg"
            )
    return lines + [f"  look at: {line}" for line in fit.warnings]


def _vector(values: Any) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in np.asarray(values)) + ")"
