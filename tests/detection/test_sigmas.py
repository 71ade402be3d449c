"""Sigmas of field detectors: found again in changes with known ones, and in the looks of made walks."""

import numpy as np
import pytest

from pedjax import parameters
from pedjax.detection import field_sigmas
from pedjax.detection.field import Windows, log_ratios, seen_windows
from pedjax.detection.sigmas import changes_in, fit_sigmas, labelled_sigmas
from pedjax.errors import InputError
from pedjax.systems import system

MA2018 = system("ma2018")
PARAMS = MA2018.defaults()
TRUE = {"sigma_heading": 0.067, "sigma_inclination": 0.054, "sigma_strength": 0.535}


def windows_of(steps, size):
    """Changes `(M,)` of each channel, each in every window of three that holds it."""
    slid = np.lib.stride_tricks.sliding_window_view(steps, 3, axis=1)
    return {name: sigma * np.moveaxis(slid[k], -1, 0) for k, (name, sigma) in enumerate(size.items())}


def far_off(found):
    return max(abs(found[name] / sigma - 1) for name, sigma in TRUE.items())


@pytest.mark.parametrize("keep", [0.8, 0.9, 0.99])
def test_gaussian_changes(keep):
    steps = np.random.default_rng(1).normal(size=(3, 4000))
    fit = fit_sigmas(windows_of(steps, TRUE), keep)
    assert fit.settled
    assert far_off(fit.sigma) < 0.05
    assert fit.used.mean() == pytest.approx(keep, abs=0.03)


@pytest.mark.parametrize("length", [1, 10])
def test_larger_changes_do_not_count(length):
    rng = np.random.default_rng(2)
    steps = rng.normal(size=(3, 4000))
    larger = np.repeat(rng.random(4000 // length) < 0.3, length)
    steps = steps * np.where(larger, 6.0, 1.0)
    fit = fit_sigmas(windows_of(steps, TRUE))
    assert far_off(fit.sigma) < 0.1
    clean = ~np.lib.stride_tricks.sliding_window_view(larger, 3).any(axis=1)
    assert clean[fit.used].mean() > 0.9
    assert far_off(labelled_sigmas(windows_of(steps, TRUE), clean)) < 0.05


def test_windows_that_are_not_finite_do_not_count():
    changes = windows_of(np.random.default_rng(3).normal(size=(3, 400)), TRUE)
    expected = fit_sigmas(changes)
    broken = {name: np.append(y, np.full((3, 1), np.nan), axis=1) for name, y in changes.items()}
    found = fit_sigmas(broken)
    assert found.sigma == expected.sigma
    np.testing.assert_array_equal(found.used, np.append(expected.used, False))
    with pytest.raises(InputError, match="no window of looks holds finite changes"):
        fit_sigmas({name: np.full_like(y, np.nan) for name, y in changes.items()})


def test_sigmas_stay_within_their_bounds():
    changes = {"sigma_strength": np.zeros((3, 50))}
    assert fit_sigmas(changes, bounds={"sigma_strength": (1e-4, 100.0)}).sigma == {"sigma_strength": 1e-4}


def some_windows(rng):
    """Windows of looks at a field that changes at random, while the foot turns at random."""
    field = np.array([2.0, 20.0, -40.0])[None, :, None] + rng.normal(size=(4, 3, 60))
    time = np.cumsum(rng.uniform(0.8, 1.5, (4, 60)), axis=0)
    return Windows(field, rng.normal(size=(4, 60)), time, np.zeros((4, 60)))


@pytest.mark.parametrize(
    "given",
    [
        {"detector": "ma"},
        {"detector": "ma", "ma.theta": "level", "ma.per": "second"},
        {"detector": "iqsf"},
        {"detector": "qsf", "qsf.per": "second"},
        {"detector": "qmd"},
    ],
)
def test_changes_are_those_the_detector_weighs(rng, given):
    windows, p = some_windows(rng), parameters.replace(PARAMS.field, given)
    own, statistic = getattr(p, p.detector), 0.0
    for name, changes in changes_in(p, windows).items():
        for y in np.split(changes, len(changes) // 3) / np.asarray(getattr(own, name)):
            y = np.abs(y) if getattr(own, "absolute", False) else y
            energy = getattr(own, "form", "mean") == "energy"
            statistic = statistic + ((y**2).sum(axis=0) if energy else y.sum(axis=0) ** 2) / 3
    expected = np.exp(log_ratios(p, windows)) * float(own.threshold)
    np.testing.assert_allclose(statistic, expected, rtol=1e-6, atol=1e-8)


def test_a_homogeneous_field_has_the_spread_of_its_looks(straight):
    seen = seen_windows(straight.recording, MA2018, PARAMS)
    found = field_sigmas(MA2018, PARAMS, [(straight.recording, straight.truth["foot"])], keep=0.99)
    looks = np.concatenate([seen.field[:-1, :, 0], seen.field[-1].T])
    assert len(looks) == found.windows[0] + 3
    north, west, up = looks[:, 1], -looks[:, 0], looks[:, 2]
    spread = {
        "sigma_heading": np.diff(np.unwrap(np.arctan2(west, north))),
        "sigma_inclination": np.diff(np.arctan2(-up, np.hypot(west, north))),
        "sigma_strength": np.diff(np.linalg.norm(looks, axis=1)),
    }
    for name, changes in spread.items():
        value = parameters.get(found.params, f"field.ma.{name}")
        assert value == pytest.approx(np.sqrt(np.mean(changes**2)), rel=0.15)  # less its outliers
        assert found.by_truth[name] == pytest.approx(np.sqrt(np.mean(changes**2)), rel=0.05)
    assert found.label.all()
    assert found.used[0] == found.fit.used.sum() > 0.9 * found.windows[0]


def test_refusals_and_warnings(straight, monkeypatch):
    def asked(recording, given=PARAMS, **options):
        return field_sigmas(MA2018, given, [(recording, None)], **options)

    with pytest.raises(InputError, match="'vector' has no sigmas of changes; choose one of ma, iqsf"):
        asked(straight.recording, detector="vector")
    with pytest.raises(InputError, match="keep 1 must lie between 0 and 1"):
        asked(straight.recording, keep=1)
    with pytest.raises(InputError, match="does not look at the field"):
        field_sigmas(system("iez"), system("iez").defaults(), [])
    rng = np.random.default_rng(4)
    monkeypatch.setattr("pedjax.detection.sigmas.seen_windows", lambda *a, **b: seen)
    seen = wild(rng, np.full(15, 0.05))
    with pytest.raises(InputError, match=r"straight:1: \d+ of 12 windows .* sigmas need 20; record a longer"):
        asked(straight.recording)
    seen = wild(rng, np.exp(rng.normal(size=3000) * 2))  # of every size
    found = asked(straight.recording)
    assert found.label is None
    assert not found.by_truth
    assert any("no clear quasi-static part" in line for line in found.warnings)
    seen = wild(rng, np.where(np.arange(1500) < 90, 0.05, 60 * rng.random(1500)))
    assert any("of all windows count as quasi-static" in line for line in asked(straight.recording).warnings)
    seen = wild(rng, np.zeros(100))
    assert sum("ends at its bound" in line for line in asked(straight.recording).warnings) == 3
    seen = wild(rng, np.full(200, 6.0))
    assert any("hardly quasi-static anywhere" in line for line in asked(straight.recording).warnings)


def wild(rng, sizes):
    """Windows of looks at a field that is off by so many µT at each look, one after the other."""
    field = np.array([0.0, 20.0, -40.0]) + rng.normal(size=(len(sizes), 3)) * sizes[:, None]
    slid = np.lib.stride_tricks.sliding_window_view(field, 4, axis=0)  # (K, 3, 4)
    flat = np.zeros((4, len(slid)))
    return Windows(np.moveaxis(slid, (2, 1), (0, 1)), flat, flat + np.arange(4.0)[:, None], flat)
