"""The pocket's systems: each form beside the naive reference, slopes beside differences, and what a pocket
does to them."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import filtering, parameters, prior
from pedjax.errors import InputError
from pedjax.filters import covariance
from pedjax.recording import Recording, Sensor, Stream
from pedjax.system import Signals, Status
from pedjax.systems import system
from tests.filters.test_pocket_reference import EARTH, HARD_IRON, made
from tests.reference import pocket as naive

PUBLISHED, TWIN, POCKET = (system(name) for name in ("munoz_diaz", "munoz_diaz_twin", "pocket"))


def params(of, **changes):
    """Parameters with changes, `__` for the dot, as arrays."""
    given = {k.replace("__", "."): v for k, v in changes.items()}
    return parameters.cast(parameters.replace(of.defaults(), given), float)


@cache
def troubled(seconds=24.0, **own):
    """A made walk whose magnetometer lacks readings for a while, with a sample of no duration; hard iron."""
    world = made(seconds, mid=True, **own)
    field, dt = world.walk.field.copy(), world.walk.dt.copy()
    field[60:65], field[200] = np.nan, np.nan
    dt[100], field[100] = 0.0, field[99]
    return world.walk._replace(field=field, dt=dt)


@partial(jax.jit, static_argnames=("of", "rate_hz"))
def _run(of, p, signals, dt, rate_hz):
    inputs = of.prepare(p, {"pocket": signals}, dt, rate_hz, len(dt))
    state = of.start(p, None, inputs.opening)
    last, output = filtering.scan(of, p, None, inputs.samples, state)
    return state, last, output


def run(of, p, walk):
    signals = Signals(*(jnp.asarray(x) for x in (walk.force, walk.rate, walk.field)))
    return _run(of, p, signals, jnp.asarray(walk.dt), 20)


def settings_of(p):
    return naive.Settings(
        gravity=float(p.gravity),
        gyroscope=float(p.process.gyroscope),
        bias=float(p.process.gyroscope_bias),
        bias_time=float(p.process.gyroscope_bias_time),
        force=float(p.zero_acceleration.sigma),
        threshold=float(p.zero_acceleration.threshold),
        width=float(p.zero_acceleration.width),
    )


HOW = {("differential", "white"): "differential", ("differential", "moving_average"): "averaged"}


def magnetic_of(p, rate_hz=20):
    q = p.reference
    steady = q.detector == "steady"
    return naive.Magnetic(
        how=HOW.get((q.form, q.noise), q.form),
        noise=float(q.density),
        samples=round(q.window_s * rate_hz) if steady else 1,
        threshold=float(q.threshold) if steady else 1e9,
        width=float(q.width),
        wander=float(q.state.walk),
        deviation=float(q.state.deviation) * q.state.deviates,
        deviation_time=float(q.state.deviation_time),
        hard_iron=q.state.iron,
        hard_iron_wander=float(q.state.iron_walk),
    )


def start_of(state, p, letter):
    fields = getattr(state.aids.get("field_reference"), "fields", ())
    return naive.Start(
        np.asarray(state.estimate.attitude),
        np.asarray(state.estimate.gyroscope_bias),
        np.asarray(covariance.dense(state.P, letter + "g")),
        np.asarray(fields.field) if fields else np.zeros(3),
        float(p.reference.state.sigma),
        float(p.reference.state.iron_sigma),
    )


QUIET = {"process__gyroscope": 1e-3, "reference__density": 0.05, "initial__levelling_s": 0.5}
FORMS = {
    "none": {"reference__form": "none"},
    "differential": {"reference__form": "differential"},
    "moving average": {"reference__form": "differential", "reference__noise": "moving_average"},
    "anchored": {"reference__form": "anchored"},
    "state": {"reference__form": "state", "reference__state__deviates": False},
    "deviation": {"reference__form": "state", "process__gyroscope_bias_time": 50.0},
    "iron": {"reference__form": "state", "reference__state__iron": True},
}
GATES = {
    "hard": {"reference__detector": "steady", "reference__threshold": 2.0},
    "soft": {
        "reference__detector": "steady", "reference__threshold": 1.0, "reference__width": 0.5,
        "zero_acceleration__width": 0.4,
    },
}  # fmt: skip
FAST = {("munoz_diaz", "differential", "hard"), ("munoz_diaz_twin", "iron", "soft")}
SOFTLY = {("munoz_diaz", "differential")} | {
    ("munoz_diaz_twin", form) for form in ("moving average", "anchored", "iron")
}
CASES = [
    pytest.param(*case, id="-".join(case), marks=() if case in FAST else pytest.mark.slow)
    for case in [(s, f, g) for s in ("munoz_diaz", "munoz_diaz_twin") for f in FORMS for g in GATES]
    if case[2] == "hard" or case[:2] in SOFTLY
]


@pytest.mark.parametrize(("name", "form", "gates"), CASES)
def test_each_form_is_the_reference(name, form, gates):
    of = system(name)
    p = params(of, **{**QUIET, **FORMS[form], **GATES[gates]})
    walk = troubled()
    state, last, output = run(of, p, walk)
    chart = "euler" if of is PUBLISHED else "twin"
    letter = "e" if of is PUBLISHED else "t"
    magnetic = magnetic_of(p)
    wanted = getattr(naive, chart)(naive.Walk(*walk), settings_of(p), magnetic, start_of(state, p, letter))
    close = 3e-6 if of is PUBLISHED else 1e-8  # what cuts the block of angles off at 90 degrees tells on all
    np.testing.assert_allclose(output.estimate.attitude, wanted.attitude, atol=close)
    np.testing.assert_allclose(output.estimate.gyroscope_bias, wanted.bias, atol=close / 10)
    np.testing.assert_allclose(output.gates["gravity"].weight, wanted.gravity, atol=1e-9)
    letters = letter + "g" + {"averaged": "n", "state": "m"}.get(magnetic.how, "")
    letters += "d" * (magnetic.how == "state" and magnetic.deviation > 0) + "h" * magnetic.hard_iron
    P = np.asarray(covariance.dense(last.P, letters))
    scale = np.sqrt(np.outer(np.diag(wanted.P), np.diag(wanted.P)))
    assert np.abs((P - wanted.P) / scale).max() < 100 * close
    if magnetic.how == "state":
        np.testing.assert_allclose(output.more["reference_field"], wanted.own["B"], atol=1e-4)
    assert 0.1 < wanted.gravity.mean() < 0.9
    if form != "none":
        assert 0.1 < wanted.field.mean() < 1.0
        assert wanted.field[60:65].max() == 0


def pocket_settings(p):
    q = p.reference
    return naive.PocketSettings(
        gravity=float(p.gravity), gyroscope=float(p.process.gyroscope),
        scale=float(p.process.gyroscope_scale), force=float(p.process.accelerometer),
        bias=float(p.process.gyroscope_bias), bias_time=float(p.process.gyroscope_bias_time),
        hard_iron=float(q.state.iron_walk), field=float(q.state.walk), level_speed=float(p.bounded.level),
        vertical_speed=float(p.bounded.vertical), noise=float(q.density),
        gate_noise=float(q.odd.innovation_sigma), off_strength=float(q.odd.level),
        off_vertical=float(q.odd.vertical), unlikely=float(q.odd.innovation), change=float(q.odd.range),
        hold=float(q.odd.hold), latch=q.state.start == "expected", near=float(q.state.tolerance),
        yaw_sigma=float(q.state.yaw_sigma), memory_waits=True,
    )  # fmt: skip


EARTHLY = {
    "reference__state__level": float(np.hypot(*EARTH[:2])),
    "reference__state__down": float(-EARTH[2]),
    "reference__state__sigma": 2.0,
}


@pytest.mark.parametrize("start", ["expected", "first"])
def test_pocket_is_the_reference(start):
    p = params(POCKET, **EARTHLY, reference__state__start=start, reference__density=0.5)
    walk = troubled(hard_iron=True)
    walk = walk._replace(field=walk.field + (np.arange(len(walk.dt)) < 40)[:, None] * [20.0, 0.0, 5.0])
    state, last, output = run(POCKET, p, walk)
    fields = state.aids["field_reference"].fields
    first = naive.PocketStart(
        *(np.asarray(x) for x in state.estimate[:1]),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.asarray(fields.field),
        np.asarray(covariance.dense(state.P, "tvghm")),
    )
    wanted = naive.pocket(naive.Walk(*walk), pocket_settings(p), first)
    np.testing.assert_allclose(output.estimate.attitude, wanted.attitude, atol=1e-7)
    np.testing.assert_allclose(output.estimate.gyroscope_bias, wanted.bias, atol=1e-8)
    np.testing.assert_allclose(output.estimate.velocity, wanted.velocity, atol=1e-7)
    np.testing.assert_allclose(output.gates["field"].weight, wanted.weight, atol=1e-6)
    P = np.asarray(covariance.dense(last.P, "tvghm"))
    scale = np.sqrt(np.outer(np.diag(wanted.P), np.diag(wanted.P)))
    assert np.abs((P - wanted.P) / scale).max() < 1e-5
    if start == "expected":
        assert not wanted.latched[:40].any()
        assert wanted.latched[-1]
    assert wanted.weight.max() > 0.9
    assert wanted.weight[60:65].max() == 0


# ---- slopes


SLOPES = {
    "munoz_diaz": (
        "zero_acceleration.threshold", "process.gyroscope", "reference.density", "reference.threshold",
    ),
    "munoz_diaz_twin": (
        "reference.state.deviation", "reference.state.deviation_time", "reference.state.walk",
    ),
    "pocket": (
        "bounded.level", "reference.odd.innovation", "reference.odd.hold", "reference.odd.range",
        "process.gyroscope_scale", "reference.state.iron_sigma", "initial.gyroscope_bias",
    ),
}  # fmt: skip
SOFT = {
    "munoz_diaz": {**QUIET, **GATES["soft"]},
    "munoz_diaz_twin": {**QUIET, **GATES["soft"], "reference__state__iron": True},
    "pocket": {**EARTHLY, "reference__density": 0.5},
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n == "pocket" else pytest.mark.slow) for n in SLOPES]
)
def test_slopes_of_the_heading_equal_differences(name):
    """Of the mean square heading error, by detector, noise and start, in one program."""
    of = system(name)
    p = params(of, **SOFT[name])
    world, walk = made(24.0, mid=True), troubled(hard_iron=True)
    signals = Signals(*(jnp.asarray(x) for x in (walk.force, walk.rate, walk.field)))
    inputs = of.prepare(p, {"pocket": signals}, jnp.asarray(walk.dt), 20, len(walk.dt))
    true = jnp.asarray(world.C)

    def error(values):
        q = parameters.with_leaves(p, values)
        state = of.start(q, None, inputs.opening)
        C = filtering.scan(of, q, None, inputs.samples, state, lambda o: o.estimate.attitude)[1]
        turn = jnp.einsum("tij,tkj->tik", C, true)
        angle = jnp.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
        return jnp.mean((angle - angle[0]) ** 2)

    values = {path: jnp.asarray(parameters.get(p, path)) for path in SLOPES[name]}
    loss = jax.jit(error)
    if of is PUBLISHED:  # forward, which of angles compiles in a third of the time
        along = jax.jit(lambda values, way: jax.jvp(error, (values,), (way,))[1])
        zero = jax.tree.map(jnp.zeros_like, values)
        slopes = {path: along(values, {**zero, path: jnp.ones_like(x)}) for path, x in values.items()}
    else:
        slopes = jax.jit(jax.grad(error))(values)
    for path, x in values.items():
        h = 1e-5 * float(x)
        up, down = (float(loss({**values, path: x + s})) for s in (h, -h))
        assert slopes[path] != 0.0, path
        assert slopes[path] == pytest.approx((up - down) / (2 * h), rel=2e-4, abs=1e-8), path


# ---- what a pocket does


def recording(force, rate, field, name="made", rate_hz=20.0):
    time = np.arange(len(force)) / rate_hz
    parts = (Stream(time, x) for x in (force, rate, field))
    return Recording(name, {"pocket": Sensor(*parts)})


def of_walk(walk, start=None, stop=None):
    cut = slice(start, stop)
    return recording(walk.force[cut], walk.rate[cut], walk.field[cut])


def still(seconds, force, field, rate_hz=20.0, noise=0.01):
    rng = np.random.default_rng(4)
    count = round(seconds * rate_hz)
    stirred = [np.asarray(x, float) + noise * rng.normal(size=(count, 3)) for x in (force, field)]
    return recording(stirred[0], 1e-3 * rng.normal(size=(count, 3)), stirred[1])


def own(name, **changes):
    given = {k.replace("__", "."): v for k, v in changes.items()}
    return parameters.replace(system(name).defaults(), given)


def assert_sound(track):
    for values in (*track.estimate.values(), *track.sigma.values()):
        assert np.isfinite(values).all()


def test_angles_end_at_gimbal_lock_and_the_twin_goes_on():
    upright = still(5.0, [9.8, 0.0, 0.05], [-43.0, 3.0, 20.0])  # x up: a pitch of -90 degrees
    found = pedjax.run(upright, "munoz_diaz")
    assert found.status[-1] == Status.GIMBAL
    assert not found.healthy
    assert "angles are not defined" in found.warnings[0]
    for name in ("munoz_diaz_twin", "pocket"):
        track = pedjax.run(upright, name)
        assert_sound(track)
        assert track.status[-1] == 0
    assert_sound(found)


@pytest.mark.parametrize("name", ["munoz_diaz", "munoz_diaz_twin", "pocket"])
def test_ten_minutes_at_rest_break_nothing(name):
    track = pedjax.run(still(600.0, [0.1, 0.3, 9.79], EARTH), name)
    assert_sound(track)
    assert np.abs(np.degrees(track.estimate["gyroscope_bias"][-1])).max() < 0.5
    assert np.degrees(np.abs(track.euler[-1, 2] - track.euler[20, 2])) < 5.0


def test_slopes_are_finite_where_nothing_is_measured():
    """No field, no force, then gimbal lock."""
    for name in ("munoz_diaz", "munoz_diaz_twin", "pocket"):
        of = system(name)
        p = params(of, **({} if name == "pocket" else {**GATES["soft"]}))
        n = 60
        force = jnp.zeros((n, 3)).at[30:].set(jnp.asarray([9.8, 0.0, 0.0]))
        signals = Signals(force, jnp.zeros((n, 3)), jnp.zeros((n, 3)))

        def error(p, of=of, signals=signals, n=n):
            inputs = of.prepare(p, {"pocket": signals}, jnp.full(n, 0.05), 20, n)
            state = of.start(p, None, inputs.opening)
            C = filtering.scan(of, p, None, inputs.samples, state, lambda o: o.estimate.attitude)[1]
            return jnp.sum(C**2 * jnp.arange(9.0).reshape(3, 3))

        if name == "munoz_diaz":  # forward, likewise: along all parameters at once
            ones = jax.tree.map(jnp.ones_like, p)
            slopes = jax.jit(lambda p, ones, error=error: jax.jvp(error, (p,), (ones,))[1])(p, ones)
        else:
            slopes = jax.jit(jax.grad(error))(p)
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(slopes)), name


def test_a_magnetometer_that_pauses_is_no_end():
    """Readings that stop for three seconds, in a file, and altogether for a system of feet."""
    walk = made(24.0, mid=True).walk
    time = np.arange(len(walk.dt)) / 20.0
    keep = (time < 8.0) | (time > 11.0)
    whole = of_walk(walk)
    sensor = whole.sensors["pocket"]
    gap = replace(
        whole, sensors={"pocket": replace(sensor, magnetometer=Stream(time[keep], walk.field[keep]))}
    )
    for name in ("munoz_diaz", "munoz_diaz_twin"):
        track = pedjax.run(gap, name)
        assert track.healthy
        weight = track.gates["field"].weight
        assert weight[(time > 8.6) & (time < 10.4)].max() == 0
        assert weight[time > 11.6].min() > 0.5
    with pytest.raises(InputError, match="no readings"):
        pedjax.run(gap, "ma2018", sensor="pocket")


def test_a_magnet_at_the_start_waits_and_a_lock_out_is_told():
    walk = made(24.0, mid=True).walk
    beside = walk.field + np.where(np.arange(len(walk.dt))[:, None] < 160, [60.0, 20.0, 0.0], 0.0)
    earth = {k: v for k, v in EARTHLY.items() if k.endswith(("level", "down"))}
    track = pedjax.run(recording(walk.force, walk.rate, beside), "pocket", own("pocket", **earth))
    assert track.gates["field"].weight[:160].max() == 0
    assert track.gates["field"].weight[170:].max() > 0.5
    assert track.healthy
    for since, status, said in ((0, Status.NOT_ALIGNED, "aligned"), (160, Status.LOCKED_OUT, "gyroscope")):
        field = walk.field * np.where(np.arange(len(walk.dt))[:, None] < since, 1.0, 3.0)
        locked = recording(walk.force, walk.rate, field)
        track = pedjax.run(locked, "pocket", own("pocket", **earth, reference__patience=10.0))
        assert track.status[-1] == status
        assert not track.healthy
        assert said in track.warnings[0]
        assert_sound(track)


def test_what_the_yaw_was_before_it_is_set_does_not_matter():
    """Biases are learnt before the first reading: errors in navigation axes turn with the yaw."""
    walk = made(24.0, mid=True).walk
    beside = walk.field + np.where(np.arange(len(walk.dt))[:, None] < 240, [60.0, 20.0, 0.0], 0.0)
    walked = recording(walk.force, walk.rate + np.array([0.02, -0.02, 0.01]), beside)
    earth = {k: v for k, v in EARTHLY.items() if k.endswith(("level", "down"))}
    tracks = [pedjax.run(walked, "pocket", own("pocket", **earth, initial__heading=x)) for x in (0.3, 3.0)]
    assert abs(tracks[0].euler[239, 2] - tracks[1].euler[239, 2]) > 1
    for name in ("attitude", "gyroscope_bias", "velocity"):
        a, b = (track.estimate[name][245:] for track in tracks)
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_a_field_that_comes_late_gives_the_place():
    walk = made(24.0, mid=True).walk
    p = params(TWIN, **QUIET)
    late = walk._replace(field=np.where(np.arange(len(walk.dt))[:, None] < 40, np.nan, walk.field))
    _, _, output = run(TWIN, p, late)
    assert output.gates["field"].weight[:40].max() == 0
    east, north, up = output.more["reference_field"][41]  # the yaw is free
    assert abs(np.hypot(east, north) - np.hypot(*EARTH[:2])) < 3
    assert abs(up - EARTH[2]) < 3


def test_odd_readings_need_a_field_that_is_estimated():
    with pytest.raises(InputError, match=r"detector = steady, or form = state"):
        run(TWIN, params(TWIN, reference__form="anchored", reference__detector="odd"), troubled())


# ---- what one walk tells the next


def test_a_prior_and_a_second_pass_are_nearer_to_the_truth(tmp_path):

    walk = made(24.0, mid=True, hard_iron=True).walk
    earth = {k: v for k, v in EARTHLY.items() if k.endswith(("level", "down"))}
    p = own("pocket", **earth, reference__density=0.5)
    bias = np.deg2rad([1.5, -1.0, 2.0])
    biased = recording(walk.force, walk.rate + bias, walk.field)
    truth = bias + np.deg2rad([-0.1, 0.1, -0.1])

    def away(track, at):
        return np.degrees(np.linalg.norm(track.estimate["gyroscope_bias"][at] - truth))

    first = pedjax.run(biased, "pocket", p)
    assert away(first, -1) < 0.3
    told = prior.prior_of(first)
    assert np.allclose(
        [told.gyroscope_bias.x, told.gyroscope_bias.z], first.estimate["gyroscope_bias"][-1][[0, 2]]
    )
    prior.write(tmp_path / "prior.toml", told)
    assert prior.read(tmp_path / "prior.toml") == told
    second = pedjax.run(biased, "pocket", prior.with_prior(p, told))
    again = pedjax.run(biased, "pocket", p, passes=2)
    for track in (second, again):
        assert away(track, 20) < 0.3 < away(first, 20)
    assert np.linalg.norm(again.more["hard_iron"][20] - HARD_IRON) < 1.5


def test_a_prior_for_a_foot_and_for_nobody():

    told = prior.Prior(prior.Known(x=0.01, sigma=0.001, drift=0.002))
    p = prior.with_prior(system("iez").defaults(), told)
    assert (p.initial.bias, p.initial.prior.x) == ("given", 0.01)
    assert p.initial.gyroscope_bias == 0.002
    with pytest.raises(InputError, match="cannot be given a first bias"):
        prior.changes(system("iez").defaults().stance, told)
    with pytest.raises(InputError, match="not be negative"):
        prior.Known(sigma=-1.0)
