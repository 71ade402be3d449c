"""AIEZ tuned end to end: detector, compass and heuristic by the gradient of landmark errors.

    python -m experiments.aiez.tuning [--walks 2] [--held-back 6] [--iterations 8] [--out DIR]

Walks of the teaching building and of the turned field (seeds from 0) are tuned on, others (seeds from 740)
only reported; the start is `--from` a preset. Errors are RMS of horizontal landmark errors in m after the
best yaw and translation, on hard gates.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tqdm import tqdm

import pedjax
from experiments import presets
from experiments.aiez import made
from pedjax import parameters
from pedjax.output import folder, write_json, write_toml
from pedjax.runtime import default_cache
from pedjax.tuning import TuneSettings

PLACES = ("teaching-building", "turned-field")
NAMES = (
    "field.aiez.threshold", "field.aiez.sigma_heading", "field.aiez.sigma_strength", "compass.noise.floor",
    "compass.tail", "heuristic.von_mises.sigma", "heuristic.von_mises.share", "heuristic.straight.angle",
    "updates.zero_velocity", "initial.sway",
)  # fmt: skip
"""The order of names decides which random numbers scatter whom."""


def walks(seeds: range) -> list[pedjax.Recording]:
    return [made.walk(place, seed).recording for seed in tqdm(seeds, "walks") for place in PLACES]


def by_place(each: dict[str, float]) -> dict[str, float]:
    return {place: float(np.mean([e for name, e in each.items() if place in name])) for place in PLACES}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=2, help="of each place, tuned on")
    parser.add_argument("--held-back", type=int, default=6, help="of each place, only reported")
    parser.add_argument("--iterations", type=int, default=8)
    parser.add_argument("--from", dest="preset", default="aiez", help="preset to start from")
    parser.add_argument("--out", type=Path, default=Path("out/aiez_tuning"))
    args = parser.parse_args()
    pedjax.configure(cache=default_cache())
    out = folder(args.out)
    params = presets.params_of(args.preset, {"heuristic.form": "von_mises"})
    settings = TuneSettings(NAMES, iterations=args.iterations, starts=2, validation=0.0, loss="rms_2d")
    tuned_on, held = walks(range(args.walks)), walks(range(740, 740 + args.held_back))
    tuned = pedjax.tune(tuned_on, settings, "aiez", params, held_back=held)
    report = {
        when: {part: by_place(each) for part, each in found.items()}
        for when, found in (("before", tuned.before), ("after", tuned.after))
    }
    for when, parts in report.items():
        for part, errors in parts.items():
            print(when, part, ", ".join(f"{place} {e:.3f} m" for place, e in errors.items()))
    write_json(out / "tuning.json", report)
    for name, value in tuned.values.items():
        print(f"  {name}: {float(parameters.get(params, name)):.4g} to {value:.4g}")
    chosen = {"tuned_on": list(tuned.fingerprints), "parameters": parameters.to_nested(tuned.params)}
    write_toml(out / "tuned.toml", {"system": "aiez", **chosen})


if __name__ == "__main__":
    main()
