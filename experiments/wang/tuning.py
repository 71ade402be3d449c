"""Wang tuned by the gradient of landmark errors: gain and weights of the start, scale of alpha, noise of the
heading.

    python -m experiments.wang.tuning [--walks 2] [--held-back 6] [--iterations 8] [--out DIR]

Walks of each path with a car that passes during the stand and bumps along the way (seeds from 0) are tuned
on, others (seeds from 980) only reported. Two starts: `wang` from AGDA, and `wang_best` with its weighted
stand. Errors are RMS of horizontal errors at the landmarks in m, unaligned: north counts.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import pedjax
from experiments import presets
from experiments.wang import made
from pedjax import parameters
from pedjax.output import folder, write_json, write_toml
from pedjax.runtime import default_cache
from pedjax.tuning import TuneSettings

NAMES = {
    "wang": (
        "initial.align.gain", "initial.align.decay", "compass.adaptive.scale", "compass.adaptive.softness",
        "compass.noise.floor", "compass.compensation.softness", "updates.zero_velocity",
    ),
    "wang_best": (
        "initial.align.strength_spread", "initial.align.dip_spread", "compass.adaptive.scale",
        "compass.adaptive.softness", "compass.noise.floor", "compass.noise.oddity", "updates.zero_velocity",
    ),
}  # fmt: skip
"""By preset; their order decides which random numbers scatter whom."""
FIELD = {"car": 20.0}


def walks(seeds: range) -> list[pedjax.Recording]:
    return [made.walk(path, seed, **FIELD).recording for seed in tqdm(seeds, "walks") for path in made.PATHS]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=2, help="of each path, tuned on")
    parser.add_argument("--held-back", type=int, default=6, help="of each path, only reported")
    parser.add_argument("--iterations", type=int, default=8)
    parser.add_argument("--out", type=Path, default=Path("out/wang_tuning"))
    args = parser.parse_args()
    pedjax.configure(cache=default_cache())
    out = folder(args.out)
    tuned_on, held = walks(range(args.walks)), walks(range(980, 980 + args.held_back))
    report: dict[str, Any] = {}
    for preset, names in NAMES.items():
        params = presets.params_of(preset, made.EARTH)
        settings = TuneSettings(
            names, iterations=args.iterations, starts=2, validation=0.0, loss="rms_2d", alignment="none"
        )
        tuned = pedjax.tune(tuned_on, settings, "wang", params, held_back=held)
        report[preset] = {
            f"{part} {when}": float(np.mean(list(each.values())))
            for when, found in (("before", tuned.before), ("after", tuned.after))
            for part, each in found.items()
        }
        print(preset, ", ".join(f"{k} {v:.3f} m" for k, v in report[preset].items()), flush=True)
        for name, value in tuned.values.items():
            print(f"  {name}: {float(parameters.get(params, name)):.4g} to {value:.4g}")
        chosen = {"tuned_on": list(tuned.fingerprints), "parameters": parameters.to_nested(tuned.params)}
        write_toml(out / f"{preset}_tuned.toml", {"system": "wang", **chosen})
    write_json(out / "tuning.json", report)


if __name__ == "__main__":
    main()
