"""Recorded walks: what heuristic and compass do for feet that nobody simulated.

    python -m experiments.aiez.real [--walks FILE ...] [--loops FILE ...] [--out DIR]

`--walks` have landmarks: RMS errors in m after the best yaw and translation. Without a magnetometer the
von Mises heuristic beside the adaptive gate is chosen from a grid on every second walk and reported on the
others, and the other way round: no walk is reported with numbers that it helped to choose. Then every walk,
and the closure in m of every loop (`--loops`, the foot back where it stood), with each preset; those of
`aiez_adaptive` were chosen with these recordings in sight.
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
    "heuristic.straight.angle": tuple(np.radians([6.0, 10.0, 15.0])),
    "heuristic.von_mises.sigma": (0.02, 0.05, 0.1),
    "heuristic.von_mises.share": (0.5, 0.8),
    "heuristic.directions.strides": (3.0, 6.0),
}
STRIDES = (2, 3, 4)
STARTS: dict[str, dict[str, Any]] = {"as it is": {}, "bias from rest": {"initial.bias": "rest"}}
PRESETS = ("iez", "iez_adaptive", "iez_corridors", "ma2018", "aiez", "aiez_adaptive")


def _errors(
    walks: list[pedjax.Recording], changes: dict[str, Any], sets: dict[str, np.ndarray]
) -> np.ndarray:
    params = presets.params_of("iez_adaptive", changes)
    return pedjax.sweep(walks, sets, "iez", params, loss="rms_2d", alignment="yaw_translation").loss


def crossed(walks: list[pedjax.Recording], start: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Errors `(R,)` without the heuristic, and with it as chosen on the half that a walk is not in."""
    one = {"gravity": np.array([float(presets.params_of("iez_adaptive").gravity)])}
    plain = _errors(walks, start, one)[0]
    combinations = np.array(list(itertools.product(*GRID.values())))
    sets = dict(zip(GRID, combinations.T, strict=True))
    form = {"heuristic.form": "von_mises", "heuristic.beside": "always"}
    tried = [_errors(walks, {**start, **form, "heuristic.straight.strides": n}, sets) for n in STRIDES]
    errors = np.concatenate(tried)
    found = np.empty(len(walks))
    for half in (0, 1):
        mine = np.arange(len(walks)) % 2 == half
        best = int(errors[:, ~mine].mean(axis=1).argmin())
        found[mine] = errors[best, mine]
        chosen = dict(zip(GRID, combinations[best % len(combinations)], strict=True))
        told = ", ".join(f"{k.rpartition('.')[2]} {v:.3g}" for k, v in chosen.items())
        print(f"  for half {half}: {STRIDES[best // len(combinations)]} strides, {told}")
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
        plain, found = crossed(walks, start)
        adaptive = plain if adaptive is None else adaptive
        share, of_adaptive = found.mean() / plain.mean(), found.mean() / adaptive.mean()
        worst = (found / adaptive).max()
        print(
            f"no magnetometer, {name}: {plain.mean():.3f} m, with the heuristic {found.mean():.3f} "
            f"({share:.2f}); of the adaptive gate as it is {of_adaptive:.2f}, worst walk {worst:.2f}; "
            f"median {np.median(plain):.3f} to {np.median(found):.3f}"
        )
        columns = {"recording": [w.name for w in walks], "plain_m": plain, "heuristic_m": found}
        write_table(out / f"walks_{name.replace(' ', '_')}.csv", columns)
    rows = [recorded.line(recording, "walk", PRESETS) for recording in walks]
    rows += [recorded.line(pedjax.read(path), "loop", PRESETS) for path in args.loops]
    recorded.tell(rows, PRESETS)
    if rows:
        write_table(out / "presets.csv", {key: [row[key] for row in rows] for key in rows[0]})


if __name__ == "__main__":
    main()
