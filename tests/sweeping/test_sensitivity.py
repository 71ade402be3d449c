"""Slopes at the best set against differences of the same soft loss."""

import jax
import numpy as np
import pytest

import pedjax
from pedjax import parameters
from pedjax.sweeping.designs import Axis
from pedjax.sweeping.engine import job
from pedjax.sweeping.sensitivity import WIDTH, sensitivity
from tests import tools

AXES = [  # log and linear, and not in the order of their names
    Axis("updates.zero_velocity", "m/s", True, 0.003, 0.1),
    Axis("gravity", "m/s^2", False, 9.75, 9.85),
    Axis("process.gyroscope", "rad/s/sqrt(Hz)", True, 1e-4, 1e-2),
    Axis("stance.shoe.threshold", "1", True, 1e6, 1e9),
    Axis("initial.heading", "rad", False, -1.0, 1.0),
]
PARAMS = {**tools.shoe_sigmas(), "updates__zero_velocity": 0.02, "initial__heading": 0.3}
"""A heading far from its best, where the loss has a sharp bend."""


@pytest.fixture(scope="module")
def work(demos):
    return job([demos[2], demos[0]], params=tools.iez(**PARAMS), loss="rms_2d", alignment="none")


@pytest.fixture(scope="module")
def found(work):
    with jax.enable_x64(False):  # float64 in any case
        return sensitivity(work, work.params, AXES)


def test_slopes_equal_differences(demos, work, found):
    """Central differences at two steps, extrapolated."""
    steps = np.array([1e-3, -1e-3, 5e-4, -5e-4])
    soft = tools.iez(**PARAMS, gate__width=WIDTH)
    values = {axis.path: np.full((len(AXES), 4), parameters.get(soft, axis.path)) for axis in AXES}
    for i, axis in enumerate(AXES):
        here = values[axis.path][i]
        values[axis.path][i] = here * np.exp(steps) if axis.log else here + steps
    values = {path: v.ravel() for path, v in values.items()}
    swept = pedjax.sweep([demos[2], demos[0]], values, params=soft, loss="rms_2d", alignment="none")
    loss = swept.mean.reshape(len(AXES), 4)
    coarse, fine = (loss[:, 0] - loss[:, 1]) / 2e-3, (loss[:, 2] - loss[:, 3]) / 1e-3
    slopes = fine + (fine - coarse) / 3
    for axis, slope in zip(AXES, slopes, strict=True):
        wanted = slope * (1.0 if axis.log else 0.01 * (axis.high - axis.low))
        assert found.slope[axis.path] == pytest.approx(wanted, rel=1e-4), axis.path
        assert wanted != 0.0


def test_loss_is_that_of_the_soft_gate(demos, found):
    soft = tools.iez(**PARAMS, gate__width=WIDTH)
    at = {"gravity": np.array([9.8029])}
    swept = pedjax.sweep([demos[2], demos[0]], at, params=soft, loss="rms_2d", alignment="none")
    assert found.loss == pytest.approx(swept.mean[0], rel=1e-9)


def test_a_swept_width_leaves_the_gate_soft(work, monkeypatch):
    widths = []

    def spy(problem, params, logs, at, batch):
        widths.append(float(at.get("gate.width", [params.gate.width])[0]))
        return 1.0, at

    monkeypatch.setattr("pedjax.sweeping.sensitivity._loss_and_slope", spy)
    for axes in (AXES, [Axis("gate.width", "1", False, 0.0, 1.0), *AXES]):
        sensitivity(work, work.params, axes)
    assert widths == [WIDTH, WIDTH]
