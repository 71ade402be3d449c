"""Wang 2018 against Ma 2018 where they must agree, and whole under cropping, chunks, lanes and gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import config, parameters
from pedjax.preparing import prepare
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.scenarios import Scenario
from pedjax.simulation.world import simulate
from pedjax.systems import SYSTEMS
from pedjax.walks import walk
from tests import tools

WANG, MA, IEZ = SYSTEMS["wang"], SYSTEMS["ma2018"], SYSTEMS["iez"]
MUNICH = {"compass.strength": 48.0, "compass.inclination": float(np.radians(64.0))}


@pytest.fixture(scope="module")
def walked():
    """Two sides of a rectangle past a bump, after a stand that a car passes."""
    scenario = Scenario(
        name="street",
        rate_hz=100.0,
        standing_s=4.0,
        legs=(Leg(points=((0.0, 0.0), (14.0, 0.0), (14.0, 8.0)), radius=1.0),),
        sensors={"foot": "xsens_mtw"},
        field={"kind": "outdoors", "bumps": 2, "car": 15.0},
        landmarks=((8.0, 0.0), (14.0, 6.0)),
    )
    return simulate(scenario, 5)


def wang(**changes):
    """Parameters with changes, `__` for the dot."""
    given = MUNICH | {k.replace("__", "."): v for k, v in changes.items()}
    return parameters.replace(WANG.defaults(), given)


def same_values(system, params):
    """Another system's parameters with the same values."""
    known = parameters.values(params)
    return parameters.replace(
        system.defaults(), {path: known[path] for path in parameters.values(system.defaults())}
    )


PLAIN = {"compass__compensation__mode": "none", "compass__adaptive__law": "none"}


def test_with_nothing_of_its_own_it_is_ma_2018(walked):
    """The same parts: levelled, nothing compensated, a fixed noise, every look counts."""
    ours = wang(initial__alignment="levelling", **PLAIN)
    theirs = same_values(MA, ours)
    a, b = (pedjax.run(walked.recording, *one) for one in ((WANG, ours), (MA, theirs)))
    assert a.gates["field"].open.sum() > 15
    np.testing.assert_allclose(a.position, b.position, atol=1e-9)


def test_any_system_with_a_compass_takes_the_aligned_start(walked):
    ours = wang(initial__alignment="weighted", **PLAIN)
    found = {s.name: pedjax.run(walked.recording, s, same_values(s, ours)) for s in (WANG, MA)}
    aiez = parameters.replace(SYSTEMS["aiez"].defaults(), {"initial.alignment": "weighted", **MUNICH})
    found["aiez"] = pedjax.run(walked.recording, "aiez", aiez)
    np.testing.assert_allclose(found["wang"].position, found["ma2018"].position, atol=1e-9)
    np.testing.assert_allclose(found["wang"].attitude[0], found["aiez"].attitude[0], atol=1e-3)


def test_without_headings_it_is_iez_with_that_start(walked):
    ours = wang(
        initial__alignment="levelling", compass__start="given", compass__update="none", initial__heading=0.4
    )
    a = pedjax.run(walked.recording, WANG, ours)
    b = pedjax.run(walked.recording, IEZ, same_values(IEZ, ours))
    np.testing.assert_allclose(a.position, b.position, atol=1e-9)


def test_what_passes_during_the_stand_is_left_out_by_the_weighted_one_alone(walked):
    attitude = walked.truth["foot"].motion.attitude[0]

    def off(method):
        track = pedjax.run(walked.recording, WANG, wang(initial__alignment=method))
        turn = track.attitude[0] @ attitude.T
        return abs(np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])))

    weighted, triad = off("weighted"), off("triad")
    print(f"weighted {weighted:.2f}, triad {triad:.2f} deg")
    assert weighted < 1.5
    assert triad > 2 * weighted


@pytest.fixture(scope="module")
def prepared(walked):
    found = tools.cropped(walk(walked.recording), 0, 1400)
    p = wang(
        initial__align__check="mend", updates__adaptive__law="trace", compass__adaptive__law="windowed",
        gate__width=0.25,
    )  # fmt: skip
    p = parameters.cast(p, float)
    return p, found, prepare(WANG, p, found, float, 1400)


HALF = 800


def test_cropping_the_end_changes_no_bit(prepared):
    p, found, inputs = prepared
    _, whole = tools.scan(WANG, p, inputs.samples, WANG.start(p, None, inputs.opening))
    assert whole.more["look"][:HALF].sum() > 10
    cropped = prepare(WANG, p, tools.cropped(found, 0, HALF), float, HALF)
    _, part = tools.scan(WANG, p, cropped.samples, WANG.start(p, None, cropped.opening))
    tools.same_bits(jax.tree.map(lambda x: x[:HALF], whole), part)


def test_two_chunks_equal_one_to_the_bit(prepared):
    p, _, inputs = prepared
    tools.assert_chunks_equal_the_whole(WANG, p, inputs, HALF)


LANES = {
    "initial.align.gain": [20.0, 10.0, 30.0],
    "compass.strength": [48.0, 47.0, 50.0],
    "compass.body.hard_x": [0.0, 1.0, -2.0],
    "compass.adaptive.scale": [1.0, 0.5, 3.0],
}


def test_lanes_equal_one_by_one(prepared):
    p, _, inputs = prepared
    lanes = parameters.with_leaves(p, {n: jnp.asarray(x) for n, x in LANES.items()})
    _, together = tools.scan(WANG, lanes, inputs.samples, WANG.start(lanes, None, inputs.opening))
    assert together.estimate.position.shape == (1400, 3, 3)
    for i in range(3):
        one = parameters.with_leaves(p, {n: jnp.asarray(x[i]) for n, x in LANES.items()})
        _, alone = tools.scan(WANG, one, inputs.samples, WANG.start(one, None, inputs.opening))
        for ours, theirs in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(ours[..., i], theirs, atol=1e-9, rtol=1e-9)


def test_a_sweep_starts_each_recording_by_its_own_stand(walked):
    """Packed with a recording of another length, as alone."""
    other = simulate(walked.scenario, 6).recording
    recordings = [walked.recording, tools.crop(other, 25.0)]
    values = {"initial.align.gain": np.array([20.0, 5.0]), "compass.noise.floor": np.array([0.12, 0.3])}
    table = pedjax.sweep(recordings, values, WANG, wang(), loss="rms_2d", alignment="none")
    for n in range(2):
        p = parameters.replace(wang(), {name: float(x[n]) for name, x in values.items()})
        for r, recording in enumerate(recordings):
            score = pedjax.evaluate(pedjax.run(recording, WANG, p), recording, alignment="none")
            assert table.loss[n, r] == pytest.approx(score.rms_2d_m, rel=2e-3)


@pytest.mark.parametrize("name", ["wang", "wang_basic", "wang_agda", "wang_alpha_zero", "wang_best"])
def test_presets_walk_the_street(walked, name):
    system, params = config.resolve(config.load(name))
    given = dict(MUNICH)
    if params.compass.start == "given":
        attitude = walked.truth["foot"].motion.attitude[0]
        given["initial.heading"] = float(np.arctan2(attitude[1, 0], attitude[0, 0]))
    track = pedjax.run(walked.recording, system, parameters.replace(params, given))
    place = walked.truth["foot"].motion.position
    assert track.healthy
    away = np.linalg.norm(track.position[-1, :2] - (place[-1] - place[0])[:2])
    assert away < (3.0 if name == "wang_alpha_zero" else 1.0)  # bumps count in full there


def test_a_run_says_where_the_given_field_does_not_fit(walked):
    fits = pedjax.run(walked.recording, WANG, wang())
    assert not fits.warnings
    wrong = {"compass.strength": 40.0, "compass.inclination": -0.2}
    (note, *_) = pedjax.run(walked.recording, WANG, parameters.replace(wang(), wrong)).warnings
    assert "the field is 4" in note
    assert "dips 64 degrees" in note
    assert "compass.strength says 40.0 and compass.inclination -11" in note
    assert "compass.reference = running" in note


SLOPES = {
    "agda": {
        "initial.align.gain": 20.0, "initial.align.decay": 0.7, "compass.adaptive.scale": 1.0,
        "compass.adaptive.softness": 0.5, "compass.noise.floor": 0.12, "compass.noise.oddity": 1.0,
    },
    "weighted": {"initial.align.strength_spread": 1.0, "initial.align.dip_spread": 0.02},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("method", SLOPES)
def test_gradients_of_a_landmark_error_equal_differences(walked, method):
    p = wang(
        initial__alignment=method, initial__align__covariance="measured", gate__width=0.25,
        compass__compensation__mode="none",
    )  # fmt: skip
    tools.assert_slopes_of_a_landmark_error_equal_differences(WANG, p, walked.recording, SLOPES[method])
