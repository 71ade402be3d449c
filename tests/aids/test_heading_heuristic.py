"""The heading heuristic in a system, on a short walk: its strides, what it changes, and when."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.aids import HEADING_HEURISTIC, ZERO_VELOCITY, Aid, Measured, aided
from pedjax.errors import InputError
from pedjax.filters.inertial import INERTIAL
from pedjax.lanes import matvec
from pedjax.preparing import prepare
from pedjax.rotations import from_euler
from pedjax.walks import walk
from tests import tools

COUNT, TURN = 1400, 0.4
STANDING = 715
"""A sample in a stance, some time after its stride was counted; see `test_strides_are_those_of_the_track`."""

BARE = aided("bare", INERTIAL, (ZERO_VELOCITY,))
WALKER = aided("walker", INERTIAL, (ZERO_VELOCITY, HEADING_HEURISTIC))
GENTLE = {
    "heuristic.straight.strides": 2,
    "heuristic.straight.angle": 0.5,
    "heuristic.straight.width": 0.3,
    "heuristic.slope.least": 3.0,
    "heuristic.slope.longest": 5.0,
    "heuristic.slope.far": 100.0,
    "heuristic.directions.strides": 1.5,
    "heuristic.directions.sure": 1.0,
    "heuristic.ihde.tolerance": 0.5,
    "initial.gyroscope_bias": 0.01,
}
"""The made walk turns by six degrees or so at each stride: all of that passes as straight."""


def turned_at(sample):
    """An aid that turns the whole path by `TURN` once, in that stance."""

    def step(p, site, count, seen):
        nav = seen.estimate
        yaw = jnp.where(count == sample, TURN, 0.0) + 0.0 * nav.position[0]
        R = from_euler(0 * yaw, 0 * yaw, yaw)
        nothing = jnp.zeros_like(nav.position)
        moves = {
            "t": jnp.stack([0 * yaw, 0 * yaw, yaw]),
            "p": matvec(R, nav.position) - nav.position,
            "v": matvec(R, nav.velocity) - nav.velocity,
        }
        correction = {state: moves.get(state, nothing) for state in "tgpva"}
        return Measured(count + 1, None, None, moved=(seen.P, correction))

    return Aid("turner", step, start=lambda p, site, opening, nav, P: (jnp.zeros(()), nav, P))


@pytest.fixture(scope="module")
def found(minute_recording):
    return tools.cropped(walk(minute_recording), 0, COUNT)


def told(system, found, count=COUNT, **changes):
    """Parameters and inputs of the walk's first samples."""
    values = {k.replace("__", "."): v for k, v in (tools.shoe_sigmas() | changes).items()}
    known = parameters.values(system.defaults())
    values = {k: v for k, v in (GENTLE | values).items() if k in known}
    p = parameters.cast(parameters.replace(system.defaults(), values), float)
    return p, prepare(system, p, tools.cropped(found, 0, count), float, count)


def over(system, found, **changes):
    p, inputs = told(system, found, **changes)
    return tools.scan(system, p, inputs.samples, system.start(p, None, inputs.opening))[1]


def test_strides_are_those_of_the_track(found):
    """Counted again from stances and positions, one by one; with rows that tell next to nothing."""
    out = over(WALKER, found, heuristic__form="hdr", heuristic__hdr__sigma=10.0)
    still, place = np.asarray(out.gates["stance"].weight), np.asarray(out.estimate.position)
    since, moving, used, last, ends, headings = 0, 0, False, place[0], [], []
    for k in range(COUNT):
        moving = 0 if still[k] > 0.5 else moving + 1
        if moving > 15:
            since, used = 0, False
        since += still[k] > 0.5
        if since >= 6 and not used:
            used, stride = True, place[k] - last
            last = place[k]
            if np.hypot(*stride[:2]) > 0.3:
                ends.append(k)
                headings.append(np.arctan2(stride[1], stride[0]))
    assert 9 < len(ends) < 14
    np.testing.assert_array_equal(np.flatnonzero(out.more["stride_end"]), ends)
    np.testing.assert_allclose(np.asarray(out.more["stride_heading"])[ends], headings, atol=1e-3)
    counts = np.asarray(out.gates["straight"].weight)
    assert set(np.flatnonzero(counts)) == set(ends[2:])  # three in a row make a straight
    assert still[STANDING - 2 : STANDING + 3].all()
    assert not set(range(STANDING - 2, STANDING + 3)) & set(ends)


def test_off_it_is_the_filter_without_it(found):
    out, bare = over(WALKER, found, heuristic__form="none"), over(BARE, found)
    tools.same_bits((out.estimate, out.sigma), (bare.estimate, bare.sigma))
    assert not out.gates["straight"].weight.any()
    assert not out.more


FORMS = {
    "hdr": {},
    "slope": {"heuristic__slope__sigma": 0.2},
    "integrator": {},
    "hde": {},
    "ihde": {},
    "von_mises": {"heuristic__von_mises__sigma": 0.2},
}


@pytest.mark.parametrize("form", FORMS)
def test_a_form_acts_at_the_ends_of_strides_alone_and_is_causal(found, form):
    """It changes something; cropped, or stopped and gone on with, to the bit the same."""
    changes = {"heuristic__form": form, **FORMS[form]}
    p, inputs = told(WALKER, found, **changes)
    out = tools.scan(WALKER, p, inputs.samples, WALKER.start(p, None, inputs.opening))[1]
    bare = over(BARE, found)
    assert (out.status == 0).all()
    ends = np.flatnonzero(out.more["stride_end"])
    apart = np.abs(np.asarray(out.estimate.gyroscope_bias - bare.estimate.gyroscope_bias)).max(axis=1)
    assert apart[: ends[2]].max() == 0.0
    assert apart.max() > 1e-7
    half = int(ends[-3]) + 20
    p, short = told(WALKER, found, half, **changes)
    part = tools.scan(WALKER, p, short.samples, WALKER.start(p, None, short.opening))[1]
    tools.same_bits(jax.tree.map(lambda x: x[:half], out), part)
    if form in ("slope", "ihde"):
        tools.assert_chunks_equal_the_whole(WALKER, p, inputs, half)


@pytest.mark.parametrize("form", ["slope", "ihde"])
def test_padding_changes_nothing(found, form):
    """Samples of no time after the walk, which ends in the middle of a stance or of a swing."""
    for count in (STANDING, STANDING - 60):
        p, inputs = told(WALKER, found, heuristic__form=form, **FORMS[form])
        samples = inputs.samples
        idle = jnp.where(jnp.arange(COUNT) < count, samples.sensor.dt, 0.0)
        samples = samples._replace(sensor=samples.sensor._replace(dt=idle))
        first = WALKER.start(p, None, inputs.opening)
        end, out = tools.scan(WALKER, p, samples, first)
        short, _ = tools.scan(WALKER, p, jax.tree.map(lambda x, n=count: x[:n], inputs.samples), first)
        ours, theirs = (x.aids["heading_heuristic"] for x in (end, short))
        ours = ours._replace(clock=ours.clock._replace(moving=theirs.clock.moving))  # which the sensors tell
        tools.same_bits(ours, theirs)
        assert not out.more["stride_end"][count:].any()


def test_the_compass_must_be_there_to_be_agreed_with(found):
    p, inputs = told(WALKER, found, heuristic__form="mihde")
    with pytest.raises(InputError, match="mihde needs a magnetic heading"):
        tools.scan(WALKER, p, inputs.samples, WALKER.start(p, None, inputs.opening))


def test_headings_turn_with_the_yaw(found):
    """A straight walk whose yaw is corrected in a stance is straight still: by the yaw of the foot."""
    turner = aided("turner", INERTIAL, (ZERO_VELOCITY, turned_at(STANDING), HEADING_HEURISTIC))
    changes = {
        "heuristic__form": "integrator",
        "heuristic__straight__heading": "yaw",
        "heuristic__integrator__gain": 1e-8,
    }
    plain, turned = (over(s, found, **changes) for s in (WALKER, turner))
    ends = np.flatnonzero(plain.more["stride_end"])
    np.testing.assert_array_equal(ends, np.flatnonzero(turned.more["stride_end"]))
    away = np.asarray(turned.more["stride_heading"] - plain.more["stride_heading"])[ends]
    expected = np.where(ends > STANDING, TURN, 0.0)
    np.testing.assert_allclose(np.arctan2(np.sin(away), np.cos(away)), expected, atol=0.01)
    ratios = (np.asarray(x.gates["straight"].log_ratio)[ends] for x in (turned, plain))
    np.testing.assert_allclose(*ratios, atol=0.02)


def test_strides_turn_with_the_path(found):
    """The same by where the foot went: the place that a stride begins at is turned, too."""
    turner = aided("turner", INERTIAL, (ZERO_VELOCITY, turned_at(STANDING), HEADING_HEURISTIC))
    changes = {"heuristic__form": "integrator", "heuristic__integrator__gain": 1e-8}
    plain, turned = (over(s, found, **changes) for s in (WALKER, turner))
    ends = np.flatnonzero(plain.more["stride_end"])
    np.testing.assert_array_equal(ends, np.flatnonzero(turned.more["stride_end"]))
    away = np.asarray(turned.more["stride_heading"] - plain.more["stride_heading"])[ends]
    expected = np.where(ends > STANDING, TURN, 0.0)
    np.testing.assert_allclose(np.arctan2(np.sin(away), np.cos(away)), expected, atol=0.01)


def test_hde_turns_the_yaw_towards_the_direction(found):
    """By the share of the deviation that it is told to, at the end of a stride, beside the bias."""
    changes = {
        "heuristic__form": "hde",
        "heuristic__hde__gain": 1e-8,
        "heuristic__hde__softness": 1.0,
        "heuristic__directions__known": "given",
        "heuristic__directions__axis": 0.05,
    }
    still, turned = (over(WALKER, found, heuristic__hde__turn=turn, **changes) for turn in (0.0, 0.2))
    yaws = [np.unwrap(np.arctan2(*np.moveaxis(np.asarray(x.estimate.attitude)[:, 1::-1, 0], 1, 0)))
            for x in (still, turned)]  # fmt: skip
    moved = np.diff(yaws[1] - yaws[0])
    straight = np.asarray(turned.gates["straight"].weight)
    first = int(np.flatnonzero(straight)[0])
    away = float(turned.more["deviation"][first])
    assert abs(away) > 0.01
    assert moved[first - 1] == pytest.approx(-0.2 * straight[first] * np.tanh(away), rel=0.02)
    assert np.abs(moved[: first - 1]).max(initial=0.0) < 1e-9
