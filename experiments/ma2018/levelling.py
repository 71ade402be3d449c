"""What levels a field best: mean errors in a field that is the same everywhere, where only tilt is at fault.

    python -m experiments.ma2018.levelling [--walks 6] [--first-seed 0] [--place "office, plain"]

Ma 2018 with the field levelled by the force and by the attitude, with the landing left out of a look or not,
and with the zero velocity's noise of IEZ and its own. Defaults were chosen on these walks.
"""

from __future__ import annotations

import argparse

import numpy as np
from tqdm import tqdm

import pedjax
from experiments import presets
from experiments.ma2018.spread import PLACES, made
from pedjax.runtime import default_cache

IEZ = {"updates.zero_velocity": 0.01, "initial.accelerometer_bias": 0.02}
FORCE = {"compass.looking.levelling": "force"}
WHOLE = {"compass.looking.settle_s": 0.0, "compass.looking.dwell_s": 0.12}
VARIANTS = {
    "force, 0.01 m/s, landing counts": FORCE | IEZ | WHOLE,
    "force, 0.01 m/s": FORCE | IEZ,
    "attitude, 0.01 m/s": IEZ,
    "force": FORCE,
    "attitude": {},
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=6)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--place", default="office, plain", choices=list(PLACES))
    args = parser.parse_args()
    pedjax.configure(cache=default_cache())
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in VARIANTS}
    for seed in tqdm(range(args.first_seed, args.first_seed + args.walks), args.place):
        recording = made(args.place, seed).recording
        for name, changes in VARIANTS.items():
            track = presets.run(recording, "ma2018", changes)
            bias = float(np.abs(track.estimate["accelerometer_bias"]).max())
            found[name].append((presets.score(track, recording).mean_2d_m, bias))
    for name, each in found.items():
        errors, biases = np.array(each).T
        print(
            f"{name:34} mean {errors.mean():.2f} m, worst {errors.max():.2f} m; accelerometer bias up to "
            f"{biases.max():.2f} m/s^2"
        )


if __name__ == "__main__":
    main()
