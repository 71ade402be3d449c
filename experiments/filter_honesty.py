"""Is the filter's covariance honest? Normalised estimation errors (NEES) over many simulated walks.

    python -m experiments.filter_honesty [--walks 40] [--rate HZ] [--out DIR]

At the end of each walk the squared error of each part of the state is divided by its covariance; its mean
over walks should be the number of components, within the band that chance allows. Two filters see the same
walks: `published` (the defaults: noises of uncalibrated units) and `sheet` (noises and initial errors as the
simulated unit has them). `sheet` also sees sensors without any error, which leaves what the model does not
know: a foot that moves between two samples, and one that is taken as still while it sways.
"""

from __future__ import annotations

import argparse
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2

import pedjax
from pedjax import filtering, parameters, rotations
from pedjax.filters import covariance
from pedjax.output import folder, write_table
from pedjax.preparing import prepare
from pedjax.runtime import double_precision
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.presets import calibrated, preset
from pedjax.simulation.scenarios import Scenario
from pedjax.simulation.world import Simulated, simulate
from pedjax.systems.iez import IEZ
from pedjax.walks import walk

UNIT, CALIBRATED = "mti_g_710", 0.95


def walked(rate: float, sensor: str) -> Scenario:
    """Three sides of a rectangle, a minute and a half."""
    return Scenario(
        name="honesty",
        rate_hz=rate,
        legs=(Leg(points=((0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (0.0, 20.0)), radius=1.0),),
        sensors={"foot": sensor},
        field={"kind": "none"},
        calibrated=CALIBRATED,
    )


PARTS = {
    "attitude": slice(0, 3), "gyroscope bias": slice(3, 6), "position": slice(6, 9), "velocity": slice(9, 12),
    "accelerometer bias": slice(12, 15),
}  # fmt: skip


def sheet() -> dict[str, float]:
    """Noises and initial errors as the simulated unit has them."""
    unit = calibrated(preset(UNIT), 1 - CALIBRATED)

    def size(x: Any) -> float:
        return float(np.max(np.asarray(x)))

    found = {}
    for name, triad in (("gyroscope", unit.gyroscope), ("accelerometer", unit.accelerometer)):
        drift, time = size(triad.drift_std), size(triad.drift_time)
        found |= {
            f"process.{name}": size(triad.noise),
            f"process.{name}_bias": drift * np.sqrt(2 / time),
            f"process.{name}_bias_time": time,
            f"initial.{name}_bias": float(np.hypot(size(triad.bias_std), drift)),
        }
    return found


def errors(made: Simulated, params: Any) -> tuple[np.ndarray, np.ndarray]:
    """Error state (15,) and covariance (15, 15) at the end, truth = estimate + error."""
    truth = made.truth["foot"]
    start = truth.motion.attitude[0]
    heading = float(np.arctan2(start[1, 0], start[0, 0]))
    params = parameters.cast(parameters.replace(params, {"initial.heading": heading}), float)
    found = walk(made.recording)
    inputs = prepare(IEZ, params, found, float, len(found))
    state, _ = _run(params, inputs)
    nav, last = state.estimate, -1
    turned = truth.motion.attitude[last] @ np.asarray(nav.attitude).T
    position = truth.motion.position[last] - truth.motion.position[0] - np.asarray(nav.position)
    error = np.concatenate(
        [
            np.asarray(rotations.log(jnp.asarray(turned))),
            truth.gyroscope_bias[last] - np.asarray(nav.gyroscope_bias),
            position,
            truth.motion.velocity[last] - np.asarray(nav.velocity),
            truth.accelerometer_bias[last] - np.asarray(nav.accelerometer_bias),
        ]
    )
    return error, np.asarray(covariance.dense(state.P))


@jax.jit
def _run(params: Any, inputs: Any) -> Any:
    state = IEZ.start(params, None, inputs.opening)
    return filtering.scan(IEZ, params, None, inputs.samples, state, lambda o: o.status)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=40)
    parser.add_argument("--rate", type=float, default=100.0, help="Hz")
    parser.add_argument("--out", default="out")
    args = parser.parse_args()
    out = folder(args.out)
    worlds = {
        label: [simulate(walked(args.rate, sensor), seed) for seed in range(args.walks)]
        for label, sensor in (("real unit", UNIT), ("ideal unit", "perfect"))
    }
    rows: list[dict[str, Any]] = []
    with double_precision():
        published = IEZ.defaults()
        known = parameters.replace(published, sheet())
        for label, params, unit in (
            ("published", published, "real unit"),
            ("sheet", known, "real unit"),
            ("sheet", known, "ideal unit"),
        ):
            found = [errors(made, params) for made in worlds[unit]]
            for part, which in PARTS.items():
                nees = np.array([e[which] @ np.linalg.solve(P[which, which], e[which]) for e, P in found])
                low, high = chi2.ppf([0.025, 0.975], 3 * len(found)) / len(found)
                row = {
                    "filter": label,
                    "unit": unit,
                    "part": part,
                    "mean_nees": float(nees.mean()),
                    "low": float(low),
                    "high": float(high),
                    "rms_error": float(np.sqrt(np.mean([e[which] @ e[which] for e, _ in found]))),
                }
                rows.append(row)
                print("  ".join(f"{v:.4g}" if isinstance(v, float) else f"{v:18}" for v in row.values()))
    write_table(out / "honesty.csv", {key: [row[key] for row in rows] for key in rows[0]})


if __name__ == "__main__":
    pedjax.configure()
    main()
