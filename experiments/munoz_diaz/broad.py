"""A second judge: the pocket's filter on BROAD's hand-held trials, with parameters that never saw one.

    python -m experiments.munoz_diaz.broad [DATA] [--out DIR]

DATA is a folder with `broad/` (default: the environment's PEDJAX_DATA). Two undisturbed trials, one with a
magnet in the room, two with one on the sensor. Heading errors from ten seconds after the start on, the best
constant taken off. The field of the place is the first second's. VQF runs as it comes.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

import pedjax
from experiments.munoz_diaz.phones import OTHER, WAYS
from pedjax import config, parameters
from pedjax.output import folder, write_table
from pedjax.runtime import default_cache

DROP_S = 10.0
PRESETS = tuple(f"pocket_{way}_{subject}" for way in WAYS for subject in OTHER)


def heading_error(recording: pedjax.Recording, time: np.ndarray, attitude: np.ndarray) -> float:
    """RMS in degrees."""
    truth = recording.truth
    assert truth is not None
    assert truth.quaternion is not None
    rows = np.isfinite(truth.quaternion).all(axis=1)
    rows &= (truth.time >= time[0] + DROP_S) & (truth.time <= time[-1])
    true = Rotation.from_quat(truth.quaternion[rows], scalar_first=True)
    turn = (Slerp(time, Rotation.from_matrix(attitude))(truth.time[rows]) * true.inv()).as_matrix()
    away = np.exp(1j * np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1]))
    error = np.angle(away / np.mean(away))
    return float(np.degrees(np.sqrt(np.mean(error**2))))


def by_vqf(recording: pedjax.Recording) -> float:
    """Of VQF with the magnetometer."""
    import vqf

    imu = pedjax.inertial(recording, "hand", clock="resample")
    signals = (imu.angular_rate, imu.specific_force, imu.magnetic_field)
    assert imu.magnetic_field is not None
    found = vqf.VQF(float(imu.dt[1])).updateBatch(*(np.ascontiguousarray(x) for x in signals))
    attitude = Rotation.from_quat(found["quat9D"], scalar_first=True).as_matrix()
    return heading_error(recording, imu.time, attitude)


def by_pocket(recording: pedjax.Recording, preset: str, **changes: Any) -> float:
    """Of the pocket's filter."""
    params = config.resolve(config.load(preset))[1]
    params = parameters.replace(params, {"reference.state.start": "first", **changes})
    track = pedjax.run(recording, "pocket", params, sensor="hand")
    return heading_error(recording, track.time, track.attitude)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", nargs="?", type=Path, default=os.environ.get("PEDJAX_DATA"))
    parser.add_argument("--out", type=Path, default=Path("out/phones"))
    args = parser.parse_args()
    if args.data is None:
        parser.error("name the folder with the recordings, or set PEDJAX_DATA to it")
    pedjax.configure(precision="float64", cache=default_cache())
    out = folder(args.out)
    lines = []
    for path in sorted((Path(args.data) / "broad").glob("*.mat")):
        recording = pedjax.read(path)
        line = {"trial": path.stem, "vqf_deg": by_vqf(recording)}
        line |= {f"{name}_deg": by_pocket(recording, name) for name in PRESETS}
        print(*(f"{x:.2f}" if isinstance(x, float) else x for x in line.values()), sep="  ", flush=True)
        lines.append(line)
    write_table(out / "phones_broad.csv", {key: [line[key] for line in lines] for key in lines[0]})


if __name__ == "__main__":
    main()
