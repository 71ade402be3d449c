"""A magnet put on in the middle of a walk: what it costs, with hard iron taken as fixed and tracked.

    python -m experiments.ma2018.hard_iron [--walks 4] [--first-seed 2] [--step 12 -8 5] [--out DIR]

Simulated walks; from half time on the magnetometer reads `--step` µT more in body axes. Mean landmark errors
in m after the best yaw and translation, for plain ZUPT, Ma 2018, and preset `ma2018_tracked`, whose three
numbers were chosen on seeds 0 and 1 of the office; how long the tracker takes to be within 3 µT for 5 s, and
how far it is off afterwards.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

import pedjax
from experiments import presets
from pedjax.output import folder, write_table
from pedjax.recording import Stream

PLACES = ("office-loop", "teaching-building")
PRESETS = ("ma2018_zupt", "ma2018", "ma2018_tracked")
NEAR, FOR = 3.0, 5.0  # µT, s


def disturbed(recording: pedjax.Recording, step: np.ndarray) -> pedjax.Recording:
    """With `step (3,)` µT more on the magnetometer from half time on."""
    foot = recording.sensor()
    assert foot.magnetometer is not None
    time, field = foot.magnetometer.time, foot.magnetometer.values
    late = (time > 0.5 * (time[0] + time[-1]))[:, None]
    sensor = replace(foot, magnetometer=Stream(time, field + late * step))
    return replace(recording, sensors={"foot": sensor})


def found(track: pedjax.Track, step: np.ndarray) -> tuple[float, float]:
    """Seconds until the tracked offset is and stays for a while within 3 µT of the step, and its RMS error in
    µT from a minute after it on."""
    time, offset = track.time, track.more["hard_iron"]
    at = np.searchsorted(time, 0.5 * (time[0] + time[-1]))
    away = np.linalg.norm(offset - step, axis=1)
    samples = round(FOR / float(np.median(np.diff(time))))
    near = np.convolve(away[at:] < NEAR, np.ones(samples), "valid") > samples - 0.5
    later = away[np.searchsorted(time, time[at] + 60.0) :]
    return float(time[at + np.argmax(near)] - time[at]) if near.any() else np.inf, float(
        np.sqrt((later**2).mean())
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=2)
    parser.add_argument("--step", type=float, nargs=3, default=(12.0, -8.0, 5.0), help="µT, body axes")
    parser.add_argument("--out", type=Path, default=Path("out/ma2018_hard_iron"))
    args = parser.parse_args()
    pedjax.configure()
    step = np.array(args.step)
    rows = []
    for place in PLACES:
        for seed in tqdm(range(args.first_seed, args.first_seed + args.walks), place):
            walk = pedjax.simulate(place, seed).recording
            for name, recording in (("none", walk), ("magnet", disturbed(walk, step))):
                row = {"place": place, "seed": seed, "put on": name}
                for preset in PRESETS:
                    track = presets.run(recording, preset)
                    row[f"{preset}_m"] = presets.score(track, recording).mean_2d_m
                seconds, row["off_ut"] = found(track, step if name == "magnet" else 0 * step)
                row["found_s"] = seconds if name == "magnet" else np.nan
                rows.append(row)
    keys = list(rows[0])[3:]
    for place in PLACES:
        for name in ("none", "magnet"):
            own = [
                [row[key] for key in keys] for row in rows if (row["place"], row["put on"]) == (place, name)
            ]
            told = ", ".join(f"{key} {x:.2f}" for key, x in zip(keys, np.mean(own, axis=0), strict=True))
            print(f"{place:18} {name:7} {told}")
    write_table(folder(args.out) / "hard_iron.csv", {key: [row[key] for row in rows] for key in rows[0]})


if __name__ == "__main__":
    main()
