"""Recorded walks and loops with presets side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import pedjax
from experiments import presets
from experiments.ma2018.real import loop
from pedjax import config, parameters

Changes = Mapping[str, Any]


def line(
    recording: pedjax.Recording, kind: str, names: Sequence[str], changes: Mapping[str, Changes] | None = None
) -> dict[str, Any]:
    """Error of a recording with each preset: of a `walk` the RMS at its landmarks after the best yaw and
    translation, of a `loop` its closure, m; not a number where a preset needs a magnetometer that there is
    not. `changes` of parameters by preset."""
    found: dict[str, Any] = {"recording": recording.name, "kind": kind}
    for name in names:
        system, params = config.resolve(config.load(name))
        if system.magnetic and recording.sensor().magnetometer is None:
            found[name] = float("nan")
            continue
        track = pedjax.run(recording, system, parameters.replace(params, (changes or {}).get(name, {})))
        is_walk = kind == "walk"
        error = presets.score(track, recording).rms_2d_m if is_walk else loop(recording, track)["closure_m"]
        found[name] = float(error)
    print(*(f"{v:.2f}" if isinstance(v, float) else v for v in found.values()), sep="  ", flush=True)
    return found


def tell(rows: Sequence[Mapping[str, Any]], names: Sequence[str], beside: str = "iez_adaptive") -> None:
    """Mean and median of each preset by kind, and its worst ratio to the one `beside`."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        some = [row for row in rows if row["kind"] == kind]
        other = np.array([row[beside] for row in some])
        for name in names:
            each = np.array([row[name] for row in some])
            known = np.isfinite(each)
            if known.any():
                print(
                    f"{kind} {name:14} {known.sum()} of {len(each)}: mean {each[known].mean():.3f} "
                    f"({beside} {other[known].mean():.3f}), median {np.median(each[known]):.3f}, "
                    f"worst ratio {(each / other)[known].max():.2f}"
                )
