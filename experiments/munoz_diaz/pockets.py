"""Smartphones in trouser pockets under cameras: the recordings of Michel et al., and VQF's heading on them.

    python -m experiments.munoz_diaz.pockets [DATA]

DATA is a folder with `pocket_mocap/` (default: the environment's PEDJAX_DATA). Eight walks of two minutes in
a room of 5 by 5 m: two subjects, front and back pocket, clean and with magnets held near the phone. Told are
how the truth was brought to the phone, the gyroscope's bias, strides and distance, and the heading errors of
VQF (the package `vqf`) for several starts. Only VQF's clip of the bias is not as it comes: the bias about
the phone's z axis is 3.6 to 4.4 deg/s here, and it clips at 2. Differences of a few tenths of a degree are
chance: starts half a second apart differ by as much.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import butter, find_peaks, sosfiltfilt
from scipy.spatial.transform import Rotation, Slerp

import pedjax
from pedjax.recording import interpolate
from pedjax.streams import Sensor, Stream, Truth

FOLDER = "pocket_mocap"
STARTS = (0.0, 5.0, 10.0, 15.0, 20.0)
PRIOR_SIGMA = np.radians(0.5)
_UP = np.array([0.0, 0.0, 1.0])
_JUMP = 0.4  # rad in one 60th of a second, five times what the gyroscopes ever saw
_MOST_LAG = 0.06  # s to either side; within, the rates agree the better the nearer the lag


class Trial(NamedTuple):
    """A walk, its truth already turned to the phone's axes and put on the sensors' clock.

    `hand` turned the axes of the phone into those of the markers, `lag_s` is by how much the sensors' stamps
    come after the truth's.
    """

    name: str
    subject: str
    disturbed: bool
    place: str
    recording: pedjax.Recording
    hand: np.ndarray
    lag_s: float

    @property
    def sensor(self) -> Sensor:
        return self.recording.sensor("pocket")

    @property
    def truth(self) -> Truth:
        assert self.recording.truth is not None
        return self.recording.truth


class Errors(NamedTuple):
    """RMS in degrees, the best constant rotations removed: about up, and of the whole angle."""

    heading: float
    total: float


def load(data: Path) -> list[Trial]:
    """The eight walks in the folder `pocket_mocap` of `data`, sensor "pocket".

    The magnetometer is the raw stream less the phone's own offset, one constant per walk: raw less calibrated
    is the same number, (60 to 83, -76 to -53, 408 to 413) microtesla, in 99.3 % and more of each walk's
    samples; it jumps only within the last second of two walks, and then by 2 and 12 microtesla.
    """
    files = sorted((data / FOLDER).glob("subject_*_pocket.npz"))
    if not files:
        raise FileNotFoundError(f"{data / FOLDER}: no subject_*_pocket.npz in it")
    return [_read(file) for file in files]


def _read(file: Path) -> Trial:
    _, subject, kind, place, _ = file.stem.split("_")
    with np.load(file) as held:
        table = {key: held[key].astype(float) for key in held.files}
    accelerometer, gyroscope, raw, calibrated = (
        Stream(table[f"{kind}_time"], table[kind]) for kind in ("accel", "gyro", "mag_raw", "mag_android")
    )
    offset = np.median(offsets(raw, calibrated), axis=0)
    sensor = Sensor(accelerometer, gyroscope, Stream(raw.time, raw.values - offset))
    time, quaternion = table["truth_time"], without_flips(table["truth_quaternion_wxyz"])
    hand, lag = alignment(gyroscope, time, quaternion)
    truth = Truth(time + lag, 1e-3 * table["truth_position_mm"], turned(quaternion, hand), "pocket")
    name = f"{subject}_{kind}_{place}"
    recording = pedjax.Recording(name, {"pocket": sensor}, truth=truth, clock="resample", format="pocket")
    return Trial(name, subject, kind == "disturbed", place, recording, hand, lag)


def offsets(raw: Stream, calibrated: Stream) -> np.ndarray:
    """Raw less calibrated `(K, 3)` at the times of the calibrated samples that lie within the raw ones."""
    inside = (calibrated.time >= raw.time[0]) & (calibrated.time <= raw.time[-1])
    return interpolate(raw, calibrated.time[inside]) - calibrated.values[inside]


def without_flips(quaternion: np.ndarray) -> np.ndarray:
    """Attitudes with NaN from one jump to the next, where the cameras took markers for one another.

    A jump is more than `_JUMP` between neighbours. Only `a_disturbed_front` has them: it flips by 60 degrees
    for 18 samples (24.4 to 24.7 s), which alone would add 3 degrees to an RMS of two minutes.
    """
    known = np.flatnonzero(np.isfinite(quaternion).all(axis=1))
    attitude = Rotation.from_quat(quaternion[known], scalar_first=True)
    jumps = (attitude[:-1].inv() * attitude[1:]).magnitude() > _JUMP
    jumps &= np.diff(known) == 1
    out = quaternion.copy()
    out[known[1:][np.cumsum(jumps) % 2 == 1]] = np.nan
    return out


def turned(quaternion: np.ndarray, hand: np.ndarray) -> np.ndarray:
    """Attitudes `(T, 4)` times a constant rotation from the right; those not known stay so."""
    known = np.isfinite(quaternion).all(axis=1)
    out = np.full_like(quaternion, np.nan)
    product = Rotation.from_quat(quaternion[known], scalar_first=True) * Rotation.from_matrix(hand)
    out[known] = product.as_quat(scalar_first=True)
    return out


def rates(
    gyroscope: Stream, time: np.ndarray, quaternion: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Over each step of the truth whose two ends are known: where it begins, the gyroscope's mean rate, and
    the truth's rate in its own axes, `(K, 3)`."""
    known = np.isfinite(quaternion).all(axis=1)
    first = np.flatnonzero(known[:-1] & known[1:])
    step = np.diff(time)[first, None]
    turned_by = cumulative_trapezoid(gyroscope.values, gyroscope.time, axis=0, initial=0.0)
    angle = Stream(gyroscope.time, turned_by)
    measured = (interpolate(angle, time[first + 1]) - interpolate(angle, time[first])) / step
    before, after = (Rotation.from_quat(quaternion[rows], scalar_first=True) for rows in (first, first + 1))
    return first, measured, (before.inv() * after).as_rotvec() / step


def alignment(gyroscope: Stream, time: np.ndarray, quaternion: np.ndarray) -> tuple[np.ndarray, float]:
    """The rotation of the phone's axes to the truth's, and the seconds to add to the truth's stamps: those
    with which the rates agree best, a constant bias apart (Wahba's problem for each lag)."""

    def fit(lag: float) -> tuple[np.ndarray, float]:
        _, measured, true = rates(gyroscope, time + lag, quaternion)
        measured, true = measured - measured.mean(axis=0), true - true.mean(axis=0)
        hand = nearest_rotation(true.T @ measured)
        return hand, float(np.mean(np.sum((true - measured @ hand.T) ** 2, axis=1)))

    found = minimize_scalar(lambda lag: fit(lag)[1], bounds=(-_MOST_LAG, _MOST_LAG), options={"xatol": 1e-5})
    return fit(found.x)[0], float(found.x)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation R with the greatest tr(Rᵀ M)."""
    u, _, v = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def bias(trial: Trial) -> np.ndarray:
    """The gyroscope's bias in rad/s, phone's axes: the mean over all steps of the truth whose ends are known
    of the gyroscope's mean rate less the truth's."""
    _, measured, true = rates(trial.sensor.gyroscope, trial.truth.time, _quaternion(trial))
    return np.mean(measured - true, axis=0)


def about_vertical(trial: Trial, vector: np.ndarray) -> float:
    """Mean over the walk of the upward part of a vector that is constant in the phone's axes."""
    quaternion = _quaternion(trial)
    known = np.isfinite(quaternion).all(axis=1)
    return float(np.mean(Rotation.from_quat(quaternion[known], scalar_first=True).apply(vector)[:, 2]))


def residual(trial: Trial, hand: np.ndarray | None = None, lag_s: float = 0.0) -> float:
    """RMS in rad/s of the gyroscope less bias and truth's rate, with the truth turned and shifted as told."""
    quaternion = turned(_quaternion(trial), np.eye(3) if hand is None else hand)
    _, measured, true = rates(trial.sensor.gyroscope, trial.truth.time + lag_s, quaternion)
    away = measured - true
    return float(np.sqrt(np.mean(np.sum((away - away.mean(axis=0)) ** 2, axis=1))))


def begin(trial: Trial) -> float:
    """The stamp from which on all three instruments run (0.4 to 0.6 s)."""
    sensor = trial.sensor
    assert sensor.magnetometer is not None
    return max(float(s.time[0]) for s in (sensor.accelerometer, sensor.gyroscope, sensor.magnetometer))


def cropped(trial: Trial, start_s: float) -> pedjax.Recording:
    """The walk without its first seconds, counted from when all instruments run; stamps stay as they are."""
    first = begin(trial) + start_s

    def late(stream: Stream) -> Stream:
        return Stream(stream.time[stream.time >= first], stream.values[stream.time >= first])

    sensor, truth = trial.sensor, trial.truth
    assert sensor.magnetometer is not None
    rows = truth.time >= first
    return replace(
        trial.recording,
        sensors={
            "pocket": Sensor(late(sensor.accelerometer), late(sensor.gyroscope), late(sensor.magnetometer))
        },
        truth=Truth(truth.time[rows], truth.position[rows], _quaternion(trial)[rows], "pocket"),
    )


def errors(
    attitude: np.ndarray, time: np.ndarray, trial: Trial, start_s: float, drop_s: float = 10.0
) -> Errors:
    """Errors of attitudes `(T, 3, 3)` at `time`, the truth's first `drop_s` after the start left out.

    The start is that of `cropped(trial, start_s)`, or the first stamp of the truth if that is later, as at 0.
    Constant rotations from the left (the room knows no north) and from the right are removed: those with the
    least mean square chord.
    """
    quaternion = _quaternion(trial)
    first = max(begin(trial) + start_s, trial.truth.time[0]) + drop_s
    rows = np.isfinite(quaternion).all(axis=1)
    rows &= (trial.truth.time >= max(first, time[0])) & (trial.truth.time <= time[-1])
    true = Rotation.from_quat(quaternion[rows], scalar_first=True).as_matrix()
    found = Slerp(time, Rotation.from_matrix(attitude))(trial.truth.time[rows]).as_matrix()
    turn = _matched(found, true) @ true.swapaxes(1, 2)
    up = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    whole = Rotation.from_matrix(turn).magnitude()
    return Errors(*(float(np.degrees(np.sqrt(np.mean(angle**2)))) for angle in (up, whole)))


def heading_error(
    attitude: np.ndarray, time: np.ndarray, trial: Trial, start_s: float, drop_s: float = 10.0
) -> float:
    """The heading's part of `errors`, degrees."""
    return errors(attitude, time, trial, start_s, drop_s).heading


def _matched(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Attitudes with the best constant rotations applied, by turns from the left and from the right."""
    pairs = np.einsum("kij,klm->ijlm", true, found)
    right = np.eye(3)
    for _ in range(10_000):
        left = nearest_rotation(np.einsum("ijlm,mj->il", pairs, right))
        again = nearest_rotation(np.einsum("ijlm,il->mj", pairs, left))
        moved = np.abs(again - right).max()
        right = again
        if moved < 1e-11:
            break
    return left @ found @ right


def strides_by_truth(trial: Trial, prominence_deg: float = 8.0) -> np.ndarray:
    """Times of the strides by the cameras: peaks of that prominence of the swing about the lateral axis.

    The phone's rate, levelled and seen in axes that follow its heading, varies most about one direction: the
    lateral axis, taken to the walker's right, so that a peak is the thigh foremost. Its integral, within 0.3
    to 5 Hz without delay, is the swing. What the cameras lost is turned through evenly.
    """
    truth, quaternion = trial.truth, _quaternion(trial)
    known = np.isfinite(quaternion).all(axis=1)
    inside = (truth.time >= truth.time[known][0]) & (truth.time <= truth.time[known][-1])
    time = truth.time[inside]
    attitude = Slerp(truth.time[known], Rotation.from_quat(quaternion[known], scalar_first=True))(time)
    step = np.diff(time)[:, None]
    rate = (attitude[1:] * attitude[:-1].inv()).as_rotvec() / step
    # the heading is that of the phone as it hangs in the mean, where it is defined best
    hang, _ = Rotation.align_vectors(_UP, attitude.inv().apply(_UP).mean(axis=0))
    turn = (attitude * hang.inv()).as_matrix()[:-1]
    heading = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    position = _followed(truth)[inside]
    swing_rate = _turned_back(rate, heading)
    forward = _turned_back(np.diff(position, axis=0) / step, heading).mean(axis=0)
    axis = np.linalg.eigh(np.cov(swing_rate.T))[1][:, -1]
    axis *= np.sign(forward[1] * axis[0] - forward[0] * axis[1])  # to the right of where the walk goes
    angle = cumulative_trapezoid(swing_rate @ axis, dx=float(step.mean()), initial=0.0)
    band = butter(2, (0.3, 5.0), "bandpass", fs=1 / float(step.mean()), output="sos")
    swing = np.degrees(sosfiltfilt(band, angle))
    peaks, _ = find_peaks(swing, prominence=prominence_deg)
    return time[peaks] + 0.5 * float(step.mean())


def _turned_back(vectors: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """The horizontal parts `(T, 2)` in axes that follow the heading."""
    x, y = vectors[:, 0], vectors[:, 1]
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=1)


def _followed(truth: Truth, window_s: float = 1.0) -> np.ndarray:
    """The horizontal position without the leg's swing `(T, 2)`: a running mean over a second, about one
    stride; straight lines over what the cameras lost."""
    known = np.isfinite(truth.position).all(axis=1)
    straight = interpolate(Stream(truth.time[known], truth.position[known, :2]), truth.time)
    step = float(np.median(np.diff(truth.time)))
    return uniform_filter1d(straight, round(window_s / step), axis=0, mode="nearest")


def distance_by_truth(trial: Trial) -> float:
    """Metres walked between the first and the last stride: the length of the horizontal way of the cameras'
    positions, taken as running means over a second so that the phone's swing does not count."""
    strides = strides_by_truth(trial)
    rows = (trial.truth.time >= strides[0]) & (trial.truth.time <= strides[-1])
    return float(np.sum(np.linalg.norm(np.diff(_followed(trial.truth)[rows], axis=0), axis=1)))


def _quaternion(trial: Trial) -> np.ndarray:
    assert trial.truth.quaternion is not None
    return trial.truth.quaternion


def prior_of(trials: Sequence[Trial], subject: str) -> np.ndarray:
    """Mean bias of the walks of the other subject, rad/s."""
    return np.mean([bias(trial) for trial in trials if trial.subject != subject], axis=0)


VQF: Mapping[str, Mapping[str, Any]] = {
    "VQF": {},
    "VQF, clip 10": {"clip": 10.0},
    "VQF, clip 10, prior": {"clip": 10.0, "prior": True},
    "offline VQF": {"offline": True},
    "offline VQF, clip 10": {"offline": True, "clip": 10.0},
}


def vqf_attitude(
    recording: pedjax.Recording,
    clip: float | None = None,
    prior: np.ndarray | None = None,
    offline: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Times `(T,)` and attitudes `(T, 3, 3)` of VQF with the magnetometer, all streams on one even clock.

    `clip` of the bias in deg/s (2 if not given), `prior` mean of the bias in rad/s, of `PRIOR_SIGMA`.
    """
    import vqf

    imu = pedjax.inertial(recording, "pocket", clock="resample")
    assert imu.magnetic_field is not None
    rows = np.isfinite(imu.magnetic_field).all(axis=1)
    signals = [
        np.ascontiguousarray(x[rows]) for x in (imu.angular_rate, imu.specific_force, imu.magnetic_field)
    ]
    step, changed = float(imu.dt[1]), {} if clip is None else {"biasClip": clip}
    if offline:
        found = vqf.offlineVQF(*signals, step, changed)
    else:
        causal = vqf.VQF(step, **changed)
        if prior is not None:
            causal.setBiasEstimate(np.ascontiguousarray(prior), PRIOR_SIGMA)
        found = causal.updateBatch(*signals)
    return imu.time[rows], Rotation.from_quat(found["quat9D"], scalar_first=True).as_matrix()


def baseline(trials: Sequence[Trial], starts: Sequence[float] = STARTS) -> dict[str, np.ndarray]:
    """Heading and total errors in degrees of each variant of VQF, `(trials, starts, 2)`."""
    priors = {subject: prior_of(trials, subject) for subject in {trial.subject for trial in trials}}
    out = {}
    for name, settings in VQF.items():
        table = np.empty((len(trials), len(starts), 2))
        for row, trial in zip(table, trials, strict=True):
            given = {**settings, "prior": priors[trial.subject] if settings.get("prior") else None}
            for column, start in enumerate(starts):
                time, attitude = vqf_attitude(cropped(trial, start), **given)
                row[column] = errors(attitude, time, trial, start)
        out[name] = table
    return out


def describe(trials: Sequence[Trial]) -> None:
    """How the truth was brought to the phone, biases, strides and distances."""
    for trial in trials:
        turn = np.degrees(Rotation.from_matrix(trial.hand).magnitude())
        before, after = residual(trial, trial.hand.T, -trial.lag_s), residual(trial)
        x, y, z = np.degrees(bias(trial))
        vertical = np.degrees(about_vertical(trial, bias(trial)))
        counts = " ".join(str(len(strides_by_truth(trial, least))) for least in (5.0, 8.0, 12.0))
        print(
            f"{trial.name:18} hand {turn:.2f} deg, lag {1e3 * trial.lag_s:.1f} ms, rates apart by "
            f"{before:.3f}, then {after:.3f} rad/s; bias {x:5.2f} {y:5.2f} {z:5.2f}, about up "
            f"{vertical:5.2f} deg/s; strides at 5, 8, 12 deg {counts}; {distance_by_truth(trial):.1f} m"
        )


def tell(trials: Sequence[Trial], found: Mapping[str, np.ndarray], starts: Sequence[float] = STARTS) -> None:
    """Heading errors by walk and start, their means and the worst; total errors in the mean."""
    disturbed = np.array([trial.disturbed for trial in trials])
    for name, table in found.items():
        print(f"\n{name}: heading RMSE in degrees, starts at {' '.join(f'{s:g}' for s in starts)} s")
        heading = table[..., 0]
        for trial, row in zip(trials, heading, strict=True):
            print(f"  {trial.name:18}", *(f"{value:5.2f}" for value in row))
        for kind, some in (("clean", ~disturbed), ("disturbed", disturbed)):
            print(
                f"  {kind:18}", *(f"{value:5.2f}" for value in heading[some].mean(axis=0)),
                f"  mean {heading[some].mean():5.2f}, total {table[some, :, 1].mean():5.2f}",
            )  # fmt: skip
        print(f"  worst {heading.max():.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", nargs="?", type=Path, default=os.environ.get("PEDJAX_DATA"))
    args = parser.parse_args()
    if args.data is None:
        parser.error("name the folder with the recordings, or set PEDJAX_DATA to it")
    trials = load(Path(args.data))
    describe(trials)
    tell(trials, baseline(trials))


if __name__ == "__main__":
    main()
