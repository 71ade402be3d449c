"""ROC against counting at every threshold."""

from dataclasses import replace

import numpy as np
import pytest

import pedjax
from pedjax.detection import roc
from pedjax.detection.stance import labelled, still_labels
from pedjax.detectors.stance import DETECTORS
from pedjax.recording import Truth, inertial
from tests import tools
from tests.reference import evaluation as oracle


@pytest.fixture(params=["distinct", "ties", "missing"])
def sample(request, rng):
    still = rng.random(200) < 0.4
    statistic = rng.normal(size=200) + 1.2 * ~still
    if request.param == "ties":
        statistic = np.round(statistic)
    if request.param == "missing":
        statistic[:7] = np.nan
        statistic[7:12] = np.inf
    return statistic, still


def test_curve_and_area_equal_counting(sample):
    statistic, still = sample
    found, expected = roc(statistic, still), oracle.roc(statistic, still)
    assert found.auc == pytest.approx(expected["auc"], abs=1e-12)
    for threshold, detected, alarm in zip(
        found.threshold, found.p_detection, found.p_false_alarm, strict=True
    ):
        below = np.where(np.isnan(statistic), np.inf, statistic) < threshold
        if np.isfinite(threshold):
            assert detected == pytest.approx((below & still).sum() / still.sum())
            assert alarm == pytest.approx((below & ~still).sum() / (~still).sum())
    assert found.p_detection[-1] == found.p_false_alarm[-1] == 1.0


def test_area_is_the_probability_of_the_right_order(sample):
    statistic, still = sample
    values = np.where(np.isnan(statistic), np.inf, statistic)
    a, b = values[still][:, None], values[~still][None]
    assert roc(statistic, still).auc == pytest.approx(np.mean((a < b) + 0.5 * (a == b)))


def test_operating_points():
    statistic = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    still = np.array([True, True, False, True, False, False])
    found = roc(statistic, still)
    at = found.at_false_alarm(0.34)
    assert 4.0 < at < 5.0
    assert ((statistic < at) & ~still).sum() / 3 <= 0.34
    assert 4.0 < found.at_detection(1.0) < 5.0
    assert 1.0 < found.at_detection(0.3) < 2.0


def test_operating_point_never_exceeds_its_false_alarm():
    """Where already the lowest value of the statistic is a moving sample, no alarm is allowed for."""
    found = roc(np.array([0.0, 1.0, 2.0, 3.0]), np.array([False, True, True, False]))
    threshold = found.at_false_alarm(0.1)
    assert not (np.array([0.0]) < threshold).any()


@pytest.mark.parametrize("still", [np.ones(5, bool), np.zeros(5, bool)])
def test_one_kind_of_label_is_refused(still):
    with pytest.raises(ValueError, match="both still and moving"):
        roc(np.arange(5.0), still)


def test_shapes_must_fit():
    with pytest.raises(ValueError, match="must both be"):
        roc(np.arange(5.0), np.ones(4, bool))


def test_detectors_separate_stance_from_swing():
    recording = pedjax.read("demo:4")  # a stroll: a brisk foot is hardly still, and EPS and AMVD say so
    imu = inertial(recording)
    labels = still_labels(recording, imu, below=0.1)
    assert labels.known.all()
    assert 0.1 < labels.still.mean() < 0.9
    found = labelled(tools.iez(), list(DETECTORS), [imu], [labels])
    for detector in DETECTORS:
        assert roc(found.statistic[detector][0], found.label[0]).auc > 0.9, detector


def test_labels_need_truth(minute_recording):

    with pytest.raises(pedjax.InputError, match="needs dense truth"):
        still_labels(replace(minute_recording, truth=None), inertial(minute_recording))


def test_samples_without_truth_are_not_counted():
    recording = pedjax.read("demo:1")
    truth = recording.truth
    assert truth is not None
    late = replace(recording, truth=Truth(truth.time[2000:], truth.position[2000:]))
    imu = inertial(late)
    labels = still_labels(late, imu)
    assert not labels.known[:1990].any()
    assert labels.known[2010:].all()
