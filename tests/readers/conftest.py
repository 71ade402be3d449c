"""A still-then-walking sensor for synthetic files, and the folder of real recordings."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest


@dataclass(frozen=True)
class Walk:
    """Samples in the units of a Recording: z up, still for the first second."""

    time: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    field: np.ndarray


@pytest.fixture
def walk():
    rng = np.random.default_rng(7)
    time = np.arange(300) / 200.0
    moving = (time > 1.0)[:, None]
    force = np.array([0.5, -0.3, 9.78]) + moving * rng.normal(0, 3, (300, 3))
    rate = 0.01 * rng.normal(size=(300, 3)) + moving * rng.normal(0, 2, (300, 3))
    field = np.array([20.0, 5.0, -40.0]) + rng.normal(0, 1, (300, 3))
    return Walk(time, force, rate, field)


@pytest.fixture(scope="session")
def data():
    folder = os.environ.get("PEDJAX_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("PEDJAX_DATA does not name the folder of real recordings")
    return Path(folder)
