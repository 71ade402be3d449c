"""How far the filters come apart from walk to walk: all places, eighteen seeds, and the controls.

    python -m experiments.ma2018 spread
    python -m experiments.ma2018.spread [--walks N] [--first-seed S] [--places PLACE ...] [--out DIR]

Landmark errors after the best yaw and translation, mean along each walk; over walks their mean, median,
quartiles and worst, the mean at the end, and the mean as a share of plain ZUPT's with its 95 % interval from
drawing walks anew. `plain` places are the same walks in a field that is the same everywhere: what is left is
not the field's doing. Tables are written as CSV, and as Markdown for the guide.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import pedjax
from experiments import presets
from experiments.table import Row, row
from pedjax.output import atomic, folder, write_table
from pedjax.runtime import default_cache
from pedjax.simulation.scenarios import load_scenario
from pedjax.simulation.world import simulate

PLAIN = {"kind": "munich"}
"""A field that is the same everywhere, 48 µT and 64 degrees below the horizon."""

PLACES: dict[str, tuple[str, dict[str, Any]]] = {
    "office": ("office-loop", {}),
    "office, plain": ("office-loop", {"field": PLAIN}),
    "mall": ("mall", {}),
    "mall-between": ("mall-between", {}),
    "mall-gentle": ("mall-gentle", {}),
    "mall, plain": ("mall", {"field": PLAIN}),
}
"""Scenarios, and what else is changed."""

FILTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "ZUPT": ("ma2018_zupt", {}),
    "ZUPT, 0.01 m/s": (
        "ma2018_zupt",
        {"updates.zero_velocity": 0.01, "initial.accelerometer_bias": 0.02},
    ),
    "QSF": ("ma2018_qsf", {}),
    "iQSF": ("ma2018_iqsf", {}),
    "Ma": ("ma2018", {}),
    "Ma, as published": ("ma2018_published", {}),
    "vector": ("ma2018", {"field.detector": "vector"}),
    "iQSF, 40": ("ma2018_iqsf", {"field.iqsf.threshold": 40.0}),
    "Ma, 40": ("ma2018", {"field.ma.threshold": 40.0}),
    "iQSF, 170": ("ma2018_iqsf", {"field.iqsf.threshold": 170.0}),
    "Ma, 170": ("ma2018", {"field.ma.threshold": 170.0}),
}
"""Presets, and what else is changed. The first is what the others are held against; the second has the noises
of IEZ, with which a foot without a compass does better."""

WANTED = {"office": 1.2, "office, plain": 0.6, "mall, plain": 0.8}
"""Most that Ma may leave in the mean, m: set before the walks were seen."""


def made(place: str, seed: int) -> pedjax.Simulated:
    """One walk of a place."""
    scenario, changes = PLACES[place]
    return simulate(replace(load_scenario(scenario), **changes), seed)


def errors(place: str, seeds: range, filters: Sequence[str] = tuple(FILTERS)) -> dict[str, np.ndarray]:
    """Of each filter the mean, final and largest error of every walk in m, the drift of its yaw in deg, and
    the share of looks that count: `(N, 5)`."""
    found: dict[str, list[list[float]]] = {name: [] for name in filters}
    for seed in tqdm(seeds, place):
        walked = made(place, seed)
        recording, attitude = walked.recording, walked.truth["foot"].motion.attitude[[0, -1]]
        yaw = np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0])
        for name in filters:
            preset, changes = FILTERS[name]
            track = presets.run(recording, preset, changes)
            score = presets.score(track, recording)
            used = float(track.gates["field"].open[track.more["look"] > 0].mean())
            drift = float(np.degrees(abs(np.angle(np.exp(1j * np.diff(track.euler[[0, -1], 2] - yaw)[0])))))
            found[name].append([score.mean_2d_m, score.final_2d_m, score.max_2d_m, drift, used])
    return {name: np.array(each) for name, each in found.items()}


def ratio(ours: np.ndarray, others: np.ndarray, draws: int = 4000) -> tuple[float, float, float]:
    """The ratio of two means over the same walks, with its 95 % interval."""
    index = np.random.default_rng(0).integers(0, len(ours), (draws, len(ours)))
    low, high = np.percentile(ours[index].mean(axis=1) / others[index].mean(axis=1), [2.5, 97.5])
    return float(ours.mean() / others.mean()), float(low), float(high)


def told(place: str, found: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """A line of the table for each filter."""
    lines = []
    for name, each in found.items():
        mean = each[:, 0]
        low, middle, high = np.percentile(mean, [25, 50, 75])
        share = ratio(mean, found["ZUPT"][:, 0])
        lines.append(
            {
                "place": place, "filter": name, "walks": len(mean), "mean_m": mean.mean(), "median_m": middle,
                "quarter_m": low, "three_quarters_m": high, "worst_m": mean.max(),
                "end_m": each[:, 1].mean(), "largest_m": each[:, 2].mean(), "drift_deg": each[:, 3].mean(),
                "looks_used": each[:, 4].mean(),
                "of_zupt": share[0], "of_zupt_low": share[1], "of_zupt_high": share[2],
            }
        )  # fmt: skip
    return lines


def markdown(lines: Sequence[dict[str, Any]]) -> str:
    """The table as the guide has it."""
    rows = [
        "| place | filter | mean | median | quartiles | worst | end | looks used | mean, of ZUPT's |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    order = {(place, name): k for k, (place, name) in enumerate(itertools.product(PLACES, FILTERS))}
    for x in sorted(lines, key=lambda x: order[x["place"], x["filter"]]):
        used = "" if x["filter"] == "ZUPT" else f"{100 * x['looks_used']:.0f} %"
        share = "" if x["filter"] == "ZUPT" else (
            f"{x['of_zupt']:.2f} [{x['of_zupt_low']:.2f}, {x['of_zupt_high']:.2f}]"
        )  # fmt: skip
        rows.append(
            f"| {x['place']} | {x['filter']} | {x['mean_m']:.2f} | {x['median_m']:.2f} | "
            f"{x['quarter_m']:.2f} to {x['three_quarters_m']:.2f} | {x['worst_m']:.2f} | {x['end_m']:.2f} | "
            f"{used} | {share} |"
        )
    return "\n".join(rows) + "\n"


PUBLISHED = {
    "office": ("F10", "end: ZUPT 2 m and 14 deg; iQSF, Ma within 0.5 m"),
    "mall": ("F12", "largest: iQSF 51 m, Ma 3 m; mean: 11.3, 1.5 m"),
}


def published(place: str, found: dict[str, np.ndarray]) -> list[Row]:
    """The published number beside ours, means over walks; what was wanted of Ma; Ma as a share of iQSF."""
    rows = []
    ma, iqsf = found["Ma"], found["iQSF"]
    if place in PUBLISHED:
        name, number = PUBLISHED[place]
        zupt, iq, own = (found[n].mean(axis=0) for n in ("ZUPT", "iQSF", "Ma"))
        if place == "office":
            told = f"ZUPT {zupt[1]:.1f} m and {zupt[3]:.0f} deg; iQSF {iq[1]:.2f}, Ma {own[1]:.2f} m"
            met = bool(max(own[1], iq[1]) < 0.5)
        else:
            told = f"iQSF {iq[2]:.1f}, Ma {own[2]:.1f} m; {iq[0]:.1f}, {own[0]:.2f} m"
            met = bool(own[2] < 3 and own[0] < 1.5)
        rows.append(row(name, f"{place}, {len(ma)} walks", number, told, met))
    if place in WANTED:
        told = f"{ma[:, 0].mean():.2f} m, worst {ma[:, 0].max():.2f}"
        met = bool(ma[:, 0].mean() <= WANTED[place])
        rows.append(row("S", f"{place}: Ma's mean", f"at most {WANTED[place]:g} m", told, met))
    if not place.endswith("plain"):
        share = "{:.2f} [{:.2f}, {:.2f}]".format(*ratio(ma[:, 0], iqsf[:, 0]))
        rows.append(row("F15,16", f"{place}: Ma of iQSF", "mall 0.13", share, None))
    return rows


def run(
    seeds: range, out: Path, places: Sequence[str] = tuple(PLACES), filters: Sequence[str] = tuple(FILTERS)
) -> list[Row]:
    """All places; the rows of the table, where all filters are run."""
    lines: list[dict[str, Any]] = []
    rows = []
    for place in places:
        found = errors(place, seeds, filters)
        own = told(place, found)
        lines += own
        print(markdown(own))
        write_table(out / "spread.csv", {key: [line[key] for line in lines] for key in lines[0]})
        rows += published(place, found) if len(filters) == len(FILTERS) else []
    atomic(out / "spread.md", lambda file: file.write(markdown(lines).encode()))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=18, help="of each place")
    parser.add_argument("--first-seed", type=int, default=400)
    parser.add_argument("--places", nargs="*", default=list(PLACES), choices=list(PLACES))
    parser.add_argument("--filters", nargs="*", default=list(FILTERS), choices=list(FILTERS))
    parser.add_argument("--out", type=Path, default=Path("out/ma2018_spread"))
    args = parser.parse_args()
    pedjax.configure(cache=default_cache())
    run(range(args.first_seed, args.first_seed + args.walks), folder(args.out), args.places, args.filters)


if __name__ == "__main__":
    main()
