"""Phones in real pockets: the system `pocket` beside VQF, tuned on one subject and reported on the other.

    python -m experiments.munoz_diaz.phones [DATA] [--out DIR]

DATA is a folder with `pocket_mocap/` (default: the environment's PEDJAX_DATA). Heading errors as in
`pockets`: the best constant rotations from both sides removed, ten seconds after each of five starts left
out. Parameters were found on the other subject's walks with made-up magnets beside, by a search or by
gradient (`tuning`). The prior of a bias is the mean of the other subject's walks: another day, another
pocket, the same phone."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

import pedjax
from experiments.munoz_diaz import pockets
from experiments.munoz_diaz.pockets import Trial
from pedjax import config, parameters
from pedjax.output import folder, write_table
from pedjax.recording import Sensor, Stream
from pedjax.runtime import default_cache

WAYS = ("search", "gradient")
"""How parameters were found: by a search over all of them, or by `tuning`; each on one subject's walks
alone."""

OTHER = {"a": "b", "b": "a"}
"""On whose walks the parameters for a subject's were found."""

PRIOR_SIGMA = 0.5
"""deg/s, as VQF is given it."""

KNOWN_SIGMA = 0.02
"""deg/s, of the bias that the cameras tell."""

ODD_FIELD = 8.0
"""µT from the walk's usual field, beyond which a reading is left out where the cameras judge it."""

Params = Mapping[str, Any]


class Found(NamedTuple):
    """Of one run: heading and total error in degrees, yaw NEES, whether it was locked out at the end, and its
    healthy status."""

    heading: float
    total: float
    nees: float
    locked_out: bool


class Variant(NamedTuple):
    """A way to run: prior of the bias (`none`, `other` subject's mean, or as the cameras `known`) with its
    standard deviation in deg/s, how many passes, whether the cameras judge the readings, and how the
    parameters were found."""

    prior: str = "none"
    sigma: float = PRIOR_SIGMA
    passes: int = 1
    judged: bool = False
    way: str = "search"


VARIANTS = {
    "pocket": Variant(),
    "pocket, prior": Variant("other"),
    "pocket, prior 0.3": Variant("other", 0.3),
    "pocket, two passes": Variant(passes=2),
    "pocket, prior, two passes": Variant("other", passes=2),
    "oracle: bias": Variant("known", KNOWN_SIGMA),
    "oracle: gate": Variant(judged=True),
    "oracle: bias and gate": Variant("known", KNOWN_SIGMA, judged=True),
    "gradient: pocket": Variant(way="gradient"),
    "gradient: prior": Variant("other", way="gradient"),
    "gradient: two passes": Variant(passes=2, way="gradient"),
}


def with_bias(params: Any, bias: np.ndarray, sigma_deg: float) -> Any:
    """Parameters with a first bias in rad/s."""
    given = {f"initial.prior.{axis}": float(x) for axis, x in zip("xyz", bias, strict=True)}
    sigma = float(np.radians(sigma_deg))
    return parameters.replace(params, {**given, "initial.bias": "given", "initial.gyroscope_bias": sigma})


def _near(attitude: np.ndarray, reading: np.ndarray) -> np.ndarray:
    """Which readings `(K, 3)` µT are within `ODD_FIELD` of hard iron and one field in navigation axes, which
    are fitted to those that are, from the half that fits best on."""
    terms = np.concatenate([np.broadcast_to(np.eye(3), attitude.shape), attitude.swapaxes(1, 2)], axis=2)
    near = np.ones(len(reading), bool)
    for _ in range(10):
        fitted = np.linalg.lstsq(terms[near].reshape(-1, 6), reading[near].ravel(), rcond=None)[0]
        away = np.linalg.norm(reading - terms @ fitted, axis=1)
        near = away < max(ODD_FIELD, float(np.median(away)))
    return away < ODD_FIELD


def judged_field(trial: Trial, recording: pedjax.Recording) -> pedjax.Recording:
    """The recording without the readings that lie far from the walk's usual field, by the cameras'
    attitude."""
    sensor = recording.sensor("pocket")
    assert sensor.magnetometer is not None
    field, truth = sensor.magnetometer, trial.truth
    assert truth.quaternion is not None
    known = np.isfinite(truth.quaternion).all(axis=1)
    inside = (field.time >= truth.time[known][0]) & (field.time <= truth.time[known][-1])
    turn = Slerp(truth.time[known], Rotation.from_quat(truth.quaternion[known], scalar_first=True))
    usual = np.zeros(len(field.time), bool)
    usual[inside] = _near(turn(field.time[inside]).as_matrix(), field.values[inside])
    kept = Stream(field.time[usual], field.values[usual])
    return replace(recording, sensors={"pocket": Sensor(sensor.accelerometer, sensor.gyroscope, kept)})


def run(trial: Trial, params: Any, variant: Variant, start_s: float, prior: np.ndarray) -> Found:
    """One walk from one start on."""
    if variant.prior != "none":
        bias = prior if variant.prior == "other" else pockets.bias(trial)
        params = with_bias(params, bias, variant.sigma)
    recording = pockets.cropped(trial, start_s)
    if variant.judged:
        recording = judged_field(trial, recording)
    track = pedjax.run(recording, "pocket", params, passes=variant.passes)
    found = pockets.errors(track.attitude, track.time, trial, start_s)
    sigma = track.sigma["attitude"][:, 2]
    later = track.time > track.time[0] + 10.0
    nees = np.radians(found.heading) ** 2 * np.mean(1 / sigma[later] ** 2)
    return Found(*found, float(nees), bool(track.status[-1] != 0))


def params_of(subject: str, way: str) -> Any:
    """Parameters with which that subject's walks are reported."""
    return config.resolve(config.load(f"pocket_{way}_{OTHER[subject]}"))[1]


def table(
    trials: Sequence[Trial],
    variant: Variant,
    starts: Sequence[float] = pockets.STARTS,
    given: Mapping[str, Any] | None = None,
) -> np.ndarray:
    """`Found` of every walk and start, `(trials, starts, 4)`; `given` parameters by subject instead of those
    tuned."""
    rows = []
    for trial in trials:
        params = params_of(trial.subject, variant.way) if given is None else given[trial.subject]
        prior = pockets.prior_of(trials, trial.subject)
        rows.append([run(trial, params, variant, start, prior) for start in starts])
    return np.array(rows, float)


def line(name: str, trials: Sequence[Trial], found: np.ndarray) -> dict[str, Any]:
    """Means over clean and disturbed walks, and the worst."""
    disturbed = np.array([trial.disturbed for trial in trials])
    heading = found[..., 0]
    told = {
        "method": name,
        "clean_deg": float(heading[~disturbed].mean()),
        "disturbed_deg": float(heading[disturbed].mean()),
        "worst_deg": float(heading.max()),
        "clean_start_0_deg": float(heading[~disturbed, 0].mean()),
        "disturbed_start_0_deg": float(heading[disturbed, 0].mean()),
        "total_clean_deg": float(found[~disturbed, :, 1].mean()),
        "total_disturbed_deg": float(found[disturbed, :, 1].mean()),
        "yaw_nees_median": float(np.median(found[..., 2])) if found.shape[-1] > 2 else float("nan"),
        "locked_out": int(found[..., 3].sum()) if found.shape[-1] > 3 else 0,
    }
    print(*(f"{x:.2f}" if isinstance(x, float) else x for x in told.values()), sep="  ", flush=True)
    return told


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", nargs="?", type=Path, default=os.environ.get("PEDJAX_DATA"))
    parser.add_argument("--out", type=Path, default=Path("out/phones"))
    parser.add_argument("--only", nargs="*", default=list(VARIANTS), help="some of the variants")
    args = parser.parse_args()
    if args.data is None:
        parser.error("name the folder with the recordings, or set PEDJAX_DATA to it")
    pedjax.configure(precision="float64", cache=default_cache())
    out = folder(args.out)
    trials = pockets.load(Path(args.data))
    lines, each = [], []
    known = pockets.baseline(trials)
    for name in [*known, *args.only]:
        found = known[name] if name in known else table(trials, VARIANTS[name])
        lines.append(line(name, trials, found))
        for trial, row in zip(trials, found, strict=True):
            for start, one in zip(pockets.STARTS, row, strict=True):
                told = {"method": name, "walk": trial.name, "start_s": start, "heading_deg": float(one[0])}
                each.append(told)
    write_table(out / "phones.csv", {key: [x[key] for x in lines] for key in lines[0]})
    write_table(out / "phones_each.csv", {key: [x[key] for x in each] for key in each[0]})


if __name__ == "__main__":
    main()
