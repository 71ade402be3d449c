"""What all tests share: the compilation options, double precision, and walks that are made once."""

import os
import tempfile

import matplotlib

import pedjax

os.environ["PEDJAX_CACHE"] = tempfile.mkdtemp(prefix="pedjax-test-")  # compiled anew by each test run
matplotlib.use("Agg")
CONFIGURED = pedjax.configure().fast

import hypothesis  # noqa: E402
import jax  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402

from pedjax.simulation.scenarios import load_scenario  # noqa: E402
from pedjax.simulation.world import simulate  # noqa: E402
from tests import tools  # noqa: E402
from tests.reference.walk import walk  # noqa: E402

jax.config.update("jax_enable_x64", True)
hypothesis.settings.register_profile("patient", deadline=None)  # a busy machine is not a failure
hypothesis.settings.load_profile("patient")


@pytest.fixture(scope="session")
def configured():
    """Whether the fast compilation options are in force."""
    return CONFIGURED


@pytest.fixture(scope="module", autouse=True)
def programs_end_with_their_module():
    """A process may map some 65,000 pieces of memory, and every compiled program takes several: all of the
    suite's at once are too many."""
    yield
    jax.clear_caches()


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture(scope="session")
def minute():
    """A minute of walking at 100 Hz, noisy sensors with biases."""
    return tools.noisy(walk(60.0, 100.0, seed=1), seed=2)


@pytest.fixture(scope="session")
def minute_recording(minute):
    return tools.recording_of(minute, "minute")


@pytest.fixture(scope="session")
def demos():
    """Four demo walks, cropped to different lengths."""
    seconds = (12.0, 19.0, 9.0, 15.0)
    return [tools.crop(pedjax.read(f"demo:{seed}"), s) for seed, s in enumerate(seconds)]


@pytest.fixture(scope="session")
def straight(tmp_path_factory):
    """A made walk of 63 strides straight on in a homogeneous field, for a foot alone, with its truth."""
    path = tmp_path_factory.mktemp("scenario") / "straight.toml"
    path.write_text(tools.STRAIGHT)
    return simulate(load_scenario(path), 1)


@pytest.fixture(scope="session")
def pocket(tmp_path_factory):
    """A made walk with a sensor in the trouser pocket: a stroll, a walk, a stand, brisk, and a short run."""
    path = tmp_path_factory.mktemp("scenario") / "pocket.toml"
    path.write_text(tools.POCKET)
    return simulate(load_scenario(path), 3)
