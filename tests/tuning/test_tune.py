"""Tuning on short demo walks: a lower hard-gate loss, an honest account, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

import pedjax
from pedjax import parameters
from pedjax.errors import InputError
from pedjax.recording import Landmarks
from pedjax.tuning import TuneSettings, loop, tune
from tests import tools

NAMES = ("stance.shoe.threshold", "updates.zero_velocity")


def each_second(recording):
    truth = recording.truth
    return replace(recording, landmarks=Landmarks(truth.time[::200], truth.position[::200]))


@pytest.fixture(scope="module")
def walks(demos):
    return [each_second(tools.crop(r, 12.0)) for r in (demos[0], demos[1], demos[3])]


@pytest.fixture(scope="module")
def other(demos):
    return each_second(demos[2])


@pytest.fixture(scope="module")
def start():
    """Far from good: the foot is hardly ever found still."""
    return tools.iez(stance__shoe__threshold=2e6, updates__zero_velocity=0.2)


def settings(**changes):
    return replace(
        TuneSettings(NAMES, iterations=6, starts=2, check_every=3, grid=3, validation=0.34), **changes
    )


@pytest.fixture(scope="module", params=["forward", pytest.param("reverse", marks=pytest.mark.slow)])
def tuned(request, walks, other, start):
    calls = []
    found = tune(
        walks,
        settings(mode=request.param),
        params=start,
        held_back=[other],
        progress=lambda *a: calls.append(a),
    )
    return found, calls


def loss_of(track, recording):
    score = pedjax.evaluate(track, recording, "yaw_translation")
    return score.armse_m


def test_tuning_lowers_the_loss_and_reports_it(tuned, walks, other, start):
    found, _ = tuned
    assert set(found.values) == set(NAMES)
    before, after = (np.mean(list(x["tuned_on"].values())) for x in (found.before, found.after))
    assert after < 0.8 * before
    for report, params in ((found.before, start), (found.after, found.params)):
        for recording in walks:
            assert report["tuned_on"][recording.name] == pytest.approx(
                loss_of(pedjax.run(recording, params=params), recording), abs=1e-9
            )
        assert report["held_back"] == pytest.approx(
            {other.name: loss_of(pedjax.run(other, params=params), other)}, abs=1e-9
        )


def test_only_the_named_numbers_change(tuned, start):
    found, _ = tuned
    given, after = parameters.values(start), parameters.values(found.params)
    assert {n for n in given if after[n] != given[n]} <= set(NAMES)
    for name, value in found.values.items():
        spec = parameters.specs(start)[name]
        assert spec.low <= value <= spec.high
        assert after[name] == value


def test_history_and_runs_add_up(tuned):
    found, calls = tuned
    assert [row["iteration"] for row in found.history] == [-1, 0, 3, 6]
    assert [len(row["training"]) for row in found.history] == [1, 2, 2, 2]
    assert all(len(row["validation"]) == len(row["training"]) for row in found.history)
    assert found.runs["gradients"] == 2 * 6
    assert found.runs["hard"] == 1 + 2 * 3 + 2 * (2 * 3)  # judged, and the threshold's grid twice
    assert [c[:2] for c in calls] == [(0, 6), (3, 6), (6, 6)]
    best = [c[2] for c in calls]
    assert best == sorted(best, reverse=True)
    assert len(found.fingerprints) == 3


def test_the_winner_is_the_best_that_was_judged(tuned):
    found, calls = tuned
    share = 2 / 3
    judged = [
        share * t + (1 - share) * v
        for row in found.history
        for t, v in zip(row["training"], row["validation"], strict=True)
    ]
    assert calls[-1][2] == pytest.approx(min(judged), rel=1e-12)


def test_it_is_said_what_nobody_knows_and_what_got_worse(tuned):
    found, _ = tuned
    assert found.warnings == ()
    worse = replace(found, before=found.after, after=found.before)
    (doubt,) = worse.warnings
    assert "tune on more than 3, or fewer parameters than 2" in doubt
    alone = replace(found, before={"tuned_on": found.before["tuned_on"]})
    assert "nothing was held back" in alone.warnings[0]


def test_starts_lie_around_the_given_values(start):
    specs = {n: parameters.specs(start)[n] for n in NAMES}
    found = loop.starts(specs, start, settings(starts=400, spread=0.5))
    for name, spec in specs.items():
        given = float(spec.to_free(parameters.get(start, name)))
        assert found[name][0] == given
        assert np.mean(found[name]) == pytest.approx(given, abs=0.1)
        assert np.std(found[name]) == pytest.approx(0.5, abs=0.06)
    assert abs(np.corrcoef(*found.values())[0, 1]) < 0.2


@pytest.mark.parametrize("rule", ["any", pytest.param("all", marks=pytest.mark.slow)])
def test_recordings_of_several_rates_are_tuned_at_once(walks, other, start, minute_recording, rule):
    slow = [each_second(tools.crop(minute_recording, s, f"slow {s:g}")) for s in (10.0, 8.0)]
    params = parameters.replace(start, {"stance.rule": rule})
    few = settings(names=NAMES[:1], mode="forward", iterations=1, starts=1, validation=0.0)
    found = tune([slow[0], walks[0]], few, params=params, held_back=[other, slow[1]])
    assert list(found.before["tuned_on"]) == [slow[0].name, walks[0].name]
    assert list(found.before["held_back"]) == [other.name, slow[1].name]
    for report, at in ((found.before, params), (found.after, found.params)):
        for recording in (slow[0], walks[0], other, slow[1]):
            part = report["tuned_on"] | report["held_back"]
            own = loss_of(pedjax.run(recording, params=at), recording)
            assert part[recording.name] == pytest.approx(own, abs=1e-9), recording.name


@pytest.mark.slow
def test_recordings_of_one_name_are_each_reported(walks):
    same = [replace(r, name="walk") for r in walks[:2]]
    few = settings(names=("gravity",), mode="forward", iterations=1, starts=1, grid=0)
    assert len(tune(same, few).before["tuned_on"]) == 2


def test_overlap_is_refused_before_anything_runs(walks):
    renamed = replace(walks[1], name="somewhere/else.csv")
    with pytest.raises(InputError, match=r"somewhere/else.csv was tuned on"):
        tune(walks, settings(), held_back=[renamed])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"names": ()}, "no parameter to tune"),
        ({"names": ("stance.shoe.treshold",)}, "did you mean 'stance.shoe.threshold'"),
        ({"names": ("stance.detector",)}, "is a setting"),
        ({"loss": "mse"}, "loss 'mse' is unknown"),
        ({"alignment": "best"}, "alignment 'best' is unknown"),
        ({"mode": "sideways"}, "mode 'sideways' is unknown"),
        ({"iterations": 0}, "must lie between 1"),
        ({"starts": 0}, "must lie between 1"),
    ],
)
def test_wrong_settings_are_refused(walks, change, message):
    with pytest.raises(InputError, match=message):
        tune(walks, settings(**change))


def test_a_recording_without_landmarks_is_refused(walks):
    with pytest.raises(InputError, match="at least two landmarks"):
        tune([walks[0], replace(walks[1], landmarks=None, truth=None)], settings())


def test_walks_whose_landmarks_know_only_the_height_are_refused(walks):
    marks = walks[0].landmarks
    heights = replace(marks, position=np.where([True, True, False], np.nan, marks.position))
    with pytest.raises(InputError, match="known x and y"):
        tune([replace(walks[0], landmarks=heights)], settings())


@pytest.mark.parametrize("change", [{"learning_rate": float("nan")}, {"clip": 0.0}, {"seed": -1}])
def test_settings_out_of_range_are_refused(walks, change):
    with pytest.raises(InputError, match=next(iter(change))):
        tune(walks, settings(**change))


def test_one_name_may_be_a_plain_string():
    assert TuneSettings("gravity").names == ("gravity",)
