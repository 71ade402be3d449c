"""Sweeps: scores equal to single runs, whatever the blocks, neighbours, settings, devices and precision."""

import pickle
from dataclasses import replace

import jax
import numpy as np
import pytest

import pedjax
from pedjax import parameters, sweep
from pedjax.errors import InputError
from pedjax.evaluation.scores import told_with
from pedjax.runtime import double_precision, lane_count
from pedjax.sweeping import engine
from pedjax.system import Status
from pedjax.systems import SYSTEMS
from tests import tools
from tests.sweeping.processes import python

THRESHOLD, ZUPT = "stance.shoe.threshold", "updates.zero_velocity"
ERRORS = ("rms_2d_m", "mean_2d_m", "max_2d_m", "final_2d_m", "rms_3d_m")


@pytest.fixture(scope="module")
def walks(demos):
    return demos[:3]


def sets(count, seed=7):
    rng = np.random.default_rng(seed)
    return {THRESHOLD: 10 ** rng.uniform(6, 9.3, count), ZUPT: 10 ** rng.uniform(-2.5, -1, count)}


def row(values, n, **settings):
    return parameters.replace(tools.iez(), {k: float(v[n]) for k, v in values.items()} | settings)


def assert_equal_single_run(found, n, r, recording, params, alignment="yaw_translation"):
    track = pedjax.run(recording, params=params)
    score = pedjax.evaluate(track, recording, alignment)
    assert found.scores["armse_m"][n, r] == pytest.approx(score.armse_m, abs=1e-11)
    for name in ERRORS:
        assert found.scores[name][n, r] == pytest.approx(getattr(score, name), abs=1e-11), name
    assert found.gates["stance"][n, r] == pytest.approx(track.gates["stance"].weight.mean(), abs=1e-14)
    assert found.status[n, r] == track.status[-1] == 0
    assert found.healthy[n, r]


@pytest.fixture(scope="module")
def eleven(walks):
    """More sets than lanes, and no multiple of them."""
    return sets(11), sweep(walks, sets(11))


def test_scores_equal_single_runs(walks, eleven):
    values, found = eleven
    assert lane_count(np.dtype(float)) < 11 * len(walks)
    assert found.names == tuple(r.name for r in walks)
    for n in (0, 3, 7, 10):
        for r, recording in enumerate(walks):
            assert_equal_single_run(found, n, r, recording, row(values, n))


def test_best_goes_by_the_mean(eleven):
    _, found = eleven
    assert found.loss.shape == (11, 3)
    np.testing.assert_array_equal(found.mean, found.scores["armse_m"].mean(axis=1))
    assert found.mean[found.best] == found.mean.min()


def test_alignment_is_that_of_a_single_score(walks):
    values = sets(2)
    found = sweep(walks[2:3], values, alignment="none")
    assert_equal_single_run(found, 1, 0, walks[2], row(values, 1), "none")


def test_one_set(walks, eleven):
    values, whole = eleven
    found = sweep(walks, {path: v[:1] for path, v in values.items()})
    np.testing.assert_allclose(found.loss, whole.loss[:1], atol=1e-12)


def test_parts_do_not_matter(walks, eleven, monkeypatch):
    values, whole = eleven
    samples = sum(len(r.sensors["foot"].gyroscope.time) for r in walks)
    monkeypatch.setattr(engine, "_STEPS_IN_A_PART", 3 * samples)
    calls = []
    found = sweep(walks, values, progress=lambda *call: calls.append(call))
    assert calls == [(3, 11), (6, 11), (9, 11), (11, 11)]
    np.testing.assert_allclose(found.loss, whole.loss, atol=1e-12)


def test_recordings_that_do_not_fit_at_once_are_swept_in_shares(walks, eleven, monkeypatch):
    values, whole = eleven
    monkeypatch.setattr(engine, "_SAMPLES_AT_ONCE", 1)
    work = engine.job(walks[1:])
    assert len(engine._shares(work.walks)) == 2
    found = engine.Engine(work, 11).run({}, values)
    np.testing.assert_allclose(found["armse_m"], whole.loss[:, 1:], atol=1e-12)


def test_settings_equal_separate_sweeps(walks):
    values = sets(5)
    found = sweep(walks[2:3], values, settings={"stance.detector": ["shoe", "ared"]})
    assert found.settings["stance.detector"] == ["shoe"] * 5 + ["ared"] * 5
    for i, detector in enumerate(["shoe", "ared"]):
        params = tools.iez(stance__detector=detector)
        felt = {path: v for path, v in values.items() if not parameters.idle_because(params, path)}
        assert (THRESHOLD in felt) == (detector == "shoe")
        alone = sweep(walks[2:3], felt, params=params)
        np.testing.assert_array_equal(found.loss[5 * i : 5 * i + 5], alone.loss)
    assert_equal_single_run(found, 7, 0, walks[2], row(values, 2, **{"stance.detector": "ared"}))


def test_recordings_of_several_rates_are_swept_at_once(walks, minute_recording):
    slow = tools.crop(minute_recording, 12.0, "slow")
    values, settings = sets(3), {"stance.rule": ["any", "all"]}
    found = sweep([walks[2], slow, walks[2]], values, settings=settings)
    assert found.names == ("demo:2", "slow", "demo:2__2")
    alone = {r.name: sweep([r], values, settings=settings) for r in (walks[2], slow)}
    for r, name in enumerate(("demo:2", "slow", "demo:2")):
        one = alone[name]
        for column, scores in one.scores.items():
            np.testing.assert_allclose(found.scores[column][:, r], scores[:, 0], atol=1e-11, err_msg=column)
        np.testing.assert_allclose(found.gates["stance"][:, r], one.gates["stance"][:, 0], atol=1e-14)
        np.testing.assert_array_equal(found.status[:, r], one.status[:, 0])
    assert len(np.unique(found.loss[:, :2])) == 12  # sets, rules and recordings all matter


def test_a_run_that_diverges_spoils_no_neighbour(walks, eleven):
    """A noise whose square overflows, and no number at all."""
    path = "process.accelerometer"
    plain = np.full(11, float(parameters.get(tools.iez(), path)))
    clean = sweep(walks, {**eleven[0], path: plain})
    lost = np.isin(np.arange(11), (4, 6))
    values = plain.copy()
    values[lost] = 1e200, np.nan
    found = sweep(walks, {**eleven[0], path: values})
    np.testing.assert_array_equal(found.healthy, np.repeat(~lost[:, None], 3, axis=1))
    assert (found.status[lost] == Status.DIVERGED).all()
    assert set(found.scores) == {kind.column for kind in told_with("armse")}
    for name in found.scores:
        assert np.isnan(found.scores[name][lost]).all()
        np.testing.assert_array_equal(found.scores[name][~lost], clean.scores[name][~lost])
    assert np.isinf(found.mean[lost]).all()
    assert not lost[found.best]


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 20, 1000])
@pytest.mark.parametrize("recordings", [1, 3, 4])
def test_a_block_fills_the_lanes(demos, count, recordings):
    """Few sets share the lanes with columns of recordings; many have them to themselves."""
    work = engine.job(demos[:recordings])
    lanes = lane_count(work.dtype)
    columns = {}
    for n in (count, 1000):
        made, columns[n] = engine._shape_of_block(work, n)
        assert 1 <= columns[n] <= recordings
        assert made * columns[n] <= lanes
    if recordings == 1 or count >= 1000:
        assert columns[count] == 1
    assert columns[count] >= columns[1000]


def test_few_sets_on_several_recordings_use_the_spare_lanes(demos):
    shape = engine._shape_of_block(engine.job([demos[0]] * 4), 1)
    assert shape[1] == 4


def test_a_recording_of_about_the_same_length_compiles_nothing(demos):
    traces = []

    def step(p, site, state, sample):
        traces.append(1)
        return SYSTEMS["iez"].step(p, site, state, sample)

    counted = SYSTEMS["iez"]._replace(step=step)
    sweep([tools.crop(demos[1], 18.9)], sets(3), counted)
    once = len(traces)
    assert once
    sweep([tools.crop(demos[1], 18.6)], sets(3), counted)
    assert len(traces) == once


def test_double_precision_reaches_the_threads(walks):
    """In float32 by default; inside `double_precision` everything is float64, whatever thread runs it."""
    values = sets(4)
    with jax.enable_x64(False):
        single = engine.job(walks[2:3])
        assert single.dtype == np.float32
        low = sweep(walks[2:3], values)
        with double_precision():
            assert engine.job(walks[2:3]).dtype == np.float64
            high = sweep(walks[2:3], values)
    assert low.loss.dtype == np.float32
    assert high.loss.dtype == np.float64
    np.testing.assert_array_equal(high.loss, sweep(walks[2:3], values).loss)
    assert 0 < np.abs(high.loss - low.loss).max() < 1e-3


def test_a_job_keeps_its_precision(walks):
    work = engine.job(walks[2:3])
    with jax.enable_x64(False):
        found = engine.Engine(work, 4).run({}, sets(4))
    assert found["armse_m"].dtype == np.float64


DEVICES = """
import pickle, sys, jax, numpy as np, pedjax
count, walks, target = int(sys.argv[1]), sys.argv[2], sys.argv[3]
pedjax.configure(devices=count, precision="float64")
recordings, values = pickle.load(open(walks, "rb"))
assert len(jax.devices()) == count
for n in range(1, count + 1) if count == 1 else range(2, count + 1):
    found = pedjax.sweep(recordings, values, devices=jax.devices()[:n])
    np.savez(f"{target}{n}.npz", **found.scores, status=found.status, stance=found.gates["stance"])
"""


@pytest.mark.slow
def test_the_number_of_devices_changes_no_bit(walks, tmp_path):
    """One, two and three devices; 43 sets leave the last block and the last device short."""
    values = sets(43)
    with (tmp_path / "walks").open("wb") as file:
        pickle.dump((walks[:2], values), file)
    for count in (1, 3):
        python(DEVICES, count, tmp_path / "walks", tmp_path / "d")
    one, *others = (np.load(tmp_path / f"d{n}.npz") for n in (1, 2, 3))
    assert one["armse_m"].shape == (43, 2)
    for other in others:
        for name in one.files:
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)


WITHOUT = """
import pickle, sys, numpy as np, pedjax
assert not pedjax.configure(precision="float64", devices=1).fast
recordings, values = pickle.load(open(sys.argv[1], "rb"))
np.save(sys.argv[2], pedjax.sweep(recordings, values).loss)
"""


@pytest.mark.slow
def test_without_the_options_the_scores_are_the_same(walks, eleven, tmp_path):
    values, found = eleven
    with (tmp_path / "walks").open("wb") as file:
        pickle.dump((walks, values), file)
    python(WITHOUT, tmp_path / "walks", tmp_path / "loss.npy", PEDJAX_FAST=0)
    np.testing.assert_allclose(np.load(tmp_path / "loss.npy"), found.loss, atol=1e-9)


def test_recordings_of_one_name_are_told_apart(walks):
    assert engine.job([walks[2], walks[2]]).names == ("demo:2", "demo:2__2")


def test_parts_depend_on_the_recordings_alone(walks, monkeypatch):
    work = engine.job(walks)
    assert work.samples == sum(len(w.imu.time) for w in work.walks)
    assert work.part % 64 == 0
    monkeypatch.setattr(engine, "_STEPS_IN_A_PART", 1)
    assert work.part == 1


@pytest.mark.parametrize(
    ("values", "changes", "message"),
    [
        ({"gravity": np.ones(2), ZUPT: np.ones(3)}, {}, "equally many values"),
        ({}, {}, "equally many values"),
        (sets(2), {"loss": "rms_2"}, "loss 'rms_2' is unknown; did you mean 'rms_2d'"),
        (sets(2), {"alignment": "yow"}, "alignment 'yow' is unknown; did you mean 'yaw'"),
        (sets(2), {"settings": {"stance.rule": ["anny"]}}, "did you mean 'any'"),
        (sets(2), {"system": "izz"}, "system 'izz' is unknown"),
        (sets(2), {"sensor": "hip"}, "no sensor 'hip'"),
    ],
)
def test_wrong_sweeps_are_refused(walks, values, changes, message):
    with pytest.raises(InputError, match=message):
        sweep(walks[2:3], values, **changes)


def test_recordings_without_points_are_refused(walks):
    with pytest.raises(InputError, match="at least two landmarks"):
        sweep([replace(walks[0], landmarks=None, truth=None)], sets(2))


def test_what_has_no_effect_under_any_settings_is_refused(walks):
    with pytest.raises(
        InputError, match=r"'stance\.shoe\.threshold' has no effect: stance\.detector is 'ared'"
    ):
        sweep(walks[2:3], sets(2), params=tools.iez(stance__detector="ared"))
    with pytest.raises(InputError, match=r"'gate\.follow' has no effect: gate\.kind is 'fixed'"):
        sweep(walks[2:3], {"gate.follow": np.zeros(2)}, settings={"stance.rule": ["any", "all"]})


@pytest.mark.parametrize("path", ["gravty", "gate.kind"])
def test_unknown_paths_are_refused(walks, path):
    with pytest.raises(InputError, match=path):
        sweep(walks[2:3], {path: np.ones(3)})


def test_no_set_at_all_is_refused(walks):
    with pytest.raises(InputError):
        sweep(walks[2:3], {"gravity": np.zeros(0)})


def test_a_window_longer_than_the_recording_is_refused_before_anything_runs(walks):
    calls = []
    settings = {"stance.shoe.window_s": [0.025, 100.0]}
    with pytest.raises(InputError, match=r"stance.shoe.window_s asks for at least 200 s"):
        sweep(walks[2:3], sets(2), settings=settings, progress=lambda *call: calls.append(call))
    assert not calls
