"""Arguments in, exit status out: 0, 1 for a bad input (its sentence on standard error), 2 for wrong usage."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence

from pedjax import __version__
from pedjax.errors import InputError


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="pedjax",
        description="Differentiable pedestrian dead reckoning: from a recording to a tuned track.",
    )
    parser.add_argument("--version", action="version", version=f"pedjax {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    recordings = argparse.ArgumentParser(add_help=False)
    recordings.add_argument(
        "recordings",
        nargs="*",
        metavar="RECORDING",
        help="a file, or demo:SEED for a walk made by the package",
    )
    recordings.add_argument("--sensor", help="which sensor of the recording (default: foot)")
    recordings.add_argument(
        "--format", metavar="TOML", help="description of a csv or npz file (docs/formats.md)"
    )
    recordings.add_argument("--out", metavar="DIR", help="folder for results (default: out)")
    recordings.add_argument("--no-figures", action="store_true", help="draw nothing")

    system = argparse.ArgumentParser(add_help=False)
    system.add_argument("--system", help="which estimator (default: iez)")
    system.add_argument(
        "--config", metavar="TOML", action="append", default=[],
        help="a config, or tuned parameters; a later one overrides an earlier one",
    )  # fmt: skip
    system.add_argument(
        "--set", metavar="PATH=VALUE", action="append", default=[],
        help="a parameter, or a tune. or sweep. setting, by its dotted path",
    )  # fmt: skip
    system.add_argument("--clock", choices=("stamps", "uniform", "resample"), help="how to read time stamps")
    system.add_argument("--alignment", help="auto, none, yaw or yaw_translation (default: auto)")
    system.add_argument("--seed", type=int, help="seed of everything random (default: 0)")

    both = [recordings, system]
    commands.add_parser("info", parents=[recordings], help="what a file holds, and what looks wrong with it")
    commands.add_parser("run", parents=both, help="track and errors with given parameters")
    tune = commands.add_parser("tune", parents=both, help="better parameters by gradient")
    tune.add_argument(
        "--held-back", metavar="RECORDING", nargs="+", default=[], help="recordings to report but not tune on"
    )
    tune.add_argument(
        "--split", type=float, metavar="PART", help="tune on this part of the recordings, hold back the rest"
    )
    tune.add_argument("--names", metavar="PATH", nargs="+", help="the parameters to tune")
    commands.add_parser("sweep", parents=both, help="errors of many parameter sets")
    roc = commands.add_parser(
        "roc", parents=both, help="ROC of stance detectors against the truth's velocity"
    )
    roc.add_argument("--detectors", nargs="+", metavar="NAME", help="default: all six")
    roc.add_argument("--false-alarm", type=float, default=0.05, help="operating point (default: 0.05)")
    roc.add_argument(
        "--still-below", type=float, default=0.1, metavar="M/S", help="speed below which the foot is still"
    )
    commands.add_parser("parameters", parents=[system], help="list the parameters of a system")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; returns its exit status."""
    parser = _parser()
    args = parser.parse_args(argv)
    if not getattr(args, "recordings", True) and not getattr(args, "config", None):
        parser.error(f"{args.command}: name a recording, or demo:0 for a walk made by the package")
    from pedjax.runtime import configure

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        configure()
    for warning in caught:
        print(f"pedjax: {warning.message}", file=sys.stderr)
    from pedjax.cli import commands

    try:
        return commands.COMMANDS[args.command](args)
    except InputError as error:
        print(f"pedjax: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("pedjax: interrupted", file=sys.stderr)
        return 130
