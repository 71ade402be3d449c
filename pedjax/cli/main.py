"""Arguments in, exit status out: 0, 1 for a bad input (its sentence on standard error), 2 for wrong usage."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence

from pedjax import __version__
from pedjax.cli import allan, calibrate, roc, sigmas
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
        help="a file, or SCENARIO:SEED (as demo:0, demo:1..8) for walks made by the package",
    )
    recordings.add_argument(
        "--format", metavar="TOML", help="description of a csv or npz file (docs/formats.md)"
    )
    recordings.add_argument("--out", metavar="DIR", help="folder for results (default: out)")
    recordings.add_argument("--no-figures", action="store_true", help="draw nothing")

    single = argparse.ArgumentParser(add_help=False, parents=[recordings])
    single.add_argument("--sensor", help="which sensor of the recording (default: foot, or the only one)")

    system = argparse.ArgumentParser(add_help=False)
    system.add_argument("--system", help="which estimator (default: iez)")
    system.add_argument(
        "--sensor", metavar="[ROLE=]NAME", action="append",
        help="which sensor plays the system's first role, or the role named (default: the one of its name)",
    )  # fmt: skip
    system.add_argument(
        "--with", metavar="FILE.py", action="append", default=[], dest="plugins",
        help="a Python file that registers systems, detectors or losses of your own",
    )  # fmt: skip
    system.add_argument("--map", metavar="FILE", help="a map of the place, for systems that use one")
    system.add_argument(
        "--config", metavar="TOML", action="append", default=[],
        help="a config, or tuned parameters; a later one overrides an earlier one",
    )  # fmt: skip
    system.add_argument(
        "--set", metavar="PATH=VALUE", action="append", default=[],
        help="a parameter, or a tune. or sweep. setting, by its dotted path",
    )  # fmt: skip
    system.add_argument(
        "--calibration", metavar="TOML", help="calibration of the magnetometer, as pedjax calibrate writes it"
    )
    system.add_argument("--clock", choices=("stamps", "uniform", "resample"), help="how to read time stamps")
    system.add_argument("--alignment", help="auto, none, yaw or yaw_translation (default: auto)")
    system.add_argument("--seed", type=int, help="seed of everything random (default: 0)")

    both = [recordings, system]
    commands.add_parser("info", parents=[single], help="what a file holds, and what looks wrong with it")
    run = commands.add_parser("run", parents=both, help="track and errors with given parameters")
    run.add_argument(
        "--prior", metavar="TOML",
        help="biases of the sensor from an earlier walk: the NAME_prior.toml that its run wrote",
    )  # fmt: skip
    run.add_argument(
        "--passes", type=int, choices=(1, 2), default=1,
        help="2: run each walk once more from the biases that it ended with (not causal)",
    )  # fmt: skip
    tune = commands.add_parser("tune", parents=both, help="better parameters by gradient")
    tune.add_argument(
        "--held-back", metavar="RECORDING", nargs="+", default=[], help="recordings to report but not tune on"
    )
    tune.add_argument(
        "--split", type=float, metavar="PART", help="tune on this part of the recordings, hold back the rest"
    )
    tune.add_argument("--names", metavar="PATH", nargs="+", help="the parameters to tune")
    tune.add_argument(
        "--augment", type=int, metavar="N", help="tune also on N copies of each recording, with magnets added"
    )
    sweep = commands.add_parser(
        "sweep", parents=both, help="errors of many parameter sets, kept as they come"
    )
    sweep.add_argument(
        "--devices", type=int, metavar="N", help="devices to split the CPU into (default: one for each core)"
    )
    sweep.add_argument("--precision", choices=("float32", "float64"), help="of the filter (default: float32)")
    sweep.add_argument(
        "--distributed", action="store_true",
        help="this process is one of a job (SLURM, Open MPI, Kubernetes, or as --coordinator says)",
    )  # fmt: skip
    sweep.add_argument("--coordinator", metavar="HOST:PORT", help="where the job's first process listens")
    sweep.add_argument("--processes", type=int, metavar="N", help="processes of the job")
    sweep.add_argument("--process-id", type=int, metavar="I", help="number of this one, from 0")
    report = commands.add_parser("sweep-report", help="what a sweep's results say")
    report.add_argument("folder", metavar="DIR", help="the --out of a sweep")
    report.add_argument("--out", metavar="OTHER", help="where to write the report (default: DIR)")
    report.add_argument("--score", metavar="COLUMN", help="what to go by (default: the sweep's loss)")
    report.add_argument("--no-figures", action="store_true", help="draw nothing")
    for command in (sweep, report):
        command.add_argument("--against", metavar="COLUMN", help="the other score of the Pareto front")
        command.add_argument(
            "--no-gradient", dest="gradient", action="store_false", help="no slopes at the best set"
        )
    roc.add_parser(commands, both)
    sigmas.add_parser(commands, both)
    simulate = commands.add_parser("simulate", help="walk a scenario: sensors with errors, exact truth")
    simulate.add_argument("scenario", nargs="?", metavar="SCENARIO", help="its name, or a TOML file")
    simulate.add_argument("--list", action="store_true", help="the scenarios that come with the package")
    simulate.add_argument("--seed", type=int, default=0, help="of gait, sensors and building (default: 0)")
    simulate.add_argument(
        "--out", metavar="FILE", help="a csv or csv.gz file (default: SCENARIO-SEED.csv.gz)"
    )
    simulate.add_argument("--no-figures", action="store_true", help="draw nothing")
    allan.add_parser(commands, single)
    calibrate.add_parser(commands, single)
    commands.add_parser("parameters", parents=[system], help="list the parameters of a system")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; returns its exit status."""
    parser = _parser()
    args = parser.parse_args(argv)
    if not getattr(args, "recordings", True) and not getattr(args, "config", None):
        parser.error(f"{args.command}: name a recording, or demo:0 for a walk made by the package")
    try:
        _start(args)
        from pedjax.cli import commands

        return commands.COMMANDS[args.command](args)
    except InputError as error:
        print(f"pedjax: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("pedjax: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _devices(args: argparse.Namespace, cores: int) -> int:
    asked: int | None = getattr(args, "devices", None)
    return cores if asked is None else asked


def _start(args: argparse.Namespace) -> None:
    """Everything that must be chosen before JAX starts."""
    from pedjax.runtime import available_cores, configure, default_cache

    sweeps = args.command in ("sweep", "sweep-report")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        configure(
            precision=getattr(args, "precision", None),
            devices=_devices(args, available_cores()) if sweeps else None,
            cache=default_cache(),
        )
    for warning in caught:
        print(f"pedjax: {warning.message}", file=sys.stderr)
    named = [getattr(args, name, None) for name in ("coordinator", "processes", "process_id")]
    if getattr(args, "distributed", False) or any(x is not None for x in named):
        import jax

        try:
            jax.distributed.initialize(args.coordinator, args.processes, args.process_id)
        except (ValueError, RuntimeError) as error:
            remedy = "use srun, mpirun or Kubernetes, or name --coordinator, --processes and --process-id"
            raise InputError(f"--distributed: {error}; {remedy}") from None
