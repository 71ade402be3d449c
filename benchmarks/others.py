"""What we are measured against: a plain numpy loop, a hand-written kernel, another library."""

from __future__ import annotations

import re
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.cases import RATE, signals


def numpy_loop(length: int) -> float:
    """Samples/s of a plain numpy 15-state predict-and-update loop."""
    force, rate, dt = signals(length)
    F, P, Q = np.eye(15), np.eye(15) * 1e-4, np.eye(15) * 1e-8
    H, R = np.eye(15)[9:12], np.eye(3) * 1e-4
    v, p, C = np.zeros(3), np.zeros(3), np.eye(3)
    start = time.process_time()
    for k in range(length):
        w, step = rate[k], dt[k]
        W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) * step
        C = C @ (np.eye(3) + W + 0.5 * W @ W)
        f = C @ force[k]
        p = p + step * v
        v = v + step * (f - [0, 0, 9.8])
        F[0:3, 3:6], F[9:12, 12:15], F[6:9, 9:12] = -step * C, -step * C, step * np.eye(3)
        F[9:12, 0:3] = -step * np.array([[0, -f[2], f[1]], [f[2], 0, -f[0]], [-f[1], f[0], 0]])
        P = F @ P @ F.T + Q
        if k % 200 < 90:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x = K @ -v
            P = P - K @ H @ P
            v, p = v + x[9:12], p + x[6:9]
    return length / (time.process_time() - start)


def c_kernel(source: Path) -> dict[int, float]:
    """Steps/s on one core of a C program that takes its lanes as the macro L and prints its Msteps/s."""
    found = {}
    with tempfile.TemporaryDirectory() as place:
        for lanes in (8, 16):
            program = f"{place}/kernel{lanes}"
            subprocess.run(
                ["cc", "-O3", "-march=native", f"-DL={lanes}", str(source), "-o", program, "-lm"], check=True
            )
            runs = [
                subprocess.run([program, "20"], capture_output=True, text=True, check=True).stdout
                for _ in range(3)
            ]
            found[lanes] = max(1e6 * float(re.search(r"([\d.]+) Msteps", r).group(1)) for r in runs)  # type: ignore[union-attr]
    return found


def gaitmap_forward(length: int) -> float | None:
    """Samples/s of gaitmap's compiled nine-state filter, forward and backward; None where not installed."""
    try:
        import pandas as pd
        from gaitmap.trajectory_reconstruction import RtsKalman
    except ImportError:
        return None
    force, rate, _ = signals(length)
    data = pd.DataFrame(
        np.hstack([force, np.rad2deg(rate)]),
        columns=["acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"],
    )
    RtsKalman().estimate(data[:2000], sampling_rate_hz=RATE)
    start = time.process_time()
    RtsKalman().estimate(data, sampling_rate_hz=RATE)
    return length / (time.process_time() - start)
