"""The pocket's systems: each form beside the naive reference, slopes beside differences, and what a pocket
does to them."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import filtering, parameters
from pedjax.filters import covariance
from pedjax.system import Signals
from pedjax.systems import system
from tests.filters.test_pocket_reference import EARTH, made
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
FAST = {("munoz_diaz", "differential", "hard"), ("munoz_diaz_twin", "deviation", "soft")}
CASES = [
    pytest.param(*case, id="-".join(case), marks=() if case in FAST else pytest.mark.slow)
    for case in [(s, f, g) for s in ("munoz_diaz", "munoz_diaz_twin") for f in FORMS for g in GATES]
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
