"""Systems made of a filter and aids: any that fit, in the given order, and those that are off for free."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

import pedjax
from pedjax import parameters
from pedjax.aids import (
    FIELD_RATE,
    GRAVITY_UPDATE,
    HEADING_HEURISTIC,
    MAGNETIC_HEADING,
    ZERO_ANGULAR_RATE,
    ZERO_VELOCITY,
    Aid,
    Measured,
    aided,
)
from pedjax.errors import InputError
from pedjax.filters.euler import EULER
from pedjax.filters.inertial import INERTIAL
from pedjax.filters.kalman import Rows
from pedjax.lanes import eye
from pedjax.parameters import leaf
from pedjax.system import Gated, Need, Signals
from pedjax.systems import SYSTEMS
from pedjax.systems.ma2018 import VALUES
from tests import tools

IEZ, MA = SYSTEMS["iez"], SYSTEMS["ma2018"]
COUNT, RATE = 120, 100.0


@parameters.parameters
class Strange:
    zero_velocity: Array = leaf(1.0, unit="1", low=0.1, high=10.0, source="test")


def aid(name, step=None, **how):
    """An aid that measures nothing, unless told how."""
    return Aid(name, step or (lambda p, site, state, seen: Measured(state, None, None)), **how)


REFUSED = {
    "a gate that none before has": (
        (ZERO_ANGULAR_RATE, ZERO_VELOCITY),
        "'made': the aid 'zero_angular_rate' reads the gate 'stance', which no aid before it has",
    ),
    "a gate that none has": (
        (ZERO_VELOCITY, FIELD_RATE),
        "the aid 'field_rate' reads the gate 'field', which no aid before it has",
    ),
    "one gate twice": ((ZERO_VELOCITY, ZERO_VELOCITY), "two aids have the gate 'stance'"),
    "one aid twice": ((ZERO_VELOCITY, ZERO_ANGULAR_RATE, ZERO_ANGULAR_RATE), "an aid is there twice"),
    "a group in two ways": (
        (ZERO_VELOCITY, aid("strange", groups=(("updates", Strange),))),
        "aids define the parameters 'updates' in two ways",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_does_not_fit_together_is_refused(what):
    aids, message = REFUSED[what]
    with pytest.raises(InputError, match=message):
        aided("made", INERTIAL, aids)


def signals(magnetic=True):
    """A foot that stands for half a second and moves for the rest of it, in a field."""
    rng = np.random.default_rng(3)
    still = (np.arange(COUNT) % 60 < 30)[:, None]
    force = np.array([0.3, -0.2, 9.79]) + rng.normal(size=(COUNT, 3)) * np.where(still, 0.01, 2.0)
    rate = 0.003 + rng.normal(size=(COUNT, 3)) * np.where(still, 0.005, 1.0)
    field = np.array([21.0, 3.0, -43.0]) + rng.normal(0, 0.3, (COUNT, 3))
    return Signals(jnp.asarray(force), jnp.asarray(rate), jnp.asarray(field) if magnetic else None)


DT = jnp.full(COUNT, 1 / RATE)


def of(system, changes):
    p = parameters.cast(parameters.replace(system.defaults(), changes), float)
    return p, system.prepare(p, {"foot": signals(system.magnetic)}, DT, RATE)


def over(system, **changes):
    """Last state and outputs over the samples."""
    p, inputs = of(system, {k.replace("__", "."): v for k, v in changes.items()})
    return tools.scan(system, p, inputs.samples, system.start(p, None, inputs.opening))


def program(system, changes):
    """What start and step compute, as text; it is only traced."""
    p = parameters.cast(parameters.replace(system.defaults(), changes), float)
    inputs = jax.eval_shape(lambda s: system.prepare(p, {"foot": s}, DT, RATE), signals(system.magnetic))
    sample = jax.eval_shape(lambda samples: jax.tree.map(lambda x: x[0], samples), inputs.samples)

    def start(p, opening):
        return system.start(p, None, opening)

    state = jax.eval_shape(start, p, inputs.opening)
    step = jax.make_jaxpr(lambda p, *given: system.step(p, None, *given))(p, state, sample)
    return str(jax.make_jaxpr(start)(p, inputs.opening)), str(step)


def test_a_system_has_what_its_aids_have():
    bare = aided("bare", INERTIAL, ())
    assert (bare.needs, bare.gates, bare.magnetic) == ((Need("foot", False),), (), False)
    assert type(bare.defaults()).__name__ == "BareParameters"
    assert parameters.values(bare.defaults()) == parameters.values(INERTIAL.parameters())
    for system, gates in ((IEZ, ("stance", "straight")), (MA, ("stance", "field", "straight"))):
        assert system.gates == gates
        assert type(system.defaults()) is type(system.defaults())  # one class: programs are compiled for it
    assert not IEZ.magnetic
    assert MA.needs == (Need("foot", True),)
    waist = aided("at_the_waist", INERTIAL, (ZERO_VELOCITY, MAGNETIC_HEADING), "told", "waist")
    assert (waist.needs, waist.title) == ((Need("waist", True),), "told")
    groups = [path.partition(".")[0] for path in parameters.values(MA.defaults())]
    assert list(dict.fromkeys(groups)) == [
        "gravity", "strapdown", "process", "initial", "stance", "gate", "updates", "field", "compass",
        "heuristic",
    ]  # fmt: skip


def test_it_asks_for_as_long_a_recording_as_its_aids():
    long = aid("long", shortest=lambda p: (3.0, "long.window_s"), opening_s=lambda p: 0.7)
    off = aid("off", shortest=lambda p: (9.0, "off.window_s"), is_on=lambda p: False)
    made = aided("asks", INERTIAL, (ZERO_VELOCITY, HEADING_HEURISTIC, long, off))
    assert made.shortest(made.defaults()) == (3.0, "long.window_s")
    assert IEZ.shortest(tools.iez(stance__shoe__window_s=8.0)) == (16.0, "stance.shoe.window_s")
    assert aided("bare", INERTIAL, ()).shortest(INERTIAL.parameters()) == (0.0, "")
    (p, inputs), (_, plain) = of(made, {}), of(IEZ, {})
    assert (len(inputs.opening.dt), len(plain.opening.dt)) == (70, 10)
    np.testing.assert_array_equal(inputs.opening.still, np.arange(70) < 10)  # the filter levels as before
    ours, theirs = (s.start(p, None, o.opening) for s, o in ((made, inputs), (IEZ, plain)))
    tools.same_bits((ours.estimate, ours.P), (theirs.estimate, theirs.P))


OWN = {path: value for path, (value, _) in VALUES.items()}
ON = {ZERO_ANGULAR_RATE: "updates.zaru", FIELD_RATE: "compass.gyroscope_rows"}
SUBSETS = {
    "zero velocity": (ZERO_VELOCITY,),
    "zero velocity and rate": (ZERO_VELOCITY, ZERO_ANGULAR_RATE),
    "heading": (ZERO_VELOCITY, MAGNETIC_HEADING),
    "heading and rate": (ZERO_VELOCITY, ZERO_ANGULAR_RATE, MAGNETIC_HEADING),
    "heading and field rate": (ZERO_VELOCITY, MAGNETIC_HEADING, FIELD_RATE),
    "all": (ZERO_VELOCITY, ZERO_ANGULAR_RATE, MAGNETIC_HEADING, FIELD_RATE),
}


def switches(aids):
    """Settings by which a system with more aids has these only."""
    return {path: each in aids for each, path in ON.items()}


def known_to(system, changes):
    return {k: v for k, v in changes.items() if k in parameters.values(system.defaults())}


@pytest.mark.parametrize("which", SUBSETS)
def test_an_aid_that_is_off_costs_nothing(which):
    """It is as if it had been left out, operation by operation."""
    aids = SUBSETS[which]
    made = aided("made", INERTIAL, (*aids, HEADING_HEURISTIC))  # its parameters and its gate are there if off
    whole = MA if MAGNETIC_HEADING in aids else IEZ
    changes = switches(aids)
    assert program(made, known_to(made, changes | OWN)) == program(whole, known_to(whole, changes))
    more = dict.fromkeys(changes, True)
    if len(aids) < len(SUBSETS["all"]) and known_to(whole, more) != known_to(whole, changes):
        assert len(program(whole, known_to(whole, more))[1]) > len(
            program(whole, known_to(whole, changes))[1]
        )


def test_an_aid_with_a_gate_that_is_off_adds_no_operation():
    """Its numbers are given and its gate is told, and nothing is computed."""
    with_it = aided("made", INERTIAL, (ZERO_VELOCITY, HEADING_HEURISTIC))
    on, off, without = (
        [text.count(" = ") for text in program(system, changes)]
        for system, changes in (
            (with_it, {"heuristic.form": "slope"}),
            (with_it, {}),
            (aided("made", INERTIAL, (ZERO_VELOCITY,)), {}),
        )
    )
    assert off == without
    assert on[1] > off[1]


LOOSE = {"field.ma.threshold": 170.0, "initial.attitude": 0.02, "initial.gyroscope_bias": 0.01}


@pytest.mark.parametrize("which", ["heading", "heading and field rate"])
def test_a_combination_of_ones_own_is_ma2018_with_the_rest_off(demos, which):
    aids = SUBSETS[which]
    made = aided("made", INERTIAL, aids)
    changes = switches(aids) | LOOSE | OWN
    tracks = [pedjax.run(demos[2], s, parameters.replace(s.defaults(), changes)) for s in (made, MA)]
    ours, theirs = tracks
    assert ours.healthy
    assert (ours.gates["field"].weight > 0.5).any()
    for name in tools.ORACLE_NAMES:
        np.testing.assert_allclose(ours.estimate[name], theirs.estimate[name], atol=1e-12, err_msg=name)
    np.testing.assert_allclose(tools.sigmas(ours), tools.sigmas(theirs), atol=1e-12)
    if FIELD_RATE in aids:  # which is of consequence
        without = pedjax.run(demos[2], MA, parameters.replace(MA.defaults(), LOOSE))
        assert np.abs(ours.estimate["gyroscope_bias"] - without.estimate["gyroscope_bias"]).max() > 1e-6


@pytest.mark.parametrize(
    ("further", "changes", "changed"),
    [
        ((ZERO_ANGULAR_RATE,), {"updates__zaru": True}, "gyroscope_bias"),
        ((MAGNETIC_HEADING,), {"compass__update": "none"}, "attitude"),  # its first heading is the compass's
    ],
    ids=["zero rate", "heading"],
)
def test_a_further_aid_makes_a_difference(further, changes, changed):
    plain = over(IEZ)[1]
    made = aided("made", INERTIAL, (ZERO_VELOCITY, *further))
    found = over(made, **changes)[1]
    assert (found.status == 0).all()
    assert set(found.gates) == set(made.gates)
    ours, theirs = (np.asarray(getattr(x.estimate, changed)) for x in (found, plain))
    assert np.abs(ours - theirs).max() > 1e-6


def test_a_filter_without_any_aid_runs():
    made = aided("alone", INERTIAL, ())
    state, found = over(made)
    assert (found.gates, found.more, state.aids) == ({}, {}, {})
    _, none = over(aided("nothing", INERTIAL, (aid("nothing"),)))
    tools.same_bits(found.estimate, none.estimate)


def linear(name, state, field, sigma, columns):
    """An aid whose rows do not depend on the attitude: that components of a state are what they should be."""
    H = np.eye(3)[columns]

    def step(p, site, own, seen):
        like = seen.estimate.position[0]
        value = jnp.stack([0.3 - getattr(seen.estimate, field)[c] for c in columns])
        noise = sigma**2 * eye(len(columns), like)
        row = jnp.asarray(H)[..., *(None,) * like.ndim] * jnp.ones_like(like)
        return Measured(own, Rows(value, noise, {state: row}), jnp.ones_like(like))

    return aid(name, step)


def both_at_once(p, site, own, seen):
    """The rows of `height` and `speed` in one update."""
    estimate, like = seen.estimate, seen.estimate.position[0]
    z = jnp.stack([0.3 - estimate.position[2], 0.3 - estimate.velocity[0], 0.3 - estimate.velocity[1]])
    R = jnp.diag(jnp.asarray([0.1, 0.02, 0.02]) ** 2)
    H = {
        "p": jnp.asarray([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]]),
        "v": jnp.asarray([[0, 0, 0], [1.0, 0, 0], [0, 1, 0]]),
    }
    return Measured(own, Rows(z, R, H), jnp.ones_like(like))


def test_one_after_the_other_is_the_stacked_update_in_any_order():
    """For rows that are linear in the estimate and whose noises are independent."""
    height, speed = (
        linear("height", "p", "position", 0.1, [2]),
        linear("speed", "v", "velocity", 0.02, [0, 1]),
    )
    plain = over(aided("plain", INERTIAL, (aid("nothing"),)))
    orders = ((height, speed), (speed, height), (aid("both", both_at_once),))
    found = [over(aided("ordered", INERTIAL, aids)) for aids in orders]
    one = (found[0][0].estimate, found[0][0].P)
    for state, _ in found[1:]:
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves((state.estimate, state.P)), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6 * np.abs(b).max() + 1e-9)
    assert np.abs(found[0][0].estimate.position - plain[0].estimate.position).max() > 1e-2


class Told:
    """Aids that write down what they are given while a step is traced."""

    def __init__(self):
        self.seen, self.after = {}, []

    def aid(self, name, gate=None, measures=False, on=True):
        def step(p, site, state, seen):
            self.seen[name] = (sorted(seen.gates), sorted(seen.more))
            like = seen.estimate.position[0]
            rows = Rows(seen.estimate.position, eye(3, like), {"p": None}) if measures else None
            gated = Gated(jnp.ones_like(like), -jnp.ones_like(like)) if gate else None
            return Measured(state, rows, jnp.ones_like(like), gated, {f"{name}_said": like})

        def after(p, state, by, correction, estimate):
            self.after.append((by, name))
            return state

        return Aid(name, step, gate=gate, after=after, is_on=lambda p: on)


def test_an_aid_sees_of_others_only_what_was_before_it():
    told = Told()
    aids = (
        told.aid("a", gate="open"),
        told.aid("b", measures=True),
        told.aid("idle", gate="shut", measures=True, on=False),
        told.aid("c", measures=True),
    )
    made = aided("told", INERTIAL, aids)
    p, inputs = of(made, {})
    state = made.start(p, None, inputs.opening)
    assert list(state.aids) == ["a", "b", "c"]
    told.seen.clear()
    sample = jax.tree.map(lambda x: x[0], inputs.samples)
    after, output = made.step(p, None, state, sample)
    assert told.seen == {
        "a": ([], []), "b": (["open"], ["a_said"]), "c": (["open"], ["a_said", "b_said"]),
    }  # fmt: skip
    # each correction is told to all that are on, in their order
    assert told.after == [(by, name) for by in "bc" for name in "abc"]
    assert set(output.more) == {"a_said", "b_said", "c_said"}
    assert set(output.gates) == {"open", "shut"} == set(made.gates)
    assert float(output.gates["open"].weight) == 1.0
    assert (float(output.gates["shut"].weight), float(output.gates["shut"].log_ratio)) == (0.0, 0.0)  # off
    assert list(output.sigma) == list(tools.ERROR_STATES)
    assert set(after.aids) == {"a", "b", "c"}


def test_an_aid_on_a_filter_that_lacks_its_state_is_refused():
    with pytest.raises(InputError, match=r"'zero_velocity' needs the velocity, which the filter 'euler'"):
        aided("feet-in-pockets", EULER, (ZERO_VELOCITY,))
    with pytest.raises(InputError, match=r"'magnetic_heading' needs the attitude"):
        aided("compass-in-pockets", EULER, (GRAVITY_UPDATE, MAGNETIC_HEADING._replace(reads=())))
