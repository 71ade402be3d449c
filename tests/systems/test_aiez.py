"""AIEZ against Ma 2018 where they must agree, locked out and brought back, and whole under every choice."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import parameters
from pedjax.errors import InputError
from pedjax.preparing import prepare
from pedjax.recording import Stream
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.scenarios import Scenario
from pedjax.simulation.world import simulate
from pedjax.systems import SYSTEMS
from pedjax.walks import walk
from tests import tools

AIEZ, MA, IEZ = SYSTEMS["aiez"], SYSTEMS["ma2018"], SYSTEMS["iez"]


def made(kind, **field):
    """Three sides of a rectangle, forty seconds."""
    scenario = Scenario(
        name=kind,
        rate_hz=100.0,
        standing_s=2.0,
        legs=(Leg(points=((0.0, 0.0), (16.0, 0.0), (16.0, 12.0), (4.0, 12.0)), radius=1.0),),
        sensors={"foot": "xsens_mtw"},
        field={"kind": kind, **field},
        landmarks=((8.0, 0.0), (16.0, 6.0), (10.0, 12.0), (4.0, 12.0)),
    )
    return simulate(scenario, 3)


@pytest.fixture(scope="module")
def plain():
    return made("munich")


@pytest.fixture(scope="module")
def building():
    return made("building", style="office")


def aiez(**changes):
    """Parameters with changes, `__` for the dot."""
    return parameters.replace(AIEZ.defaults(), {k.replace("__", "."): v for k, v in changes.items()})


def test_with_an_open_gate_and_nothing_beside_it_is_ma_2018(building):
    """The same parts: where every look counts, the detectors cannot differ."""
    ours = aiez(
        field__aiez__threshold=1e6, heuristic__form="none", compass__recovery="none", initial__bias="zero"
    )
    same = parameters.values(ours)
    theirs = {path: same[path] for path in parameters.values(MA.defaults())}
    theirs |= {"field.detector": "ma", "field.ma.threshold": 9e6}
    a = pedjax.run(building.recording, AIEZ, ours)
    b = pedjax.run(building.recording, MA, parameters.replace(MA.defaults(), theirs))
    assert a.gates["field"].open.sum() > 15
    np.testing.assert_allclose(a.position, b.position, atol=1e-9)
    np.testing.assert_allclose(a.attitude, b.attitude, atol=1e-9)


def test_without_compass_and_heuristic_it_is_iez(plain):
    ours = aiez(
        compass__update="none", compass__start="given", compass__recovery="none", heuristic__form="none"
    )
    same = parameters.values(ours)
    theirs = parameters.replace(
        IEZ.defaults(), {path: same[path] for path in parameters.values(IEZ.defaults())}
    )
    a, b = pedjax.run(plain.recording, AIEZ, ours), pedjax.run(plain.recording, IEZ, theirs)
    np.testing.assert_allclose(a.position, b.position, atol=1e-9)


def glitched(walked, degrees, at):
    """The recording with one sample that turns the gyroscope about up, in the stance nearest to `at` s; and
    the index of that sample."""
    truth, foot = walked.truth["foot"], walked.recording.sensors["foot"]
    still = np.flatnonzero(truth.stance)
    k = int(still[np.argmin(np.abs(truth.time[still] - truth.time[0] - at))])
    rate = foot.gyroscope.values.copy()
    rate[k] += np.radians(degrees) * 100.0 * truth.motion.attitude[k, 2]
    sensor = replace(foot, gyroscope=Stream(foot.gyroscope.time, rate))
    return replace(walked.recording, sensors={"foot": sensor}), k


def yaw_error(track, walked):
    """Degrees, at every sample."""
    attitude = walked.truth["foot"].motion.attitude
    truth = np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0])
    return np.abs(np.degrees(np.angle(np.exp(1j * (track.euler[:, 2] - truth)))))


@pytest.fixture(scope="module")
def tracks(plain):
    """Of a foot whose yaw was turned by 60 degrees in the middle of the first leg."""
    recording, k = glitched(plain, 60.0, 9.0)
    given = {"compass__start": "given", "initial__heading": float(yaw_of_start(plain))}
    changes = {
        "printed": {"compass__recovery": "none", "field__aiez__yaw_variance": False},
        "variance": {"compass__recovery": "none"},
        "rivals": {},
    }
    return k, {name: pedjax.run(recording, AIEZ, aiez(**given, **c)) for name, c in changes.items()}


def yaw_of_start(walked):
    first = walked.truth["foot"].motion.attitude[0]
    return np.arctan2(first[1, 0], first[0, 0])


def test_the_printed_gate_is_locked_out_for_ever(plain, tracks):
    k, found = tracks
    for name in ("printed", "variance"):
        error = yaw_error(found[name], plain)
        assert error[:k].max() < 3.0
        assert error[k + 5 :].min() > 50.0, name
        looks = found[name].more["look"][k + 5 :] > 0
        assert not found[name].gates["field"].open[k + 5 :][looks].any()


def test_a_rival_brings_it_back_path_and_all(plain, tracks):
    k, found = tracks
    track = found["rivals"]
    over = np.flatnonzero(track.more["took_over"] > 0)
    assert len(over) == 1
    strides = (track.more["look"][k : over[0] + 1] > 0).sum()
    print(f"{strides} looks, {0.01 * (over[0] - k):.1f} s")
    assert 4 <= strides <= 9
    assert yaw_error(track, plain)[over[0] + 5 :].max() < 6.0
    place = plain.truth["foot"].motion.position
    away = np.linalg.norm(track.position[-1, :2] - (place[-1] - place[0])[:2])
    assert away < 1.5  # the eight metres that were walked at 60 degrees are turned back, too
    assert np.linalg.norm(found["variance"].position[-1, :2] - (place[-1] - place[0])[:2]) > 8.0


def test_nobody_takes_over_where_nothing_is_wrong(plain, building):
    for walked in (plain, building):
        track = pedjax.run(walked.recording, AIEZ)
        assert not track.more["took_over"].any()
    calm = pedjax.run(plain.recording, AIEZ, aiez(compass__recovery="none"))
    watched = pedjax.run(plain.recording, AIEZ)
    np.testing.assert_allclose(watched.position, calm.position, atol=2e-5)


FORMS = ("hdr", "slope", "integrator", "hde", "ihde", "mihde", "von_mises")
SHORT = {"heuristic__straight__strides": 3, "heuristic__straight__angle": 0.2}


@pytest.fixture(scope="module")
def prepared(building):
    found = tools.cropped(walk(building.recording), 0, 1600)
    p = parameters.cast(
        aiez(
            **SHORT, heuristic__form="von_mises", heuristic__directions__strides=2.0, tilt__rows="level",
            heuristic__straight__width=0.3, field__width=0.3, heuristic__beside="always",
        ),
        float,
    )  # fmt: skip
    return p, found, prepare(AIEZ, p, found, float, 1600)


HALF = 800


def test_cropping_the_end_changes_no_bit(prepared):
    p, found, inputs = prepared
    _, whole = tools.scan(AIEZ, p, inputs.samples, AIEZ.start(p, None, inputs.opening))
    assert whole.gates["straight"].weight.max() > 0.5
    assert np.abs(whole.more["deviation"]).max() > 0
    cropped = prepare(AIEZ, p, tools.cropped(found, 0, HALF), float, HALF)
    _, part = tools.scan(AIEZ, p, cropped.samples, AIEZ.start(p, None, cropped.opening))
    tools.same_bits(jax.tree.map(lambda x: x[:HALF], whole), part)


def test_two_chunks_equal_one_to_the_bit(prepared):
    p, _, inputs = prepared
    tools.assert_chunks_equal_the_whole(AIEZ, p, inputs, HALF)


LANES = {
    "compass.rival.fresh": [20.0, 5.0, 50.0],
    "field.aiez.threshold": [6.0, 2.0, 90.0],
    "heuristic.von_mises.sigma": [0.05, 0.1, 0.02],
    "heuristic.straight.angle": [0.2, 0.1, 0.3],
    "tilt.sigma": [0.05, 0.2, 0.02],
}


def test_lanes_equal_one_by_one(prepared):
    p, _, inputs = prepared
    lanes = parameters.with_leaves(p, {n: jnp.asarray(x) for n, x in LANES.items()})
    _, together = tools.scan(AIEZ, lanes, inputs.samples, AIEZ.start(lanes, None, inputs.opening))
    assert together.estimate.position.shape == (1600, 3, 3)
    for i in range(3):
        one = parameters.with_leaves(p, {n: jnp.asarray(x[i]) for n, x in LANES.items()})
        _, alone = tools.scan(AIEZ, one, inputs.samples, AIEZ.start(one, None, inputs.opening))
        for ours, theirs in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(ours[..., i], theirs, atol=1e-9, rtol=1e-9)


SLOPES = {
    "von_mises": {
        "field.aiez.threshold": 6.0, "field.aiez.sigma_heading": 0.1, "field.aiez.sigma_strength": 3.0,
        "compass.noise.floor": 0.07, "heuristic.straight.angle": 0.2, "heuristic.von_mises.sigma": 0.05,
        "heuristic.von_mises.share": 0.5, "heuristic.directions.error": 0.005, "tilt.sigma": 0.1,
        "initial.sway": 0.004,
    },
    "slope": {"heuristic.slope.sigma": 0.05, "heuristic.straight.angle": 0.2},
    "hde": {"heuristic.hde.gain": 1e-4, "heuristic.hde.softness": 0.02},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("form", SLOPES)
def test_gradients_of_a_landmark_error_equal_differences(building, form):
    """Compass, detector and heuristic, through the whole filter."""
    slopes = SLOPES[form]
    p = aiez(
        **SHORT, heuristic__form=form, heuristic__beside="always", heuristic__straight__width=0.5,
        heuristic__slope__least=3.0, heuristic__directions__strides=2.0, field__width=0.5, gate__width=0.25,
        tilt__rows="level",
    )  # fmt: skip
    tools.assert_slopes_of_a_landmark_error_equal_differences(AIEZ, p, building.recording, slopes, 2e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "form"),
    [*(("aiez", form) for form in FORMS), ("iez", "ihde"), ("iez", "mihde"), ("ma2018", "hdr")],
)
def test_forms_run_in_every_system(plain, name, form):
    chosen = parameters.replace(SYSTEMS[name].defaults(), {"heuristic.form": form})
    if name == "iez" and form == "mihde":
        with pytest.raises(InputError, match=r"heuristic\.form = mihde needs a magnetic heading"):
            pedjax.run(plain.recording, name, chosen)
        return
    track = pedjax.run(plain.recording, name, chosen)
    assert track.healthy
    assert track.more["stride_end"].sum() > 15
