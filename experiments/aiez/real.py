"""Recorded walks: what heuristic and compass do for feet that nobody simulated.

    python -m experiments.aiez.real [--walks FILE ...] [--loops FILE ...] [--out DIR]

`--walks` have landmarks: RMS errors in m after the best yaw and translation. Without a magnetometer the
von Mises heuristic beside the adaptive gate is chosen from a grid on one half of the walks and reported on
the others, and the other way round: no walk is reported with numbers that it helped to choose (the grid
itself was drawn with them in sight). Told are every second walk against the others, and the mean over all
ways to halve them, since six walks choose by chance. Then every walk, and the closure in m of every loop
(`--loops`, the foot back where it stood), with each preset; those of `aiez_adaptive` were chosen with these
recordings in sight.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import Any

import numpy as np

import pedjax
from experiments import presets, recorded
from pedjax.output import folder, write_table
from pedjax.runtime import default_cache

GRID: dict[str, tuple[float, ...]] = {
    "heuristic.straight.angle": tuple(np.radians([6.0, 10.0, 15.0, 20.0])),
    "heuristic.von_mises.sigma": (0.01, 0.02, 0.05),
    "heuristic.von_mises.share": (0.5, 0.8, 0.95),
    "heuristic.directions.strides": (3.0, 6.0),
    "heuristic.directions.memory": (1.0, 20.0),  # as first learnt, or following
}
STRIDES = (2, 3, 4)
FORM: dict[str, Any] = {
    "heuristic.form": "von_mises",
    "heuristic.beside": "always",
    "heuristic.directions.error": 0.001,  # the best yaw takes away what all directions are off by
}
STARTS: dict[str, dict[str, Any]] = {"as it is": {}, "bias from rest": {"initial.bias": "rest"}}
PRESETS = ("iez", "iez_adaptive", "iez_corridors", "ma2018", "aiez", "aiez_adaptive")


def _errors(
    walks: list[pedjax.Recording], changes: dict[str, Any], sets: dict[str, np.ndarray]
) -> np.ndarray:
    params = presets.params_of("iez_adaptive", changes)
    return pedjax.sweep(walks, sets, "iez", params, loss="rms_2d", alignment="yaw_translation").loss


def halvings(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every second walk against the others, then all ways to halve them: `(1 + H, R)`, True where a walk is
    in the first one's half. And each walk's error `(1 + H, R)` with what the other half chooses, of the
    `errors (S, R)` of the sets."""
    walks = errors.shape[1]
    others = itertools.combinations(range(1, walks), (walks + 1) // 2 - 1)
    ways = [np.arange(walks) % 2 == 0, *(np.isin(np.arange(walks), (0, *some)) for some in others)]
    found = np.empty((len(ways), walks))
    for one, way in zip(found, ways, strict=True):
        for half in (way, ~way):
            one[half] = errors[errors[:, ~half].mean(axis=1).argmin(), half]
    return np.array(ways), found


def crossed(walks: list[pedjax.Recording], start: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Errors `(R,)` without the heuristic, and `(1 + H, R)` with it as chosen on the half that a walk is not
    in (`halvings`)."""
    one = {"gravity": np.array([float(presets.params_of("iez_adaptive").gravity)])}
    plain = _errors(walks, start, one)[0]
    combinations = np.array(list(itertools.product(*GRID.values())))
    sets = dict(zip(GRID, combinations.T, strict=True))
    tried = [_errors(walks, {**start, **FORM, "heuristic.straight.strides": n}, sets) for n in STRIDES]
    errors = np.concatenate(tried)
    ways, found = halvings(errors)
    for half, mine in enumerate((ways[0], ~ways[0])):
        best = int(errors[:, ~mine].mean(axis=1).argmin())
        chosen = dict(zip(GRID, combinations[best % len(combinations)], strict=True))
        told = ", ".join(f"{k.rpartition('.')[2]} {v:.3g}" for k, v in chosen.items())
        print(f"  for half {half}: {STRIDES[best // len(combinations)]} strides, {told}", flush=True)
    return plain, found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", nargs="*", type=Path, default=[])
    parser.add_argument("--loops", nargs="*", type=Path, default=[])
    parser.add_argument("--out", type=Path, default=Path("out/aiez_real"))
    args = parser.parse_args()
    pedjax.configure(cache=default_cache())
    out = folder(args.out)
    walks = [pedjax.read(path) for path in args.walks]
    adaptive = None
    for name, start in STARTS.items() if walks else ():
        plain, every = crossed(walks, start)
        adaptive = plain if adaptive is None else adaptive
        found = every[0]
        share, of_adaptive = found.mean() / plain.mean(), found.mean() / adaptive.mean()
        worst = (found / adaptive).max()
        print(
            f"no magnetometer, {name}: {plain.mean():.3f} m, with the heuristic {found.mean():.3f} "
            f"({share:.2f}); of the adaptive gate as it is {of_adaptive:.2f}, worst walk {worst:.2f}; "
            f"median {np.median(plain):.3f} to {np.median(found):.3f}"
        )
        every = every[1:]
        mean, shares = every.mean(axis=0), every.mean(axis=1) / plain.mean()
        low, high = np.quantile(shares, (0.1, 0.9))
        harmless = ((every / adaptive).max(axis=1) <= 1.05).mean()
        print(
            f"  all {len(every)} halvings: {mean.mean():.3f} ({shares.mean():.3f}; a tenth below {low:.2f}, "
            f"a tenth above {high:.2f}), worst walk {(mean / adaptive).max():.2f}; "
            f"no walk above 1.05 in {harmless:.0%} of them"
        )
        columns = {"recording": [w.name for w in walks], "plain_m": plain, "heuristic_m": found}
        columns["all_halvings_m"] = mean
        write_table(out / f"walks_{name.replace(' ', '_')}.csv", columns)
    rows = [recorded.line(recording, "walk", PRESETS) for recording in walks]
    rows += [recorded.line(pedjax.read(path), "loop", PRESETS) for path in args.loops]
    recorded.tell(rows, PRESETS)
    if rows:
        write_table(out / "presets.csv", {key: [row[key] for row in rows] for key in rows[0]})


if __name__ == "__main__":
    main()
