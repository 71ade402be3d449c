"""Heading heuristics: what each does for a walk that is straight, and to one that is not.

Each form at its defaults, and Zhang's HDR as printed, with a compass (AIEZ) and without one (IEZ with its
first bias measured at rest): RMS errors at the landmarks after the best yaw and translation, as a share of
the same filter's without a heuristic; and the mean square of the yaw's error over its variance (NEES).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments import presets
from experiments.aiez import made
from experiments.table import Row, row
from pedjax.output import atomic, write_table

CURVED = ("mall", "mall-gentle")
STRAIGHT = ("office-loop", "teaching-building")
_PRINTED = {
    "heuristic.form": "hdr", "heuristic.hdr.on_curve": "zero", "heuristic.hdr.sigma": 0.1,
    "heuristic.straight.detector": "change", "heuristic.straight.heading": "yaw",
    "heuristic.straight.strides": 3, "heuristic.straight.angle": 0.1745,
}  # fmt: skip
_SHORT = {"heuristic.straight.strides": 3, "heuristic.straight.angle": 0.1745}
FORMS: dict[str, dict[str, Any]] = {
    "none": {"heuristic.form": "none"},
    **{f: {"heuristic.form": f} for f in ("hdr", "slope", "integrator", "hde", "ihde", "mihde", "von_mises")},
    "hdr, printed": _PRINTED,
    "hdr, 3 strides, 10 deg": {**_PRINTED, "heuristic.hdr.on_curve": "skip"},
    "von_mises, 3 strides, 10 deg": {"heuristic.form": "von_mises", **_SHORT},
}
OWN = ("hdr", "slope", "integrator", "hde", "ihde", "mihde", "von_mises")
SYSTEMS: dict[str, tuple[str, dict[str, Any]]] = {
    "rest": ("iez", {"initial.bias": "rest", "initial.gyroscope_bias": 2e-3}),
    "compass": ("aiez", {}),
}


def _nees(walked: Any, track: Any) -> float:
    still = track.gates["stance"].open
    error = np.radians(made.yaw_error(walked, track))[still]
    return float(np.mean(error**2 / track.sigma["attitude"][still, 2] ** 2))


def run(seeds: range, out: Path) -> list[Row]:
    found: dict[tuple[str, str, str], list[tuple[float, float]]] = {}
    for place in (*CURVED, *STRAIGHT):
        for seed in tqdm(seeds, place):
            walked = made.walk(place, seed)
            for system, (preset, base) in SYSTEMS.items():
                for form, changes in FORMS.items():
                    if form == "mihde" and system == "rest":
                        continue
                    given = made.given_yaw(walked)
                    track = made.run(walked.recording, preset, {**base, **changes}, given)
                    score = presets.score(track, walked.recording).rms_2d_m
                    found.setdefault((place, system, form), []).append((score, _nees(walked, track)))
        _write(found, out)
    return _rows(found)


def _shares(
    found: dict[tuple[str, str, str], list[tuple[float, float]]], key: tuple[str, str, str]
) -> np.ndarray:
    """Of each walk, RMS as a share of the filter's without a heuristic."""
    plain = np.array(found[key[0], key[1], "none"])[:, 0]
    return np.asarray(np.array(found[key])[:, 0] / plain)


def _write(found: dict[tuple[str, str, str], list[tuple[float, float]]], out: Path) -> None:
    lines = []
    for key, each in found.items():
        rms, nees = np.array(each).T
        plain = np.array(found[key[0], key[1], "none"])
        lines.append(
            {
                "place": key[0], "beside": key[1], "form": key[2], "walks": len(rms), "rms_m": rms.mean(),
                "of_none": rms.mean() / plain[:, 0].mean(), "worst_of_none": _shares(found, key).max(),
                "nees": nees.mean(), "nees_of_none": nees.mean() / plain[:, 1].mean(),
            }
        )  # fmt: skip
        print(*(f"{v:.3f}" if isinstance(v, float) else v for v in lines[-1].values()), sep="  ", flush=True)
    write_table(out / "heuristics.csv", {key: [line[key] for line in lines] for key in lines[0]})
    atomic(out / "heuristics.md", lambda file: file.write(markdown(lines).encode()))


def markdown(lines: list[dict[str, Any]]) -> str:
    """The table as the guide has it: a line for each form, a column for each place and system."""
    told = {(x["place"], x["beside"], x["form"]): x for x in lines}
    columns = [(place, system) for place in (*CURVED, *STRAIGHT) for system in SYSTEMS]
    rows = ["| form | " + " | ".join(f"{place}, {system}" for place, system in columns) + " |"]
    rows.append("|---" * (len(columns) + 1) + "|")
    for form in list(FORMS)[1:]:
        cells = []
        for place, system in columns:
            x = told.get((place, system, form))
            cells.append("" if x is None else f"{float(x['of_none']):.2f} ({float(x['worst_of_none']):.2f})")
        rows.append(f"| {form} | " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


def _rows(found: dict[tuple[str, str, str], list[tuple[float, float]]]) -> list[Row]:
    rows = []
    for system in SYSTEMS:
        for form in (*OWN, "hdr, printed", "hdr, 3 strides, 10 deg"):
            if ("mall", system, form) not in found:
                continue
            worst = max(float(_shares(found, (place, system, form)).max()) for place in CURVED)
            ours = form in OWN
            wanted, met = ("at most 1.05", worst <= 1.05) if ours else ("its harm", None)
            rows.append(row("HH", f"malls, {system}, {form}", wanted, f"worst walk {worst:.2f}", met))
    for form in ("hde", "ihde", "von_mises"):
        for place in STRAIGHT:
            key = (place, "rest", form)
            share = np.array(found[key])[:, 0].mean() / np.array(found[place, "rest", "none"])[:, 0].mean()
            rows.append(
                row("HH", f"{place}, rest, {form}", "at most 0.4", f"{share:.2f}", bool(share <= 0.4))
            )
    for form in ("slope", "von_mises"):
        for system in SYSTEMS:
            more = max(
                np.array(found[p, system, form])[:, 1].mean()
                / np.array(found[p, system, "none"])[:, 1].mean()
                for p in (*CURVED, *STRAIGHT)
            )
            wanted, met = "at most 1.2 of without", bool(more <= 1.2)
            rows.append(row("HH", f"yaw NEES, {system}, {form}", wanted, f"{more:.2f}", met))
    return rows
