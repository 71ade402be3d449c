"""The command `simulate`: a scenario as a file that every command reads, and its truth beside it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from pedjax.cli.common import say
from pedjax.errors import InputError
from pedjax.output import atomic, folder, write_figure
from pedjax.plots.worlds import world_figure
from pedjax.readers.writing import write_csv
from pedjax.simulation.labels import quasi_static
from pedjax.simulation.scenarios import load_scenario, scenarios
from pedjax.simulation.world import Simulated, simulate


def run(args: argparse.Namespace) -> int:
    """Walk a scenario and write what its sensors measured."""
    if args.list:
        for name in scenarios():
            say(f"{name:18} {load_scenario(name).title}")
        return 0
    if args.scenario is None:
        raise InputError(
            "name a scenario or its TOML file; pedjax simulate --list shows those that come along"
        )
    if args.seed < 0:
        raise InputError(f"--seed {args.seed} must not be negative")
    scenario = load_scenario(args.scenario)
    target = Path(args.out or f"{scenario.name}-{args.seed}.csv.gz")
    if not target.name.endswith((".csv", ".csv.gz")):
        raise InputError(f"--out {target}: name a file that ends in .csv or .csv.gz")
    folder(target.parent)
    made = simulate(scenario, args.seed)
    write_csv(made.recording, target)
    stem = target.name.removesuffix(".gz").removesuffix(".csv")
    beside = target.with_name(f"{stem}.truth.npz")
    atomic(beside, lambda file: np.savez_compressed(file, **_truth(made)))
    say(*_described(made), f"written: {target} (with {target.name}.toml), truth in {beside}")
    if not args.no_figures:
        picture = target.with_name(f"{stem}.png")
        write_figure(picture, world_figure(made))
        say(f"drawn: {picture}")
    return 0


def _described(made: Simulated) -> list[str]:
    route = np.linalg.norm(np.diff(made.plan.route[:, :2], axis=0), axis=1).sum()
    lines = [
        f"{made.recording.name}: {made.scenario.title}",
        f"  {route:.1f} m, {made.plan.steps} steps, {made.plan.seconds:.1f} s",
    ]
    for place, truth in made.truth.items():
        strength = np.linalg.norm(truth.magnetic_field, axis=1)
        lines.append(
            f"  sensor '{place}' ({made.scenario.sensors[place]}): {len(truth.time)} samples, stance "
            f"{truth.stance.mean():.0%}, field {strength.mean():.1f} ± {strength.std():.1f} µT"
        )
    if made.recording.landmarks is not None:
        lines.append(f"  {len(made.recording.landmarks.time)} landmarks passed")
    return lines


def _truth(made: Simulated) -> dict[str, Any]:
    """Everything that is true at every sample, by sensor; `survey_...` where the scenario has one."""
    arrays: dict[str, Any] = {"step_time": made.steps, "route": made.plan.route}
    for place, truth in made.truth.items():
        arrays |= {
            f"{place}_time": truth.time,
            f"{place}_position": truth.motion.position,
            f"{place}_velocity": truth.motion.velocity,
            f"{place}_attitude": truth.motion.attitude,
            f"{place}_specific_force": truth.motion.specific_force,
            f"{place}_angular_rate": truth.motion.angular_rate,
            f"{place}_gyroscope_bias": truth.gyroscope_bias,
            f"{place}_accelerometer_bias": truth.accelerometer_bias,
            f"{place}_magnetic_field": truth.magnetic_field,
            f"{place}_disturbance": truth.disturbance,
            f"{place}_stance": truth.stance,
        }
        time, label = quasi_static(truth)
        arrays |= {f"{place}_stance_time": time, f"{place}_quasi_static": label}
    return {**arrays, **made.survey()}
