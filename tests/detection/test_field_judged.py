"""Field detectors on labelled walks: what they are given, what is true of it, and the thresholds chosen."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import parameters, sources
from pedjax.cli.main import main
from pedjax.detection import Wanted, compare, judge_field
from pedjax.detection import field as judging
from pedjax.detectors.field import FIELD_DETECTORS, register_field_detector
from pedjax.errors import InputError
from pedjax.gates import log_positive
from pedjax.lanes import dot
from pedjax.running import run
from pedjax.simulation.labels import largest_changes, quasi_static
from pedjax.simulation.scenarios import load_scenario
from pedjax.simulation.world import simulate
from pedjax.sources import read_labelled
from pedjax.systems import system
from tests import tools

PARAMS = system("ma2018").defaults()
ALONE = parameters.replace(PARAMS, {"compass.update": "none"})


CORRIDOR = """
rate_hz = 100.0
landmarks = [[0.0, 0.0]]
field = { kind = "building", style = "corridor" }
legs = [
    { points = [[0, 0], [35, 0]] }, { kind = "turn", angle = 180.0 },
    { points = [[35, 0], [0, 0]] }, { kind = "turn", angle = -180.0 },
]
rounds = 2
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    """A corridor up and down, for a foot alone."""
    path = tmp_path_factory.mktemp("scenario") / "up-and-down.toml"
    path.write_text(CORRIDOR)
    return path


@pytest.fixture(scope="module")
def pairs(scenario):
    made = [simulate(load_scenario(scenario), seed) for seed in (0, 1)]
    return [(m.recording, m.truth["foot"]) for m in made]


@pytest.fixture(scope="module")
def walks(pairs):
    return [judging.field_walk(*pair, "ma2018", PARAMS) for pair in pairs]


@pytest.fixture(scope="module")
def given(walks):
    return judging.labelled(PARAMS, list(FIELD_DETECTORS), walks)


def test_largest_changes_by_counting(rng):
    field = rng.normal(size=(12, 3)) * 5
    moved, heading = largest_changes(field, 3)
    angle = np.arctan2(field[:, 1], field[:, 0])
    assert np.isinf(moved[:3]).all()
    assert np.isinf(heading[:3]).all()
    for k in range(3, 12):
        steps = [(j, j - 1) for j in range(k - 2, k + 1)]
        assert moved[k] == pytest.approx(max(np.linalg.norm(field[a] - field[b]) for a, b in steps))
        turned = [abs((angle[a] - angle[b] + np.pi) % (2 * np.pi) - np.pi) for a, b in steps]
        assert heading[k] == pytest.approx(max(turned))
    assert np.isinf(largest_changes(field[:3], 3)).all()


def test_labels_are_those_of_the_stances(pairs, walks):
    (_, truth), walk = pairs[0], walks[0]
    for definition in ((3.0, 5.0), (6.0, 10.0)):
        time, label = quasi_static(truth, 3, *definition)
        nearest = np.abs(time[None] - walk.windows.time[-1][:, None]).argmin(axis=1)
        seen = walk.windows.time[-1] < truth.time[-1] - 6.0  # while standing, the middle is far
        assert 0.1 < label.mean() < 0.7
        np.testing.assert_array_equal(walk.label(*definition)[seen], label[nearest][seen])


def test_looks_belong_to_the_stance_around_them(pairs):
    _, truth = pairs[0]
    begin = np.flatnonzero(np.diff(truth.stance.astype(int)) == 1) + 1
    first = int(truth.stance[0])
    for late in (0, 3):
        found = judging.stance_at(truth.time[begin + late], truth)
        np.testing.assert_array_equal(found, first + np.arange(len(begin)))
    early = judging.stance_at(truth.time[begin - 1], truth)
    np.testing.assert_array_equal(early, first + np.arange(len(begin)))


def test_statistics_are_those_of_the_filter(pairs, walks, given):
    for name in ("ma", "vector"):
        each = given.statistic[name]
        chosen = parameters.replace(ALONE, {"field.detector": name})
        track = run(pairs[0][0], "ma2018", chosen)
        ratio = track.gates["field"].log_ratio[track.more["look"] > 0][3:]
        own = parameters.replace(PARAMS.field, {"detector": name})
        np.testing.assert_allclose(judging.log_ratios(own, walks[0].windows), ratio, rtol=1e-9, atol=1e-9)
        unit = np.median(each[0] / np.exp(ratio))
        np.testing.assert_allclose(each[0], unit * np.exp(ratio), rtol=1e-9)


def test_no_detector_changes_what_it_is_given(pairs, walks):
    loose = {"field.detector": "qsf", "field.qsf.threshold": 1e5, "compass.gyroscope_rows": True}
    again = judging.field_walk(*pairs[0], "ma2018", parameters.replace(PARAMS, loose))
    for one, two in zip(again.windows, walks[0].windows, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-12)  # another program rounds otherwise


def test_parts(walks):
    parts = judging.parts(walks)
    count = sum(len(w.turn) for w in walks)
    assert next(iter(parts)) == "all"
    sizes = {name: sum(int(m.sum()) for m in masks) for name, masks in parts.items()}
    assert sizes["all"] == count
    assert sum(n for name, n in sizes.items() if name.startswith("gait")) == count
    assert sum(n for name, n in sizes.items() if name.startswith("anomaly")) == count
    assert abs(sizes["anomaly_low"] - count / 3) <= 1
    assert sizes["straight"] + sizes["curved"] <= count
    for walk, curved in zip(walks, parts["curved"], strict=True):
        turned = np.ptp(np.unwrap(walk.windows.yaw, axis=0), axis=0)
        np.testing.assert_allclose(walk.turn, turned, atol=np.radians(8))  # the filter's own yaw
        assert (walk.turn[curved] > np.radians(30)).all()


@pytest.mark.parametrize("wanted", [Wanted(0.1), Wanted(0.8, "detection")])
@pytest.mark.parametrize("detector", list(FIELD_DETECTORS))
def test_operating_points(walks, given, detector, wanted):
    label = np.concatenate(given.label)
    curve = compare(given, draws=2)["all"][detector].roc
    reached = judging.at_point(PARAMS, detector, curve, wanted, walks, label)
    threshold = curve.at(wanted)
    one_window = 1.01 / label.sum(), 1.01 / (~label).sum()
    if detector != "vector":  # its order of windows depends a little on its knob
        assert reached.p_detection == pytest.approx(curve.detection_at(threshold), abs=one_window[0])
        assert reached.p_false_alarm == pytest.approx(curve.false_alarm_at(threshold), abs=one_window[1])
    if wanted.keep == "detection":
        assert 0.8 <= reached.p_detection <= 0.85
    else:
        assert reached.p_false_alarm <= 0.1 + one_window[1]
    chosen = parameters.replace(PARAMS, reached.parameters)
    passed = judging.log_ratios(chosen.field, judging.together(walks)) < 0
    assert passed[label].mean() == reached.p_detection


def test_vector_knob_moves_the_change_where_no_probability_will_do(walks, given):
    label = np.concatenate(given.label)
    few = parameters.replace(PARAMS, {"field.vector.change": 0.3})
    again = judging.labelled(few, ["vector"], walks)
    curve = compare(again, draws=2)["all"]["vector"].roc
    reached = judging.at_point(few, "vector", curve, Wanted(0.95, "detection"), walks, label)
    assert list(reached.parameters) == ["field.detector", "field.vector.change"]
    assert reached.p_detection >= 0.95


def test_a_detector_of_ones_own_is_judged_by_its_declared_point(pairs, monkeypatch):
    @parameters.parameters
    class Far:
        limit: float = parameters.leaf(4.0, unit="uT", low=1e-3, high=1e3, source="test", point=True)

    def far(p, window, north):
        away = window[-1].field - window[0].field
        return 0.5 * log_positive(dot(away, away)) - jnp.log(p.limit)

    monkeypatch.setattr(parameters, "_OFFERED", dict(parameters._OFFERED))
    monkeypatch.setitem(FIELD_DETECTORS, "far", far)  # so that it is gone afterwards
    register_field_detector("far", far, Far)
    chosen = system("ma2018")
    judged = judge_field(chosen, chosen.defaults(), pairs, ["far", "ma"])
    assert [entry["windows"] for entry in judged.entries] == [len(y) for y in judged.given.label]
    assert judged.definition == {"same_field_uT": 3.0, "same_heading_deg": 5.0}
    curves = judged.curves(draws=2)["all"]
    assert curves["far"].auc.value > 0.7
    threshold = curves["far"].roc.at(Wanted(0.1))
    reached = judged.at_point("far", curves["far"].roc, Wanted(0.1))
    assert reached.parameters == {"field.detector": "far", "field.far.limit": threshold}
    assert reached.p_false_alarm <= 0.1
    other = system("iez")
    with pytest.raises(InputError, match="'iez' does not look at the field"):
        judge_field(other, other.defaults(), pairs)


def test_a_file_with_its_truth_is_the_made_walk(scenario, pairs, walks, tmp_path):
    path = tmp_path / "c.csv.gz"
    assert main(["simulate", str(scenario), "--out", str(path), "--no-figures"]) == 0
    walk = judging.field_walk(*read_labelled(path), "ma2018", PARAMS)
    np.testing.assert_array_equal(walk.label(), walks[0].label())
    np.testing.assert_allclose(walk.windows.field, walks[0].windows.field, atol=1e-6)
    other = tmp_path / "other.csv"
    pedjax.readers.write_csv(tools.crop(pairs[0][0], 20.0), other)
    with pytest.raises(InputError, match=r"no other\.truth\.npz beside it; name a made walk"):
        read_labelled(other)
    (tmp_path / "c.truth.npz").rename(tmp_path / "longer.truth.npz")
    pedjax.readers.write_csv(_slower(pairs[0][0]), tmp_path / "longer.csv")
    with pytest.raises(InputError, match="belongs to another walk"):
        read_labelled(tmp_path / "longer.csv")
    np.savez(tmp_path / "other.truth.npz", route=np.zeros(3))
    with pytest.raises(InputError, match="no truth of sensor 'foot'"):
        read_labelled(other)


def _slower(recording):
    """The same samples at stamps a second later."""
    sensor = recording.sensors["foot"]
    late = {
        kind: replace(getattr(sensor, kind), time=getattr(sensor, kind).time + 1.0)
        for kind in ("accelerometer", "gyroscope", "magnetometer")
    }
    return replace(recording, sensors={"foot": replace(sensor, **late)}, truth=None, landmarks=None)


def test_refusals(pairs, monkeypatch):
    monkeypatch.setattr(sources, "made", lambda name: SimpleNamespace(truth={"foot": pairs[0][1]}))
    with pytest.raises(InputError, match="has no sensor 'nose', but foot"):
        read_labelled("corridor:0", sensor="nose")
    track = SimpleNamespace(more={"look": np.array([0.0, 1.0, 0.0, 1.0])})
    monkeypatch.setattr(judging, "run_system", lambda *args, **options: track)
    with pytest.raises(InputError, match="looks at the field are too few"):
        judging.field_walk(*pairs[0], "ma2018", PARAMS)
