"""Ma 2018 against IEZ and against a dense filter with its own looks and decisions, over simulated walks."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import parameters
from pedjax.detectors.field import Look, log_ratio
from pedjax.ensemble import Problem, losses
from pedjax.errors import InputError
from pedjax.filters import compass, hard_iron
from pedjax.packing import pack_all
from pedjax.preparing import prepare
from pedjax.recording import Stream
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.scenarios import Scenario
from pedjax.simulation.world import simulate
from pedjax.systems import SYSTEMS
from pedjax.systems.ma2018 import VALUES
from pedjax.tuning import objective
from pedjax.tuning.loop import gate_widths, gated
from pedjax.walks import walk
from tests import tools
from tests.reference import field as naive
from tests.reference import filter as dense

MA, IEZ = SYSTEMS["ma2018"], SYSTEMS["iez"]
UNSURE = {
    "initial.attitude": 0.02,
    "initial.gyroscope_bias": 0.01,
    "process.gyroscope": 2e-3,
    "updates.zero_velocity": 0.01,
    "compass.looking.levelling": "force",
}
"""Errors large enough for every part of a row to matter."""


def scenario(kind, **field):
    """Three sides of a rectangle, forty seconds."""
    return Scenario(
        name=kind,
        rate_hz=100.0,
        standing_s=2.0,
        legs=(Leg(points=((0.0, 0.0), (16.0, 0.0), (16.0, 12.0), (4.0, 12.0)), radius=1.0),),
        sensors={"foot": "xsens_mtw"},
        field={"kind": kind, **field},
        landmarks=((8.0, 0.0), (16.0, 6.0), (10.0, 12.0), (4.0, 12.0)),
    )


@pytest.fixture(scope="module")
def plain():
    """A walk in a homogeneous field."""
    return simulate(scenario("munich"), 3)


@pytest.fixture(scope="module")
def building():
    """The same walk in an office."""
    return simulate(scenario("building", style="office"), 3)


@pytest.fixture(scope="module")
def both(plain, building):
    return {"munich": plain, "building": building}


LOOSE = {"field.ma.threshold": 170.0, "field.iqsf.threshold": 170.0, "field.qsf.threshold": 11.0}
"""Nearly every look counts, so that there is something to see."""


def ma(**changes):
    """Parameters with changes, `__` for the dot."""
    return parameters.replace(MA.defaults(), LOOSE | {k.replace("__", "."): v for k, v in changes.items()})


def unsure(**changes):
    return parameters.replace(ma(**changes), UNSURE)


def yaw_error(track, made):
    """Degrees, at every sample of a stance."""
    C = made.truth["foot"].motion.attitude
    away = track.euler[:, 2] - np.arctan2(C[:, 1, 0], C[:, 0, 0])
    return np.degrees(np.arctan2(np.sin(away), np.cos(away)))[track.gates["stance"].open]


@pytest.mark.parametrize("where", ["munich", "building"])
def test_without_its_update_it_is_iez(both, where):
    recording = both[where].recording
    track = pedjax.run(recording, "ma2018", ma(compass__update="none", compass__start="given"))
    own = {path: value for path, (value, _) in VALUES.items() if not path.startswith("compass.")}
    iez = pedjax.run(recording, "iez", parameters.replace(IEZ.defaults(), own))
    for name in tools.ORACLE_NAMES:
        np.testing.assert_allclose(track.estimate[name], iez.estimate[name], atol=1e-12, rtol=0, err_msg=name)
    np.testing.assert_allclose(tools.sigmas(track), tools.sigmas(iez), atol=1e-12, rtol=0)
    for kind in ("weight", "log_ratio"):
        ours, theirs = (getattr(t.gates["stance"], kind) for t in (track, iez))
        np.testing.assert_allclose(ours, theirs, atol=1e-12, rtol=0, err_msg=kind)
    assert (track.gates["field"].weight == 0).all()
    assert track.more["look"].sum() > 20


def first_variance(p, seen, readings, given):
    """Of the first heading, without the part that is a parameter."""
    q, level = p.compass, np.hypot(seen[0], seen[1])
    found = (p.initial.attitude * seen[2] / level) ** 2
    found += readings.var(axis=0).mean() / level**2
    if q.reference == "given":
        odd = np.array(
            [naive.strength(seen) - given[0], naive.strength(seen) * (naive.inclination(seen) - given[1])]
        )
        found += (odd @ odd) / 2 / level**2
    return found


MOUNTINGS = [
    axes * np.linalg.det(axes)  # a left-handed one is turned over
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    for signs in ((1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1))
    for axes in [np.diag(signs)[list(order)]]
]
"""Twelve: each body axis up, down, ahead and back."""


def mounted(recording, axes):
    """The same walk with a sensor whose axes are turned."""
    sensor = recording.sensor()
    parts = ("accelerometer", "gyroscope", "magnetometer")
    streams = {name: getattr(sensor, name) for name in parts}
    turned = {name: Stream(x.time, x.values @ axes.T) for name, x in streams.items()}
    return replace(recording, sensors={"foot": replace(sensor, up=None, **turned)})


@pytest.mark.parametrize("levelling", ["force", "attitude"])
@pytest.mark.parametrize("detector", ["ma", "iqsf"])
def test_no_mounting_is_special(building, levelling, detector):
    changes = {"field.detector": detector, "compass.looking.levelling": levelling}
    p = parameters.replace(ma(), changes)
    tracks = [pedjax.run(mounted(building.recording, axes), "ma2018", p) for axes in MOUNTINGS]
    assert (tracks[0].gates["field"].weight > 0.5).sum() > 5
    for track in tracks[1:]:
        for name in ("position", "velocity"):
            ours, first = track.estimate[name], tracks[0].estimate[name]
            np.testing.assert_allclose(ours, first, atol=1e-6, err_msg=name)
        np.testing.assert_array_equal(track.gates["field"].open, tracks[0].gates["field"].open)


def settings_of(p, imu):
    """The dense filter's settings, levelled and turned by the same first samples."""
    first = round(p.initial.levelling_s * imu.rate)
    force, mag = imu.specific_force[:first].mean(axis=0), imu.magnetic_field[:first].mean(axis=0)
    q = p.compass
    offset = np.array([q.level.offset_x, q.level.offset_y])
    soft = np.array([[q.level.xx, q.level.xy], [q.level.xy, q.level.yy]])
    north = np.pi / 2 - q.declination
    C = dense.levelled_attitude(force, p.initial.heading)
    seen = naive.levelled(C, force, mag, offset, soft, "force")
    heading, sigma = p.initial.heading, p.initial.heading_sigma
    given = (q.strength, q.inclination)
    if q.start == "field":
        heading += naive.wrapped(north - naive.azimuth(seen))
        sigma = np.sqrt(q.start_sigma**2 + first_variance(p, seen, imu.magnetic_field[:first], given))
    inertial = replace(tools.oracle_settings(p, force, heading), initial_heading_std=sigma)
    own = p.field.ma
    magnetic = naive.MagneticSettings(
        update=q.update,
        row=q.row,
        levelling=q.looking.levelling,
        per=q.looking.per,
        settle=q.looking.settle_s,
        dwell=q.looking.dwell_s,
        gap=q.looking.gap_s,
        steps=p.field.window,
        threshold=own.threshold,
        width=p.field.width,
        sigmas=(own.sigma_heading, own.sigma_inclination, own.sigma_strength),
        north=north,
        floor=q.noise.floor,
        sigma_field=q.noise.field,
        tilt=q.noise.tilt,
        oddity=q.noise.oddity,
        tail=q.tail,
        reference=(naive.strength(seen), naive.inclination(seen)) if q.reference == "running" else given,
        running=q.reference == "running",
        gyroscope_rows=q.gyroscope_rows,
        offset=offset,
        soft=soft,
    )
    return inertial, magnetic


def compare(recording, p, tolerance=1e-8):
    track = pedjax.run(recording, "ma2018", p)
    assert track.healthy
    assert all(np.isfinite(x).all() for x in track.more.values())
    imu = walk(recording).imu
    expected = naive.run_magnetic(
        imu.dt,
        imu.specific_force,
        imu.angular_rate,
        imu.magnetic_field,
        track.gates["stance"].weight,
        *settings_of(p, imu),
    )
    np.testing.assert_array_equal(track.more["look"], expected["look"])
    looked = expected["look"] > 0
    np.testing.assert_allclose(
        track.gates["field"].weight[looked], expected["weight"][looked], atol=tolerance
    )
    for ours, theirs in tools.ORACLE_NAMES.items():
        np.testing.assert_allclose(
            track.estimate[ours], expected[theirs], atol=tolerance, rtol=0, err_msg=ours
        )
    np.testing.assert_allclose(tools.sigmas(track), np.sqrt(expected["P_diag"]), atol=tolerance, rtol=1e-7)
    assert (expected["weight"] > 0.1).any()
    return track, expected


DENSE = {
    "published": {},
    "levelled by the attitude": {"compass.looking.levelling": "attitude"},
    "heading given": {"compass.start": "given", "initial.heading": 0.4, "initial.heading_sigma": 0.5},
    "simple row": {"compass.row": "simple"},
    "soft, calibrated, odd, heavy tails": {
        "field.width": 0.5,
        "field.ma.threshold": 60.0,
        "compass.level.offset_x": 1.5,
        "compass.level.offset_y": -2.0,
        "compass.level.xx": 1.05,
        "compass.level.xy": 0.03,
        "compass.noise.oddity": 0.7,
        "compass.declination": 0.06,
        "compass.tail": 4.0,
        "gate.width": 0.25,
    },
    "reference given": {"compass.reference": "given", "compass.noise.oddity": 0.5, "field.window": 2},
    "anchored": {"compass.update": "anchored", "compass.looking.levelling": "attitude"},
    "differential": {"compass.update": "differential", "compass.looking.levelling": "attitude"},
    "gyroscope rows": {"compass.gyroscope_rows": True},
    "every sample": {"compass.looking.per": "sample", "field.window": 5, "compass.noise.floor": 0.3},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", DENSE)
def test_it_equals_the_dense_filter(building, name):
    p = unsure()
    compare(building.recording, parameters.replace(p, DENSE[name]))


@pytest.fixture(scope="module")
def prepared(building):
    found = tools.cropped(walk(building.recording), 0, 1600)
    p = parameters.cast(unsure(field__width=0.3, compass__gyroscope_rows=True), float)
    return p, found, prepare(MA, p, found, float, 1600)


HALF = 800
"""A cut in a swing, with three looks behind it in the window."""


def test_cropping_the_end_changes_no_bit(prepared):
    p, found, inputs = prepared
    _, whole = tools.scan(MA, p, inputs.samples, MA.start(p, None, inputs.opening))
    assert whole.gates["field"].weight.max() > 0.5
    cropped = prepare(MA, p, tools.cropped(found, 0, HALF), float, HALF)
    _, part = tools.scan(MA, p, cropped.samples, MA.start(p, None, cropped.opening))
    tools.same_bits(jax.tree.map(lambda x: x[:HALF], whole), part)


def test_two_chunks_equal_one_to_the_bit(prepared):
    p, _, inputs = prepared
    tools.assert_chunks_equal_the_whole(MA, p, inputs, HALF)


LANES = {
    "compass.noise.floor": [0.02, 0.1, 0.3],
    "field.ma.threshold": [170.0, 40.0, 90.0],
    "compass.level.offset_x": [0.0, 3.0, -5.0],
    "compass.declination": [0.0, 0.1, -0.1],
    "initial.heading": [0.0, 0.2, 1.0],
}


def test_lanes_equal_one_by_one(prepared):
    p, _, inputs = prepared
    lanes = parameters.with_leaves(p, {n: jnp.asarray(x) for n, x in LANES.items()})
    _, together = tools.scan(MA, lanes, inputs.samples, MA.start(lanes, None, inputs.opening))
    assert together.estimate.position.shape == (1600, 3, 3)
    for i in range(3):
        one = parameters.with_leaves(p, {n: jnp.asarray(x[i]) for n, x in LANES.items()})
        _, alone = tools.scan(MA, one, inputs.samples, MA.start(one, None, inputs.opening))
        for ours, theirs in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(ours[..., i], theirs, atol=1e-9, rtol=1e-9)


SLOPES = {
    "compass.noise.floor": 0.03,
    "compass.noise.field": 0.3,
    "compass.noise.oddity": 0.3,
    "field.ma.threshold": 80.0,
    "field.ma.sigma_heading": 0.067,
    "compass.level.offset_x": 1.0,
    "compass.start_sigma": 0.1,
    "compass.tail": 20.0,
}


@pytest.mark.slow
@pytest.mark.parametrize("iron", ["fixed", "tracked"])
def test_walks_in_columns_equal_one_by_one(both, iron):
    """Padding and what comes after it included."""
    p = parameters.cast(unsure(compass__hard_iron=iron), float)
    walks = [walk(made.recording) for made in both.values()]
    values = {"compass.noise.floor": jnp.array([0.03, 0.3])}
    problem = Problem(MA, "rms_2d", "none")
    together = losses(problem, p, values, pack_all(MA, p, walks))
    assert together.shape == (2, 2)
    for i, one in enumerate(walks):
        alone = losses(problem, p, values, pack_all(MA, p, [one]))
        np.testing.assert_allclose(together[:, i], alone[:, 0], rtol=1e-9)


TRACKER_SLOPES = {
    "compass.tracker.noise": 0.1,
    "compass.tracker.still": 3.0,
    "compass.tracker.turning": 0.3,
    "compass.tracker.offset": 0.1,
    "compass.tracker.window": 0.1,
    "compass.tracker.threshold": 100.0,
    "compass.tracker.jump": 10.0,
    "compass.tracker.initial_offset": 2.0,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slopes", "more"),
    [(SLOPES, {}), (TRACKER_SLOPES, {"compass__hard_iron": "tracked", "compass__tracker__width": 0.5})],
    ids=["heading", "tracker"],
)
def test_gradients_of_a_landmark_error_equal_differences(building, slopes, more):
    p = unsure(field__width=0.5, gate__width=0.25, **more)
    tools.assert_slopes_of_a_landmark_error_equal_differences(MA, p, building.recording, slopes)


def biased(recording, rate):
    """The recording with a constant added to its gyroscope, rad/s."""
    foot = recording.sensors["foot"]
    gyroscope = Stream(foot.gyroscope.time, foot.gyroscope.values + np.asarray(rate))
    return replace(recording, sensors={"foot": replace(foot, gyroscope=gyroscope)})


def test_a_homogeneous_field_holds_the_heading_of_a_biased_gyroscope(plain):
    drifting = biased(plain.recording, [0.0, 0.0, np.radians(0.5)])
    unit = {"initial.gyroscope_bias": np.radians(0.5)}
    given = yaw_error(pedjax.run(drifting, "iez"), plain)
    assert np.ptp(given) > 12
    held = yaw_error(pedjax.run(drifting, "ma2018", parameters.replace(MA.defaults(), unit)), plain)
    print(f"IEZ drifts by {np.ptp(given):.1f} deg, Ma 2018 is off by at most {np.abs(held).max():.2f} deg")
    assert np.abs(held).max() < 4


def test_the_first_heading_is_the_compass(plain):
    track = pedjax.run(plain.recording, "ma2018")
    declination = np.arctan2(1.2, 21.2)
    assert np.abs(yaw_error(track, plain)).max() < 3
    turned = pedjax.run(plain.recording, "ma2018", ma(compass__declination=declination))
    np.testing.assert_allclose(turned.euler[0, 2], track.euler[0, 2] - declination, atol=1e-6)
    given = pedjax.run(plain.recording, "ma2018", ma(compass__start="given", initial__heading=0.5))
    assert given.euler[0, 2] == pytest.approx(0.5, abs=1e-3)


MAGNET = np.array([12.0, -8.0, 5.0])
IRON = {"compass.hard_iron": "tracked", "compass.tracker.lag_s": 0.004}
"""At 100 Hz sampled rates are half an interval ahead, less what the gyroscope's bandwidth takes."""


def with_magnet(made, on):
    """The recording with a magnet on the foot at samples `on (T,)`."""
    foot = made.recording.sensors["foot"]
    field = foot.magnetometer
    there = replace(foot, magnetometer=Stream(field.time, field.values + on[:, None] * MAGNET))
    return replace(made.recording, sensors={"foot": there})


def from_half(made):
    time = made.recording.sensors["foot"].magnetometer.time
    return time > 0.5 * (time[0] + time[-1])


def test_by_default_no_hard_iron_is_tracked(prepared):
    p, _, inputs = prepared
    assert p.compass.hard_iron == "fixed"
    state = MA.start(p, None, inputs.opening).aids["magnetic_heading"]
    assert inputs.samples.own["magnetic_heading"] == state.tracker == ()
    assert not any("tracker" in path for path in parameters.tunable(p))
    on = parameters.replace(p, {"compass.hard_iron": "tracked"})
    assert set(parameters.tunable(on)) - set(parameters.tunable(p)) <= set(parameters.specs(on))
    assert "compass.tracker.still" in parameters.tunable(on)


def test_tracked_is_taking_the_tracked_offsets_off_beforehand(building):
    """With a magnetometer that is late; and the heading is as much less certain as the offset."""
    rows = {"still": 3.0, "threshold": 100.0, "initial_offset": 5.0}
    tracker = {f"compass__tracker__{k}": v for k, v in rows.items()}
    tracked = unsure(
        compass__update="none", initial__levelling_s=0.0, compass__hard_iron="tracked",
        compass__tracker__lag_s=0.013, **tracker,
    )  # fmt: skip
    tracked = parameters.cast(tracked, float)
    found = tools.cropped(walk(with_magnet(building, from_half(building))), 1000, 2600)
    inputs, imu = prepare(MA, tracked, found, float, 1600), found.imu
    _, ours = tools.scan(MA, tracked, inputs.samples, MA.start(tracked, None, inputs.opening))

    alone = parameters.cast(parameters.replace(hard_iron.HardIronParameters(), {**rows, "lag": 0.013}), float)
    iron = jax.jit(hard_iron.track_hard_iron)(imu.angular_rate, imu.magnetic_field, imu.dt, alone)
    np.testing.assert_allclose(ours.more["hard_iron"], iron.offset, atol=1e-9)
    np.testing.assert_allclose(ours.more["hard_iron_sigma"], iron.sigma, atol=1e-9)
    assert np.abs(iron.offset[-1]).max() > 3.0
    fixed = parameters.replace(tracked, {"compass.hard_iron": "fixed"})
    sensor = inputs.samples.sensor
    sensor = sensor._replace(field=sensor.field - iron.offset)
    samples = inputs.samples._replace(sensor=sensor, own={**inputs.samples.own, "magnetic_heading": ()})
    _, theirs = tools.scan(MA, fixed, samples, MA.start(fixed, None, inputs.opening))
    for name in set(theirs.more) - {"heading_sigma"}:
        np.testing.assert_allclose(ours.more[name], theirs.more[name], atol=1e-9, err_msg=name)
    same = (ours.estimate, ours.sigma), (theirs.estimate, theirs.sigma)
    for a, b in zip(*map(jax.tree.leaves, same), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)

    at = theirs.more["look"] > 0
    assert at.sum() > 10
    level = np.linalg.norm(theirs.more["magnetic_field"][at, :2], axis=1)
    added = np.sqrt(ours.more["heading_sigma"] ** 2 - theirs.more["heading_sigma"] ** 2)[at] * level
    sigma = np.linalg.norm(iron.sigma, axis=1)[at]
    assert (added > 0).all()
    assert (added < sigma).all()
    assert added[sigma.argmax()] > added[sigma.argmin()]


def test_every_gate_is_softened_for_the_gradient():
    """A threshold behind a hard gate has no slope."""
    widths = {path for path in parameters.specs(MA.defaults()) if path.endswith("width")}
    assert set(gate_widths(MA.defaults())) == widths


def test_the_heading_is_as_unsure_as_the_offset_across_the_field():
    """By drawing offsets."""
    rng = np.random.default_rng(4)
    attitude = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    root = rng.normal(size=(3, 3)) * [[1.0], [0.2], [2.0]]
    field = np.array([12.0, 16.0, -40.0])
    ours = compass.offset_variance(*map(jnp.asarray, (attitude, field, root @ root.T)))
    moved = field + 1e-4 * rng.normal(size=(40000, 3)) @ (attitude @ root).T
    drawn = np.std(np.arctan2(moved[:, 1], moved[:, 0])) / 1e-4
    assert float(ours) ** 0.5 == pytest.approx(drawn, rel=0.02)


def test_a_magnet_put_on_while_walking_is_found(plain):
    """Within a stride, and the heading is as if it were not there."""
    on = from_half(plain)
    recording = with_magnet(plain, on)
    p = parameters.replace(MA.defaults(), IRON)
    tracks = {
        "nothing put on": pedjax.run(plain.recording, "ma2018"),
        "fixed": pedjax.run(recording, "ma2018"),
        "tracked": pedjax.run(recording, "ma2018", p),
    }
    late = {name: yaw_error(t, plain)[on[t.gates["stance"].open]] for name, t in tracks.items()}
    none, fixed, tracked = (float(np.sqrt(np.mean(x**2))) for x in late.values())
    print(f"yaw off by {none:.1f} deg with nothing put on, {fixed:.1f} fixed, {tracked:.1f} tracked")
    assert tracked < none + 0.3 < 0.5 * fixed
    more = tracks["tracked"].more
    away = np.linalg.norm(more["hard_iron"] - on[:, None] * MAGNET, axis=1)
    begins = int(np.flatnonzero(on)[0])
    assert away[:begins].max() < 0.5
    assert away[begins + 100 :].max() < 0.5
    np.testing.assert_array_less(more["hard_iron_sigma"][begins + 500 :], 0.6)


def test_no_heading_is_certain_until_turning_tells(plain):
    """A magnet put on in a stance, some samples before its look."""
    p = parameters.replace(MA.defaults(), IRON)
    before = pedjax.run(plain.recording, "ma2018", p).more
    looks = np.flatnonzero(before["look"])
    for look, samples in ((looks[8], 2), (looks[12], 8)):
        on = np.arange(len(before["look"])) >= look - samples
        more = pedjax.run(with_magnet(plain, on), "ma2018", p).more
        assert more["look"][look] == 1
        known, doubted = (float(np.degrees(x["heading_sigma"][look])) for x in (before, more))
        print(f"heading noise at the look: {known:.1f}, with the magnet {doubted:.0f} deg")
        assert doubted > 5 * known
        assert doubted > 12


CHOICES = [
    {"compass.update": "anchored"},
    {"compass.update": "differential", "compass.row": "simple", "compass.looking.per": "sample"},
    {"field.straight_through": True, "field.width": 0.3},
    {"compass.hard_iron": "tracked", "compass.update": "anchored", "compass.gyroscope_rows": True},
    *({"field.detector": d} for d in ("qsf", "qmd", "magyq", "iqsf", "aiez", "vector")),
]
"""What no dense filter is there for."""


@pytest.mark.slow
@pytest.mark.parametrize("change", CHOICES, ids=lambda c: " ".join(str(v) for v in c.values()))
def test_every_choice_runs(building, change):
    track = pedjax.run(building.recording, "ma2018", parameters.replace(MA.defaults(), change))
    assert track.healthy
    assert np.isfinite(track.position).all()
    assert all(np.isfinite(x).all() for x in track.more.values())
    assert np.linalg.norm(track.position - walk_truth(building), axis=1).max() < 12


def walk_truth(made):
    place = made.truth["foot"].motion.position
    return place - place[0]


def test_what_is_seen_is_the_field_of_the_place(plain):
    """Each look finds the homogeneous field, as strong as it is; and is judged as quasi-static."""
    track = pedjax.run(plain.recording, "ma2018", unsure())
    at = track.more["look"] > 0
    steps = track.gates["stance"].stretches(track.time).max() + 1
    assert 0.9 * steps <= at.sum() <= steps
    size = np.linalg.norm(track.more["magnetic_field"][at], axis=1)
    assert np.abs(size - np.linalg.norm(plain.truth["foot"].magnetic_field[0])).max() < 3
    np.testing.assert_allclose(track.gates["field"].weight[at], np.arange(at.sum()) >= 3, atol=1e-5)
    assert (track.gates["field"].weight[~at] == 0).all()


def test_ratios_of_looks_are_those_of_the_run(building):
    """With no update nothing turns the looks: windows of what was put out give what the step decided by."""
    p = parameters.cast(unsure(compass__update="none"), float)
    track = pedjax.run(building.recording, "ma2018", p)
    at = np.flatnonzero(track.more["look"] > 0)
    b, yaw, time = (x[at] for x in (track.more["magnetic_field"], track.euler[:, 2], track.time))
    stop = len(at) - 3
    variance = track.sigma["attitude"][at, 2] ** 2
    looks = (b, yaw, time, variance)
    window = tuple(Look(*(jnp.asarray(x[k : k + stop].T) for x in looks)) for k in range(4))
    found = track.gates["field"].log_ratio[at]
    np.testing.assert_allclose(found[3:], log_ratio(p.field, window, jnp.asarray(np.pi / 2)), atol=1e-9)
    assert (found[:3] == 10).all()


def test_a_recording_without_a_magnetometer_is_refused(plain, minute_recording):
    with pytest.raises(InputError, match="'ma2018' needs a magnetometer and this sensor has none"):
        pedjax.run(minute_recording, "ma2018")
    foot = plain.recording.sensors["foot"]
    without = replace(plain.recording, sensors={"foot": replace(foot, magnetometer=None)})
    assert pedjax.run(without, "iez").healthy
    with pytest.raises(InputError, match="--system"):
        pedjax.run(without, "ma2018")


@pytest.mark.parametrize("where", ["munich", "building"])
def test_single_precision_is_close(both, where):
    p = MA.defaults()
    double = pedjax.run(both[where].recording, "ma2018", p)
    with jax.enable_x64(False):
        single = pedjax.run(both[where].recording, "ma2018", p)
    assert single.position.dtype == np.float32
    np.testing.assert_array_equal(single.more["look"], double.more["look"])
    away = np.linalg.norm(single.position - double.position, axis=1).max()
    print(f"{where}: float32 is off by at most {away:.1e} m")
    assert away < 2e-3


@pytest.mark.parametrize("name", ["compass.noise.floor", "compass.declination", "updates.zero_velocity"])
def test_one_number_alone_has_a_gradient(plain, name):
    """Most of the state does not move with it: what stays must not be taken for something that moves."""
    p = parameters.cast(gated(ma(), 0.25), float)
    batches = pack_all(MA, p, [walk(plain.recording)])
    free = {name: jnp.zeros(1)}
    problem = Problem(MA, "armse", "yaw_translation")
    traced = jax.jit(objective.GRADIENTS["reverse"], static_argnums=0).trace(problem, p, free, batches)
    gradient = jax.tree.leaves(traced.out_info[1])
    assert [x.shape for x in gradient] == [(1,)]
