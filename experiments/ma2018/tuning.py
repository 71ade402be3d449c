"""Ma 2018 tuned end to end: field detector and heading noise by the gradient of landmark errors.

    python -m experiments.ma2018.tuning [--walks 3] [--held-back 6] [--detector ma] [--out DIR]

Walks of the simulated mall and office (seeds from 0) are tuned on, others (seeds from 420) only reported. The
starts are the published threshold and scattered ones; what is chosen is chosen on the hard gates of the
tuned-on walks. Errors are means of horizontal landmark errors in m after the best yaw and translation.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tqdm import tqdm

import pedjax
from experiments.presets import params_of
from pedjax import parameters
from pedjax.output import folder, write_json, write_table, write_toml
from pedjax.systems.ma2018 import MA2018
from pedjax.tuning import TuneSettings

PLACES = ("mall", "office-loop")
THRESHOLDS = {"magyq": ("variance",), "vector": ("false_alarm", "change")}
"""Operating points of detectors that have no `threshold`."""
HEADING = ("compass.noise.floor", "compass.noise.field", "compass.tail", "compass.start_sigma")
"""The order of names decides which random numbers scatter whom."""


def walks(seeds: range) -> list[pedjax.Recording]:
    return [pedjax.simulate(place, seed).recording for seed in tqdm(seeds, "walks") for place in PLACES]


def by_place(each: dict[str, float]) -> dict[str, float]:
    return {place: float(np.mean([e for name, e in each.items() if place in name])) for place in PLACES}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=3, help="of each place, tuned on")
    parser.add_argument("--held-back", type=int, default=6, help="of each place, only reported")
    parser.add_argument("--detector", default="ma", help="field detector")
    parser.add_argument("--iterations", type=int, default=30)
    parser.add_argument("--out", type=Path, default=Path("out/ma2018_tuning"))
    args = parser.parse_args()
    pedjax.configure()
    out = folder(args.out)
    detector = {"field.detector": args.detector}
    published = {"field.ma.threshold": 170.0} if args.detector == "ma" else {}
    params = params_of("ma2018", detector | published)
    thresholds = (f"field.{args.detector}.{name}" for name in THRESHOLDS.get(args.detector, ("threshold",)))
    names = (*thresholds, *HEADING, "compass.noise.oddity", "updates.zero_velocity", "initial.gyroscope_bias")
    if args.detector == "ma":
        names += tuple(f"field.ma.sigma_{channel}" for channel in ("heading", "inclination", "strength"))
    settings = TuneSettings(names=names, loss="mean_2d", iterations=args.iterations, starts=2, validation=0.0)
    tuned_on, held_back = walks(range(args.walks)), walks(range(420, 420 + args.held_back))
    bar = tqdm(total=args.iterations, desc="tuning")

    def progress(iteration: int, _: int, best: float) -> None:
        bar.n = iteration
        bar.set_postfix_str(f"best {best:.3f} m")
        bar.refresh()

    tuned = pedjax.tune(tuned_on, settings, MA2018, params, held_back=held_back, progress=progress)
    others = {}
    for name, other in {"zupt": params_of("ma2018_zupt"), "default": params_of("ma2018", detector)}.items():
        gravity = {"gravity": np.array([float(params.gravity)])}
        found = pedjax.sweep([*tuned_on, *held_back], gravity, MA2018, other, loss="mean_2d")
        others[name] = found.loss[0]
    rows = []
    for part, before in tuned.before.items():
        after = tuned.after[part]
        own = slice(0, len(tuned_on)) if part == "tuned_on" else slice(len(tuned_on), None)
        for place in PLACES:
            row = {"part": part, "place": place}
            for name, each in others.items():
                of = dict(zip(before, each[own].tolist(), strict=True))
                row |= {f"{name}_m": by_place(of)[place]}
            row |= {"before_m": by_place(before)[place], "tuned_m": by_place(after)[place]}
            rows.append(row)
            print(*(f"{k} {v:.2f}" if isinstance(v, float) else v for k, v in row.items()), sep="  ")
    for name, value in tuned.values.items():
        print(f"  {name}: {float(parameters.get(params, name)):.4g} to {value:.4g}")
    write_table(out / "tuning.csv", {key: [row[key] for row in rows] for key in rows[0]})
    write_json(out / "each.json", {"before": tuned.before, "after": tuned.after, "runs": tuned.runs})
    write_toml(
        out / "tuned.toml",
        {
            "system": "ma2018",
            "tuned_on": list(tuned.fingerprints),
            "parameters": parameters.to_nested(tuned.params),
        },
    )


if __name__ == "__main__":
    main()
