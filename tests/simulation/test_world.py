"""Scenarios come true: exact truth beside what the sensors say, the same bits for the same seed."""

from dataclasses import replace

import numpy as np
import pytest

import pedjax
from pedjax.cli import main
from pedjax.errors import InputError
from pedjax.simulation.fields import field_at
from pedjax.simulation.footsteps import Leg, footsteps
from pedjax.simulation.labels import quasi_static
from pedjax.simulation.scenarios import Scenario, load_scenario, scenarios
from pedjax.simulation.world import field_of, simulate

SMALL = Scenario(
    name="small",
    legs=(Leg(points=((0.0, 0.0), (8.0, 0.0), (8.0, 5.0))),),
    sensors={"foot": "mti_g_710", "waist": "xsens_mtw"},
    field={"kind": "building", "style": "office"},
    landmarks=((0.0, 0.0), (8.0, 5.0)),
    survey_m=0.5,
)
WALL = {"start": [0.0, 0.0], "end": [0.0, 8.0], "turn": 15.0}


@pytest.fixture(scope="module")
def made():
    return simulate(SMALL, 5)


def test_the_same_seed_gives_the_same_bits(made):
    again = simulate(SMALL, 5)
    for place in SMALL.sensors:
        one, two = made.recording.sensors[place], again.recording.sensors[place]
        for stream in ("accelerometer", "gyroscope", "magnetometer"):
            np.testing.assert_array_equal(getattr(one, stream).values, getattr(two, stream).values)
    np.testing.assert_array_equal(made.recording.landmarks.time, again.recording.landmarks.time)


def test_another_seed_is_another_walk(made):
    other = simulate(SMALL, 6)
    assert made.plan.seconds != other.plan.seconds
    errors = []
    for each in (made, other):
        truth = each.truth["foot"]
        clean = truth.motion.angular_rate + truth.gyroscope_bias
        errors.append((each.recording.sensors["foot"].gyroscope.values - clean)[:280, 0])  # at rest
    assert abs(np.corrcoef(errors)[0, 1]) < 0.25


def test_what_is_measured_is_the_truth_and_its_errors(made):
    truth, sensor = made.truth["foot"], made.recording.sensors["foot"]
    left = sensor.gyroscope.values - truth.motion.angular_rate - truth.gyroscope_bias
    calm = truth.stance & (np.linalg.norm(truth.motion.angular_rate, axis=1) < 0.5)
    assert np.abs(left[calm].mean(axis=0)).max() < 2e-3
    assert 1e-4 < left[calm].std() < 2e-2
    field = np.einsum("tji,tj->ti", truth.motion.attitude, truth.magnetic_field)
    assert np.median(np.abs(sensor.magnetometer.values - field)) < 0.5
    np.testing.assert_allclose(
        truth.magnetic_field - truth.disturbance,
        np.broadcast_to(made.field.background, truth.disturbance.shape),
    )


def test_landmarks_are_where_the_foot_stood(made):
    truth, marks = made.truth["foot"], made.recording.landmarks
    assert len(marks.time) == 2
    index = np.searchsorted(truth.time, marks.time)
    assert truth.stance[index].all()
    np.testing.assert_allclose(marks.position, (truth.motion.position - truth.motion.position[0])[index])
    walked = truth.motion.position[index][:, :2]
    assert np.linalg.norm(walked - np.array(SMALL.landmarks), axis=1).max() < 2.0


def test_the_recording_can_be_navigated(made):
    track = pedjax.run(made.recording)
    score = pedjax.evaluate(track, made.recording)
    assert track.healthy
    assert score.percent_of_distance < 5


def test_a_homogeneous_field_is_quasi_static_and_a_magnet_is_not():
    corridor = (Leg(points=((0.0, 0.0), (24.0, 0.0))),)
    calm = simulate(replace(SMALL, legs=corridor, field={"kind": "munich"}, landmarks=(), survey_m=0.0), 1)
    time, label = quasi_static(calm.truth["foot"])
    assert len(time) > 12
    assert label[3:].all()
    assert not label[:3].any()
    disturbed = {"kind": "floor_magnet", "place": (12.0, 0.0), "moment": (200.0, 0.0, 0.0)}
    magnet = simulate(replace(SMALL, legs=corridor, field=disturbed, landmarks=(), survey_m=0.0), 1)
    truth = magnet.truth["foot"]
    time, label = quasi_static(truth)
    away = np.abs(np.interp(time, truth.time, truth.motion.position[:, 0]) - 12.0)
    assert not label[away < 2.0].any()
    assert label[3:][away[3:] > 9.0].all()


def test_magnetised_walls_turn_the_field_on_the_way():
    corridor = (Leg(points=((0.0, 0.0), (0.0, 30.0))),)
    stretch = {"start": [0, 10], "end": [0, 20], "turn": 20}
    walls = {"kind": "magnetised_walls", "stretches": [stretch]}
    plain = replace(SMALL, legs=corridor, landmarks=(), survey_m=0.0, sensors={"foot": "mti_g_710"})
    truth = simulate(replace(plain, field=walls), 1).truth["foot"]
    east, north, _ = truth.magnetic_field[truth.stance].T
    place, turn = truth.motion.position[truth.stance, 1], np.degrees(np.arctan2(-east, north))
    np.testing.assert_allclose(turn[(place > 12.0) & (place < 18.0)], 20.0, atol=1.0)
    np.testing.assert_allclose(turn[(place < 6.0) | (place > 24.0)], 0.0, atol=1.0)
    assert np.ptp(np.linalg.norm(truth.magnetic_field, axis=1)) < 1.0


def test_the_turned_field_has_calm_corridors_between_its_stretches():
    scenario = load_scenario("turned-field")
    plan = footsteps(scenario.legs, 0, scenario.standing_s)
    field = field_of(scenario, plan, 0)
    made = scenario.field["stretches"]
    assert [each["turn"] for each in made] == [15.0, 15.0, 30.0, 30.0]
    middles = np.array([[*np.add(each["start"], each["end"]) / 2, 0.1] for each in made])
    east, north, _ = np.asarray(field_at(field, middles.T))
    np.testing.assert_allclose(np.degrees(np.arctan2(-east, north)), [15, 15, 30, 30], atol=0.1)
    for x in (0.0, 30.0):
        ends = sorted(
            y for each in made for end in (each["start"], each["end"]) for y in end[1:] if end[0] == x
        )
        assert np.diff([0.0, *ends, 70.0])[::2].min() >= 12.0


def test_what_acts_in_stance_acts_in_stance_only():
    plain = replace(
        SMALL, field={"kind": "munich"}, landmarks=(), survey_m=0.0, sensors={"foot": "mti_g_710"}
    )
    alone = simulate(plain, 2)
    beside = simulate(replace(plain, iron={"platform": (5.0, 0.0, 0.0)}), 2)
    difference = [made.recording.sensors["foot"].magnetometer.values for made in (beside, alone)]
    difference = difference[0] - difference[1]
    stance = alone.truth["foot"].stance
    assert np.median(difference[stance, 0]) == pytest.approx(5.0, abs=0.1)
    assert np.abs(difference[~stance]).max() < 0.1


def test_a_survey_covers_the_site(made):
    survey = made.survey()
    assert survey["survey_position"].shape == survey["survey_field"].shape
    assert np.ptp(survey["survey_position"][:, 0]) >= 8.0
    assert simulate(replace(SMALL, survey_m=0.0), 5).survey() == {}


def test_nothing_made_of_steel_stands_in_the_way(made):
    strength = np.linalg.norm(made.truth["waist"].magnetic_field, axis=1)
    assert strength.min() > 20
    assert strength.max() < 120


def test_every_scenario_that_comes_along_loads():
    assert {"demo", "office-loop", "mall", "teaching-building"} <= set(scenarios())
    for name in scenarios():
        assert load_scenario(name).title


@pytest.mark.parametrize(
    ("name", "length", "strides"),
    [("office-loop", 1018.0, 786), ("mall", 2480.0, 1920), ("teaching-building", 515.5, None)],
)
def test_published_lengths(name, length, strides):
    scenario = load_scenario(name)
    plan = footsteps(scenario.legs * scenario.rounds, 0, scenario.standing_s)
    walked = np.linalg.norm(np.diff(plan.route[:, :2], axis=0), axis=1).sum()
    assert walked == pytest.approx(length, rel=0.02)
    if strides is not None:
        assert plan.steps / 2 == pytest.approx(strides, rel=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sensors": {"head": "gx5"}}, "carried at 'head'"),
        ({"sensors": {"foot": "gx55"}}, "did you mean"),
        ({"field": {"kind": "bulding"}}, "did you mean 'building'"),
        ({"field": {"kind": "munich", "style": "office"}}, "takes no 'style'"),
        ({"rate_hz": 1.0}, "rate_hz = 1 must lie between"),
        ({"rounds": 0}, "rounds = 0"),
        ({"legs": ()}, "has no legs"),
        ({"calibrated": 2.0}, "calibrated = 2"),
        ({"field": {"kind": "magnetised_walls"}}, r"needs stretches = \[\{ start = "),
        (
            {"field": {"kind": "magnetised_walls", "stretches": [{"turns": 3}]}},
            "stretch 1: .*did you mean 'turn'",
        ),
        (
            {"field": {"kind": "magnetised_walls", "stretches": [WALL], "side": "2"}},
            "field.side = '2' must be",
        ),
        ({"iron": {"medium": 1}}, "iron.medium is unknown"),
    ],
)
def test_impossible_scenarios_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        replace(SMALL, **change)


def test_unknown_keys_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[[legs]]\npoints = [[0.0, 0.0], [5.0, 0.0]]\nspeeed = 1.0\n")
    with pytest.raises(InputError, match="did you mean 'speed'"):
        load_scenario(path)
    path.write_text("legs = 3\n")
    with pytest.raises(InputError, match="legs must be tables"):
        load_scenario(path)
    with pytest.raises(InputError, match="there is no scenario"):
        load_scenario("nowhere")


def test_the_command_writes_a_recording_that_commands_read(tmp_path, capsys):
    scenario = tmp_path / "line.toml"
    scenario.write_text(
        'title = "a line"\nlandmarks = [[0.0, 0.0], [6.0, 0.0]]\n'
        "[[legs]]\npoints = [[0.0, 0.0], [6.0, 0.0]]\n"
    )
    target = tmp_path / "line.csv.gz"
    assert main(["simulate", str(scenario), "--seed", "2", "--out", str(target)]) == 0
    assert (tmp_path / "line.png").stat().st_size > 10_000
    truth = np.load(tmp_path / "line.truth.npz")
    recording = pedjax.read(target)
    assert len(recording.sensors["foot"].gyroscope.time) == len(truth["foot_time"])
    assert recording.truth.quaternion is not None
    assert recording.landmarks is not None
    first = target.read_bytes()
    assert main(["simulate", str(scenario), "--seed", "2", "--out", str(target), "--no-figures"]) == 0
    assert target.read_bytes() == first
    assert "a line" in capsys.readouterr().out
    assert main(["simulate", "ofice-loop"]) == 1
    assert "did you mean 'office-loop'" in capsys.readouterr().err
    assert main(["simulate", str(scenario), "--out", str(tmp_path / "line.txt")]) == 1
