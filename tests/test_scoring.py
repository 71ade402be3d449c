"""The score of a track against the reference evaluation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pedjax
from pedjax import InputError
from pedjax.recording import Landmarks, Truth
from pedjax.scoring import aligned, choose_alignment
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.scenarios import Scenario
from tests.reference import evaluation as oracle


@pytest.fixture(scope="module")
def recording(demos):
    return demos[1]


@pytest.fixture(scope="module")
def track(recording):
    return pedjax.run(recording)


def at_marks(track, recording):
    index = [int(np.abs(track.time - t).argmin()) for t in recording.landmarks.time]
    return track.position[index]


@pytest.mark.parametrize("alignment", ["none", "yaw", "yaw_translation"])
def test_score_equals_the_reference(track, recording, alignment):
    score = pedjax.evaluate(track, recording, alignment)
    truth = recording.landmarks.position
    laid, _, _ = oracle.align(at_marks(track, recording), truth, alignment)
    expected = oracle.errors(laid, truth, track.distance)
    for name in ("rms_2d", "rms_3d", "mean_2d", "max_2d", "final_2d"):
        assert getattr(score, f"{name}_m") == pytest.approx(expected[name], abs=1e-6), name
    assert score.armse_m == pytest.approx(expected["armse"], abs=1e-6)
    assert score.percent_of_distance == pytest.approx(expected["percent_final"], abs=1e-5)
    height = np.sqrt(np.mean((laid - truth)[:, 2] ** 2))
    assert score.rms_height_m == pytest.approx(height, abs=1e-6)
    assert (score.count, score.alignment) == (len(truth), alignment)


def test_dense_truth_is_used_where_there_are_no_landmarks(track, recording):
    dense = replace(recording, landmarks=None)
    score = pedjax.evaluate(track, dense)
    assert score.count == len(track.time)
    laid, _, _ = oracle.align(track.position, recording.truth.position, "yaw_translation")
    expected = oracle.errors(laid, recording.truth.position, 1.0)["rms_2d"]
    assert score.rms_2d_m == pytest.approx(expected, abs=1e-5)


def test_nothing_to_compare_with(track, recording):
    assert pedjax.evaluate(track, replace(recording, landmarks=None, truth=None)) is None


def test_alignment_is_chosen_by_what_is_known():
    spread = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0.0]])
    assert choose_alignment(spread) == "yaw_translation"
    assert choose_alignment(spread[:2]) == "yaw"
    assert choose_alignment(np.zeros((3, 3))) == "yaw"
    assert choose_alignment(np.where(np.arange(3)[:, None] == 1, np.nan, spread)) == "yaw"


def test_heights_only(track, recording):
    time = recording.landmarks.time[:3]
    marks = Landmarks(time, np.array([[np.nan, np.nan, 0.0]] * 3))
    score = pedjax.evaluate(track, replace(recording, landmarks=marks))
    assert score.rms_2d_m is None
    assert score.rms_3d_m is None
    assert score.percent_of_distance is None
    height = at_marks(track, recording)[:3, 2]
    assert score.rms_height_m == pytest.approx(np.sqrt(np.mean((height - height[0]) ** 2)))
    assert set(score.as_dict()) == {
        "count", "alignment", "rms_2d_m", "rms_3d_m", "mean_2d_m", "max_2d_m", "final_2d_m",
        "percent_of_distance", "armse_m", "rms_height_m",
    }  # fmt: skip


def test_unknown_heights_leave_no_error_in_space(track, recording):
    position = recording.landmarks.position.copy()
    position[:, 2] = np.nan
    score = pedjax.evaluate(
        track, replace(recording, landmarks=Landmarks(recording.landmarks.time, position))
    )
    assert score.rms_3d_m is None
    assert score.rms_height_m is None
    assert score.rms_2d_m > 0


def test_a_loop_seen_only_where_it_closes(track, recording):
    marks = Landmarks(recording.landmarks.time[[0, -1]], np.zeros((2, 3)))
    score = pedjax.evaluate(track, replace(recording, landmarks=marks))
    start, stop = at_marks(track, recording)[[0, -1], :2]
    assert score.alignment == "yaw"
    assert score.final_2d_m == pytest.approx(np.linalg.norm(stop - start))


def test_a_mirrored_path_is_remarked(track, recording):
    assert pedjax.evaluate(track, replace(recording, landmarks=None)).warnings == ()
    truth = Truth(recording.truth.time, recording.truth.position * [1, -1, 1])
    score = pedjax.evaluate(track, replace(recording, landmarks=None, truth=truth))
    assert "mirror image" in score.warnings[0]


@pytest.fixture(scope="module")
def carried():
    """A walk with a sensor on the foot and one in the pocket, past two landmarks."""
    scenario = Scenario(
        name="carried",
        legs=(Leg(points=((0.0, 0.0), (8.0, 0.0), (8.0, 6.0))),),
        sensors={"foot": "xsens_mtw", "pocket": "xsens_mtw"},
        landmarks=((0.0, 0.0), (8.0, 0.0), (8.0, 6.0)),
    )
    return pedjax.simulate(scenario, 3)


def perfect(track, made, sensor):
    motion = made.truth[sensor].motion
    return replace(
        track,
        time=made.truth[sensor].time,
        sensor=sensor,
        estimate={"position": motion.position - motion.position[0], "attitude": motion.attitude},
    )


@pytest.mark.parametrize("sensor", ["foot", "pocket"])
def test_each_sensor_is_scored_by_its_own_truth(track, carried, sensor):
    assert carried.recording.landmarks.sensor == "foot"
    dense = replace(carried.recording, landmarks=None)
    score = pedjax.evaluate(perfect(track, carried, sensor), dense)
    assert score.warnings == ()
    assert score.rms_3d_m < 1e-9
    assert score.heading_rms_deg < 1e-5


def test_what_is_measured_at_another_sensor_is_remarked(track, carried):
    pocket = perfect(track, carried, "pocket")
    alone = replace(carried.recording, landmarks=None, truths={})
    for recording, what in ((carried.recording, "landmarks"), (alone, "truth")):
        (warning,) = pedjax.evaluate(pocket, recording).warnings
        assert f"the {what} are those of sensor 'foot', the track is that of 'pocket'" in warning
    assert pedjax.evaluate(perfect(track, carried, "foot"), carried.recording).warnings == ()


def test_heading_error_takes_off_a_constant(track, recording):
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 2.0, len(track.time))
    true = Rotation.from_rotvec(np.radians(40.0 + noise)[:, None] * [0, 0, 1]) * Rotation.from_matrix(
        track.attitude
    )
    quaternion = true.as_quat()[:, [3, 0, 1, 2]]
    truth = Truth(track.time, track.position, quaternion)
    score = pedjax.evaluate(track, replace(recording, truth=truth))
    assert score.heading_rms_deg == pytest.approx(np.std(noise), rel=1e-3)


@pytest.mark.parametrize("alignment", ["none", "yaw", "yaw_translation", "auto"])
def test_the_whole_track_is_laid_as_its_landmarks_are(track, recording, alignment):
    whole = aligned(track, recording, alignment)
    assert whole.shape == track.position.shape
    index = [int(np.abs(track.time - t).argmin()) for t in recording.landmarks.time]
    how = "yaw_translation" if alignment == "auto" else alignment
    laid, _, _ = oracle.align(track.position[index], recording.landmarks.position, how)
    np.testing.assert_allclose(whole[index], laid, atol=1e-6)


def test_unknown_alignment(track, recording):
    with pytest.raises(InputError, match="did you mean 'yaw'"):
        pedjax.evaluate(track, recording, "yaws")
