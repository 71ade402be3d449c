"""A magnetic aid on recorded walks: does it help, and does it harm?

    python -m experiments.ma2018.real [--loops FILE ...] [--walks FILE ...] [--out DIR]

`--loops` end where they began, with the foot as it stood (to a centimetre): told are the closure, by how much
the yaw of the track differs between end and start, by how much the field of the same spot does, turned by the
track, and by how much the field turns within a centimetre. `--walks` have landmarks: told is the RMS error
after the best yaw and translation. Plain ZUPT (`ma2018_zupt`), Ma's detector where it finds 0.8 in simulated
offices (`ma2018`) and with its published threshold (`ma2018_published`), and the parameters for buildings
(`ma2018_indoor`), whose one number is how much the field's direction changes from stride to stride on the
walks (not on the loops); nothing is tuned.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

import pedjax
from experiments import presets
from pedjax.output import folder, write_table
from pedjax.simulation.labels import stance_edges

PRESETS = ("ma2018_zupt", "ma2018", "ma2018_published", "ma2018_indoor")


def _angle(x: float) -> float:
    return float(abs(np.degrees(np.angle(np.exp(1j * x)))))


def loop(recording: pedjax.Recording, track: pedjax.Track) -> dict[str, float]:
    """Closure in m, turn of the foot's yaw and of the field in deg between end and start."""
    imu = pedjax.inertial(recording)
    assert imu.magnetic_field is not None
    field = np.einsum("tij,tj->ti", track.attitude, imu.magnetic_field)
    still = np.flatnonzero(track.gates["stance"].open)
    half = 0.5 * imu.rate
    first, last = still[still < still[0] + half], still[still > still[-1] - half]
    azimuth = [np.arctan2(*field[at].mean(axis=0)[1::-1]) for at in (first, last)]
    yaw = [np.angle(np.exp(1j * track.euler[at, 2]).mean()) for at in (first, last)]
    return {
        "closure_m": float(np.linalg.norm(track.position[last].mean(axis=0)[:2] - track.position[0, :2])),
        "yaw_deg": _angle(yaw[1] - yaw[0]),
        "field_deg": _angle(azimuth[1] - azimuth[0]),
        "deg_per_cm": _turn_per_centimetre(track, np.unwrap(np.arctan2(field[:, 1], field[:, 0]))),
    }


def _turn_per_centimetre(track: pedjax.Track, azimuth: np.ndarray) -> float:
    """By how much the field turns from where the foot stood to 2 cm on, when it sets out: median, deg/cm."""
    found = []
    for first, end in zip(*stance_edges(track.gates["stance"].open), strict=True):
        away = np.linalg.norm(track.position[end:] - track.position[end - 1], axis=1)
        if end - first > 30 and (away > 0.02).any():
            k = int(np.argmax(away > 0.02))
            found.append(_angle(azimuth[end + k] - azimuth[first:end].mean()) / (100 * away[k]))
    return float(np.median(found))


def walk(recording: pedjax.Recording, track: pedjax.Track) -> dict[str, float]:
    """RMS error at the landmarks in m."""
    return {"rms_m": presets.score(track, recording).rms_2d_m}


def compared(
    paths: list[Path], told: Callable[[pedjax.Recording, pedjax.Track], dict[str, float]]
) -> list[dict[str, float | str]]:
    """Every recording with every preset; printed with the ratio to plain ZUPT, and the medians."""
    rows: list[dict[str, float | str]] = []
    for path in paths:
        recording = pedjax.read(path)
        if recording.sensor().magnetometer is None:
            print(f"{path.name}: no magnetometer")
            continue
        for preset in PRESETS:
            track = presets.run(recording, preset)
            looks = track.more["look"] > 0
            found = told(recording, track)
            used = float((track.gates["field"].open[looks]).mean()) if looks.any() else 0.0
            rows.append({"recording": path.name.split(".")[0], "preset": preset, **found, "looks_used": used})
            print(*(f"{v:.2f}" if isinstance(v, float) else f"{v:34}" for v in rows[-1].values()), sep="  ")
    for key in [k for k in rows[0] if k.endswith(("_m", "_deg", "_cm"))]:
        each = {p: np.array([float(row[key]) for row in rows if row["preset"] == p]) for p in PRESETS}
        plain = each[PRESETS[0]]
        for preset, values in each.items():
            ratio = values / plain
            worst = int(np.argmax(ratio))
            print(
                f"{key:10} {preset:16} median {np.median(values):.2f}, of ZUPT's {np.median(ratio):.2f}, "
                f"worst {ratio[worst]:.2f} ({plain[worst]:.2f} to {values[worst]:.2f})"
            )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--loops", nargs="*", type=Path, default=[])
    parser.add_argument("--walks", nargs="*", type=Path, default=[])
    parser.add_argument("--out", type=Path, default=Path("out/ma2018_real"))
    args = parser.parse_args()
    pedjax.configure()
    out = folder(args.out)
    for name, paths, told in (("loops", args.loops, loop), ("walks", args.walks, walk)):
        if paths:
            rows = compared(paths, told)
            write_table(out / f"{name}.csv", {key: [row[key] for row in rows] for key in rows[0]})


if __name__ == "__main__":
    main()
