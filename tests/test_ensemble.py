"""Ensembles: losses of sets on recordings, and recordings that have nothing to score."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from pedjax import parameters
from pedjax.ensemble import Problem, losses, scores, walks_for
from pedjax.errors import InputError
from pedjax.evaluation.scores import told_with
from pedjax.packing import pack_all
from pedjax.recording import Landmarks
from pedjax.system import Status
from pedjax.systems import SYSTEMS
from tests import tools

IEZ = SYSTEMS["iez"]


@pytest.fixture(scope="module")
def batches(demos):
    walks = walks_for(IEZ, tools.iez(), [demos[2], demos[0]], "foot", None, "armse")
    return pack_all(IEZ, parameters.cast(tools.iez(), float), walks)


VALUES = {
    "stance.shoe.threshold": np.array([1e7, 1e8, 1e8]),
    "process.accelerometer": np.array([0.03, 0.03, 1e200]),
}


def test_losses_are_the_scores_and_infinite_where_a_run_diverged(batches):
    problem, params = Problem(IEZ, "mean_2d", "yaw_translation"), parameters.cast(tools.iez(), float)
    (batch,) = batches.parts
    found = jax.jit(scores, static_argnums=0)(problem, params, VALUES, batch)
    assert found.status.tolist() == [[0, 0], [0, 0], [Status.DIVERGED] * 2]
    assert found.gates["stance"].shape == (3, 2)
    assert set(found.errors) == {kind.name for kind in told_with("mean_2d")}
    assert {x.shape for x in found.errors.values()} == {(3, 2)}
    loss = losses(problem, params, VALUES, batches)
    np.testing.assert_array_equal(loss[:2], found.errors["mean_2d"][:2])
    assert np.isinf(loss[2]).all()


def with_marks(recording, known):
    """Landmarks of which only those coordinates are known: rows of x, y, z."""
    position = np.where(np.array(known, bool), recording.landmarks.position[: len(known)], np.nan)
    return replace(recording, landmarks=Landmarks(recording.landmarks.time[: len(known)], position))


@pytest.mark.parametrize(
    ("known", "loss", "message"),
    [
        ([[1, 1, 1]], "armse", "known x and y; it has 1"),
        ([[1, 1, 0], [0, 0, 1]], "rms_2d", "known x and y; it has 1"),
        ([[1, 1, 1], [1, 1, 0]], "rms_3d", "known x, y and z; it has 1"),
    ],
)
def test_too_few_points_are_refused(demos, known, loss, message):
    with pytest.raises(InputError, match=f"demo:0: loss '{loss}' needs at least two landmarks .* {message}"):
        walks_for(IEZ, tools.iez(), [with_marks(demos[0], known)], "foot", None, loss)


def test_two_points_will_do(demos):
    recording = with_marks(demos[0], [[1, 1, 0], [1, 1, 0]])
    (walk,) = walks_for(IEZ, tools.iez(), [recording], "foot", None, "rms_2d")
    assert len(walk.index) == 2


def test_recordings_shorter_than_the_window_are_refused(demos):
    params = tools.iez(stance__shoe__window_s=8.0)
    with pytest.raises(
        InputError, match=r"2400 samples .* are 12 s, and stance\.shoe\.window_s asks for at least 16 s"
    ):
        walks_for(IEZ, params, [demos[0]], "foot", None, "armse")
