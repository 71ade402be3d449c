"""Wang's system as a whole: every alignment, what later fields say of it, and what it refuses."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import parameters
from pedjax.calibration.attitude import METHODS
from pedjax.errors import InputError
from pedjax.preparing import prepare
from pedjax.recording import Stream
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.scenarios import Scenario
from pedjax.simulation.world import simulate
from pedjax.systems import SYSTEMS
from pedjax.walks import walk
from tests import tools

WANG = SYSTEMS["wang"]
EARTH = {"compass.strength": 48.0, "compass.inclination": 1.1167}
"""Of Munich."""


def wang(**changes):
    """Parameters with changes, `__` for the dot."""
    given = {k.replace("__", "."): v for k, v in changes.items()}
    return parameters.replace(WANG.defaults(), {**EARTH, **given})


SCENARIO = Scenario(
    name="stands",
    rate_hz=100.0,
    standing_s=5.5,
    legs=(Leg(points=((0.0, 0.0), (16.0, 0.0), (16.0, 12.0), (4.0, 12.0)), radius=1.0),),
    sensors={"foot": "xsens_mtw"},
    field={"kind": "munich"},
    landmarks=((8.0, 0.0), (16.0, 6.0), (10.0, 12.0), (4.0, 12.0)),
)


@pytest.fixture(scope="module")
def plain():
    """Stands for 5.5 s, then three sides of a rectangle in a homogeneous field."""
    return simulate(SCENARIO, 3)


def disturbed(made, level, until=5.9):
    """The recording with a constant disturbance (3,) in navigation axes while the foot stands first."""
    truth, foot = made.truth["foot"], made.recording.sensors["foot"]
    field = foot.magnetometer.values.copy()
    on = truth.time - truth.time[0] < until
    field[on] += np.einsum("tji,j->ti", truth.motion.attitude[on], np.array(level))
    sensor = replace(foot, magnetometer=Stream(foot.magnetometer.time, field))
    return replace(made.recording, sensors={"foot": sensor})


def yaw_error(track, made):
    """Of the estimate less the truth, degrees, at every sample."""
    C = made.truth["foot"].motion.attitude
    return np.degrees(np.angle(np.exp(1j * (track.euler[:, 2] - np.arctan2(C[:, 1, 0], C[:, 0, 0])))))


def end_error(track, made):
    place = made.truth["foot"].motion.position
    return np.linalg.norm((track.position[-1] - (place[-1] - place[0]))[:2])


@pytest.mark.parametrize(
    "method", [pytest.param(m, marks=() if m == "agda" else pytest.mark.slow) for m in METHODS]
)
def test_every_alignment_starts_a_walk(plain, method):
    track = pedjax.run(plain.recording, WANG, wang(initial__alignment=method))
    print(f"{method}: yaw {yaw_error(track, plain)[0]:.2f} degrees, end {end_error(track, plain):.2f} m")
    assert track.healthy
    assert abs(yaw_error(track, plain)[0]) < 1.0
    assert end_error(track, plain) < 0.6
    assert track.more["look"].sum() > 25
    assert (track.more["heading_alpha"] >= 0).all()
    if method != "levelling":
        assert abs(np.degrees(track.more["start_error"][-1])) < 2.5
        assert not track.more["start_mended"].any()


@pytest.mark.slow
@pytest.mark.parametrize("law", ["printed", "trace", "innovation", "windowed"])
def test_every_law_walks(plain, law):
    """On the heading and on zero velocities; as printed it believes usual innovations without measure, and
    strays by 5 to 9 m on each of the seeds 1 to 8, where a fixed noise has 0.1 m."""
    p = wang(compass__adaptive__law=law, updates__adaptive__law=law if law != "printed" else "none")
    track = pedjax.run(plain.recording, WANG, p)
    assert track.healthy
    assert (end_error(track, plain) > 2.0) == (law == "printed")


PLAIN = {"compass__compensation__mode": "none"}
FIXED = {**PLAIN, "compass__adaptive__law": "none"}


@pytest.mark.parametrize(
    "changes", [{}, pytest.param(PLAIN, marks=pytest.mark.slow), pytest.param(FIXED, marks=pytest.mark.slow)]
)
def test_later_fields_tell_a_disturbed_start(plain, changes):
    """Within its sigma, whatever is made of the headings: that they are compensated, turn the yaw, or teach
    the gyroscope a bias which it does not have."""
    track = pedjax.run(disturbed(plain, (15.0, 0.0, 0.0)), WANG, wang(**changes))
    wrong = yaw_error(track, plain)[0]
    told, sigma = (np.degrees(track.more[x][-1]) for x in ("start_error", "start_error_sigma"))
    print(f"off by {wrong:.1f}, told {told:.2f} +- {sigma:.2f} degrees")
    assert wrong > 30
    assert sigma < 4
    assert abs(told + wrong) < 2 * sigma
    assert not track.more["start_mended"].any()


@pytest.mark.parametrize("changes", [{}, pytest.param(PLAIN, marks=pytest.mark.slow)])
def test_a_start_that_is_mended_turns_the_path_back(plain, changes):
    recording = disturbed(plain, (15.0, 0.0, 0.0))
    told, mended = (
        pedjax.run(recording, WANG, wang(initial__align__check=x, **changes)) for x in ("tell", "mend")
    )
    print(f"{end_error(told, plain):.2f} m, mended {end_error(mended, plain):.2f} m")
    once = mended.more["start_mended"]
    at = int(np.argmax(once > 0))
    assert mended.healthy
    np.testing.assert_array_equal(once[at:], 1.0)
    assert 600 < at < 1500
    assert abs(yaw_error(mended, plain)[at + 5 :]).max() < 5
    assert end_error(mended, plain) < end_error(told, plain) / 3
    assert end_error(mended, plain) < 0.6


def test_a_clean_start_is_not_mended(plain):
    track, calm = (pedjax.run(plain.recording, WANG, wang(initial__align__check=x)) for x in ("mend", "tell"))
    assert not track.more["start_mended"].any()
    np.testing.assert_allclose(track.position, calm.position, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_whole_disturbance_of_the_own_start_is_the_plain_compass(plain, method):
    """Exactly where the mean of the start is what was aligned; by its noise where only a part was."""
    recording = disturbed(plain, (15.0, 0.0, 0.0))
    vector, none = (
        pedjax.run(recording, WANG, wang(initial__alignment=method, compass__compensation__mode=mode))
        for mode in ("vector", "none")
    )
    if method in ("levelling", "triad"):
        np.testing.assert_allclose(vector.position, none.position, atol=1e-9)
        np.testing.assert_allclose(vector.attitude, none.attitude, atol=1e-9)
    away = np.degrees(np.angle(np.exp(1j * (vector.euler - none.euler))))
    assert np.abs(away).max() < 0.1


@pytest.mark.slow
def test_a_given_heading_stays_beside_an_alignment(plain):
    p = wang(compass__start="given", initial__heading=0.3)
    track = pedjax.run(plain.recording, WANG, p)
    other = pedjax.run(plain.recording, WANG, wang())
    assert track.euler[0, 2] == pytest.approx(0.3, abs=0.02)
    np.testing.assert_allclose(track.euler[0, :2], other.euler[0, :2], atol=1e-3)


@pytest.fixture(scope="module")
def prepared(plain):
    found = tools.cropped(walk(disturbed(plain, (15.0, 0.0, 0.0)), clock="stamps"), 0, 1600)
    p = wang(
        initial__align__check="mend", initial__align__covariance="measured", initial__align__seconds=4.0,
        compass__adaptive__law="windowed", updates__adaptive__law="windowed",
    )  # fmt: skip
    p = parameters.cast(p, float)
    return p, found, prepare(WANG, p, found, float, 1600)


HALF = 850
"""Behind two steps, before the start is mended."""


def test_cropping_the_end_changes_no_bit(prepared):
    p, found, inputs = prepared
    _, whole = tools.scan(WANG, p, inputs.samples, WANG.start(p, None, inputs.opening))
    assert whole.more["start_mended"].max() == 1
    for stop in (HALF, 450):
        cropped = prepare(WANG, p, tools.cropped(found, 0, stop), float, stop)
        _, part = tools.scan(WANG, p, cropped.samples, WANG.start(p, None, cropped.opening))
        tools.same_bits(jax.tree.map(lambda x, n=stop: x[:n], whole), part)


def test_two_chunks_equal_one_to_the_bit(prepared):
    p, _, inputs = prepared
    tools.assert_chunks_equal_the_whole(WANG, p, inputs, HALF)


LANES = {
    "initial.align.decay": [0.7, 0.5, 0.9],
    "compass.declination": [0.0, 0.1, -0.1],
    "compass.adaptive.scale": [1.0, 3.0, 0.5],
    "compass.compensation.softness": [1.0, 0.1, 5.0],
    "initial.align.dip_spread": [0.02, 0.05, 0.03],
}


def test_lanes_equal_one_by_one(prepared):
    p, _, inputs = prepared
    lanes = parameters.with_leaves(p, {n: jnp.asarray(x) for n, x in LANES.items()})
    _, together = tools.scan(WANG, lanes, inputs.samples, WANG.start(lanes, None, inputs.opening))
    assert together.estimate.position.shape == (1600, 3, 3)
    for i in range(3):
        one = parameters.with_leaves(p, {n: jnp.asarray(x[i]) for n, x in LANES.items()})
        _, alone = tools.scan(WANG, one, inputs.samples, WANG.start(one, None, inputs.opening))
        for ours, theirs in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(ours[..., i], theirs, atol=1e-6, rtol=1e-6)


def test_what_has_no_field_or_no_reference_is_refused(plain):
    p = parameters.replace(SYSTEMS["iez"].defaults(), {"initial.alignment": "agda"})
    with pytest.raises(InputError, match=r"initial\.alignment = agda goes by the magnetic field"):
        pedjax.run(plain.recording, "iez", p)
    for mode in ("magnitude", "vector"):
        p = wang(compass__compensation__mode=mode, compass__reference="running")
        with pytest.raises(InputError, match=r"set compass\.reference = given"):
            pedjax.run(plain.recording, WANG, p)
