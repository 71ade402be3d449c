"""Phones in trouser pockets: the truth is the phone's own, and what is constant is no heading error."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.munoz_diaz import pockets


@pytest.fixture(scope="module")
def trials() -> list[pockets.Trial]:
    folder = os.environ.get("PEDJAX_DATA")
    if not folder:
        pytest.skip("PEDJAX_DATA does not name the folder of real recordings")
    if not (Path(folder) / pockets.FOLDER).is_dir():
        pytest.skip(f"no {pockets.FOLDER} in the folder that PEDJAX_DATA names")
    return pockets.load(Path(folder))


def known(trial: pockets.Trial) -> tuple[np.ndarray, np.ndarray]:
    rows = np.isfinite(trial.truth.quaternion).all(axis=1)
    attitude = Rotation.from_quat(trial.truth.quaternion[rows], scalar_first=True).as_matrix()
    return trial.truth.time[rows], attitude


def test_the_truth_is_brought_to_the_phone(trials):
    assert [trial.name for trial in trials] == [
        f"{s}_{kind}_{place}" for s in "ab" for kind in ("clean", "disturbed") for place in ("back", "front")
    ]
    for trial in trials:
        np.testing.assert_allclose(trial.hand @ trial.hand.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(trial.hand) == pytest.approx(1.0)
        assert 0.016 < trial.lag_s < 0.024
        after = pockets.residual(trial)
        assert after < 0.4  # rad/s
        assert after < pockets.residual(trial, trial.hand.T)
        assert after < 0.7 * pockets.residual(trial, trial.hand.T, -trial.lag_s)
        assert np.isfinite(trial.truth.quaternion).all(axis=1).mean() > 0.98
        again, lag = pockets.alignment(trial.sensor.gyroscope, trial.truth.time, trial.truth.quaternion)
        np.testing.assert_allclose(again, np.eye(3), atol=1e-4)
        assert abs(lag) < 1e-4


def test_attitudes_between_two_jumps_are_lost():
    angle = np.linspace(0, 3, 200)[:, None]
    quaternion = Rotation.from_rotvec(angle * [0, 0, 1.0]).as_quat(scalar_first=True)
    quaternion[20:50] = np.nan  # a wide gap is no jump
    flipped = quaternion.copy()
    flip = Rotation.from_euler("x", 60, degrees=True)
    away = Rotation.from_quat(quaternion[100:118], scalar_first=True) * flip
    flipped[100:118] = away.as_quat(scalar_first=True)
    found = pockets.without_flips(flipped)
    assert np.isnan(found[100:118]).all()
    found[100:118] = quaternion[100:118]
    np.testing.assert_array_equal(found, quaternion)


def test_constant_rotations_are_no_error(trials):
    left, right = Rotation.from_rotvec([[0.3, -0.2, 2.5], [0.1, 0.2, -0.3]]).as_matrix()
    for trial in trials[::3]:
        time, attitude = known(trial)
        found = pockets.errors(left @ attitude @ right, time, trial, 5.0)
        assert found.heading < 1e-3
        assert found.total < 1e-3


def about_up(angle: np.ndarray) -> Rotation:
    return Rotation.from_rotvec(np.radians(angle)[:, None] * [0, 0, 1.0])


def test_a_drift_of_the_heading_is_its_spread(trials):
    """5 deg/min, on a phone that only turns; on a walk the constant from the right takes a little of it."""
    for trial in trials[::3]:
        time = trial.truth.time
        quaternion = about_up(40 * time).as_quat(scalar_first=True)
        made = replace(trial.recording, truth=replace(trial.truth, quaternion=quaternion))
        for one, least in ((trial._replace(recording=made), 1.0), (trial, 0.97)):
            time, attitude = known(one)
            drift = 5.0 / 60 * time
            for start, first in ((0.0, one.truth.time[0]), (20.0, pockets.begin(one) + 20.0)):
                spread = drift[time >= first + 10.0].std()
                error = pockets.heading_error(about_up(drift).as_matrix() @ attitude, time, one, start)
                assert (least - 1e-4) * spread < error < (1 + 1e-4) * spread


def test_a_crop_keeps_its_stamps(trials):
    whole, cut = trials[0].recording, pockets.cropped(trials[0], 10.0)
    first = pockets.begin(trials[0]) + 10.0
    for stream in (cut.sensor("pocket").gyroscope, cut.sensor("pocket").magnetometer, cut.truth):
        assert first <= stream.time[0] < first + 0.03
    assert cut.truth.time[-1] == whole.truth.time[-1]


def test_strides_and_way_by_the_cameras(trials):
    for trial in trials:
        strides = pockets.strides_by_truth(trial)
        assert 80 <= len(strides) <= 115
        assert 0.95 < np.median(np.diff(strides)) < 1.4  # s
        assert 0.7 < pockets.distance_by_truth(trial) / (len(strides) - 1) < 1.2  # m, two steps


def test_vqf_has_a_prior_from_the_other_subject(trials):
    pytest.importorskip("vqf", reason="the package vqf is not installed")
    trial = trials[0]
    prior = pockets.prior_of(trials, trial.subject)
    assert np.degrees(np.abs(prior - pockets.bias(trial))).max() < 1.0
    time, attitude = pockets.vqf_attitude(trial.recording, clip=10.0, prior=prior)
    with_prior = pockets.errors(attitude, time, trial, 0.0)
    without = pockets.errors(*pockets.vqf_attitude(trial.recording)[::-1], trial, 0.0)
    assert with_prior.heading < 2.0 < without.heading
