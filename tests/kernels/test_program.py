"""Steps as programs on single numbers: the arithmetic is the step's, for every choice that systems offer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import parameters
from pedjax.kernels.graph import OPERATIONS, Graph, Known, cut, evaluate, with_numpy
from pedjax.kernels.program import beginning, program, supports
from pedjax.kernels.unroll import KNOWN, primitives
from pedjax.systems import system
from tests.kernels import tools, toy

CHOICES = {
    "iez": [
        {},
        {"gate.kind": "adaptive", "gate.width": 0.3, "gate.follow": 0.5, "gate.growth": 0.4},
        {"updates.zaru": True, "strapdown.attitude_update": "pade", "stance.detector": "eps"},
        {"stance.rule": "any", "strapdown.attitude_update": "first_order", "strapdown.force_attitude": "new"},
        {"stance.detector": "mbgtd", "stance.rule": "all"},
        {"stance.detector": "mag", "gate.width": 0.2, "gate.straight_through": True},
    ],
    "ma2018": [
        {},
        {"compass.update": "anchored", "field.detector": "qsf", "compass.gyroscope_rows": True},
        {"compass.update": "differential", "field.detector": "qmd", "field.window": 5},
        {"compass.update": "none", "field.detector": "magyq", "compass.reference": "given"},
        {"field.detector": "iqsf", "compass.hard_iron": "tracked", "compass.row": "simple"},
        {"field.detector": "vector", "compass.hard_iron": "tracked", "compass.tracker.lag_s": 0.01},
        {"compass.looking.per": "sample", "field.ma.theta": "level", "field.ma.per": "second"},
        {"compass.looking.levelling": "attitude", "compass.start": "given"},
    ],
    "aiez": [
        {},
        {"heuristic.form": "von_mises", "heuristic.beside": "always", "tilt.rows": "level"},
        {"heuristic.form": "hdr", "heuristic.straight.detector": "change", "tilt.rows": "euler"},
        {"heuristic.form": "mihde", "heuristic.straight.heading": "yaw", "tilt.rows": "printed"},
        {"heuristic.form": "hde", "compass.looking.per": "sample", "field.aiez.per": "second"},
        {"heuristic.form": "integrator", "compass.recovery": "none", "initial.bias": "zero"},
    ],
    "wang": [
        {},
        {
            "compass.adaptive.law": "windowed",
            "updates.adaptive.law": "trace",
            "initial.alignment": "weighted",
        },
        {
            "compass.adaptive.law": "printed",
            "compass.compensation.mode": "vector",
            "initial.align.check": "mend",
        },
    ],
    "munoz_diaz": [
        {"steps.model": "affine"},
        {"reference.noise": "moving_average", "reference.detector": "steady", "reference.width": 0.3},
        {"reference.form": "anchored", "zero_acceleration.rows": "vector"},
    ],
    "munoz_diaz_twin": [{}, {"reference.state.iron": True, "steps.model": "weinberg"}],
    "pocket": [
        {},
        {"reference.state.start": "first", "reference.detector": "steady", "initial.bias": "rest"},
    ],
}
ALL = [pytest.param(n, c, id=f"{n}-{k}") for n, many in CHOICES.items() for k, c in enumerate(many)]
QUICK = {"iez-0", "iez-1", "ma2018-0", "ma2018-5"}
SOME_SLOW = [p if p.id in QUICK else pytest.param(*p.values, id=p.id, marks=pytest.mark.slow) for p in ALL]


def prepared(name, changes, length=50):
    found = system(name)
    p = parameters.cast(parameters.replace(found.defaults(), changes), jnp.float64)
    if "stance.shoe.threshold" in parameters.specs(p):
        p = parameters.with_leaves(p, {"stance.shoe.threshold": jnp.asarray(1e6)})
    sensors, dt = tools.signals(length, 3, jnp.float64)
    inputs = found.prepare(p, {found.needs[0].role: sensors["foot"]}, dt, 100.0)
    return p, found.start(p, None, inputs.opening), inputs.samples


def like(tree):
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(jnp.shape(x), jnp.result_type(x)), tree)


def flat(tree):
    return [np.asarray(x).reshape(-1) for x in jax.tree.leaves(tree)]


@pytest.mark.parametrize(("name", "changes"), SOME_SLOW)
def test_a_program_does_what_its_step_does(name, changes):
    p, state, samples = prepared(name, changes)
    advance = tools.advance_of(system(name))
    made = program(advance, like(p), like(state), like(jax.tree.map(lambda x: x[0], samples)))
    steps = 40
    _, (expected, sums) = jax.jit(
        lambda s, x: jax.lax.scan(lambda s, x: (lambda f: (f[0], f[1:3]))(advance(p, s, x)), s, x)
    )(state, jax.tree.map(lambda x: x[:steps], samples))
    given, first = flat(p), flat(state)
    now = {place: first[place.leaf][place.at] for place in made.carried}
    assert len(now) < sum(x.size for x in first)
    for k in range(steps):
        sample = flat(jax.tree.map(lambda x, k=k: x[k], samples))

        def value(name, now=now, sample=sample):
            if name.tree == "state":
                return now[name.place]
            return (given if name.tree == "parameter" else sample)[name.place.leaf][name.place.at]

        found = evaluate(made.graph, made.outputs, value, with_numpy)
        now = dict(zip(made.carried, found, strict=False))
        kept = iter(found[len(now) :])
        for whole in jax.tree.leaves(expected) + jax.tree.leaves(sums):
            x = np.asarray(whole[k]).reshape(-1)
            mine = np.array([next(kept) for _ in x])
            np.testing.assert_allclose(mine, x, rtol=0, atol=1e-11 * max(np.abs(whole).max(), 1e-3))
        assert next(kept) == 0


@pytest.mark.parametrize("name", ["iez", "ma2018"])
def test_what_is_worked_out_beforehand_changes_nothing(name):
    """Samples, openings and numbers without lanes are folded out: the rest gives the same."""
    found = system(name)
    p, state, samples = prepared(name, {})
    opening = found.prepare(p, *tools.signals(50, 3, jnp.float64), 100.0).opening
    sample = jax.tree.map(lambda x: x[20], samples)
    advance = tools.advance_of(found)
    made = program(advance, like(p), like(state), like(sample))
    begun = beginning(lambda p, o: found.start(p, None, o), like(p), like(opening), made)
    wide = list(parameters.specs(p)).index("updates.zero_velocity")
    trees = {"parameter": flat(p), "state": flat(state), "sample": flat(sample), "opening": flat(opening)}

    def given(name):
        return trees[name.tree][name.place.leaf][name.place.at]

    def known(name):
        return name.tree in ("sample", "opening") or (name.tree == "parameter" and name.place.leaf != wide)

    for graph, outputs, least in ((made.graph, made.outputs, 8), (begun.graph, list(begun.nodes), 1)):
        whole = evaluate(graph, outputs, given, with_numpy)
        smaller, asked, before = cut(graph, outputs, known, least)
        ahead = dict(zip(before, evaluate(graph, before, given, with_numpy), strict=True))
        assert before
        assert len(smaller.behind(asked)) < len(graph.behind(outputs))

        def rest(name, ahead=ahead):
            return ahead[name.node] if isinstance(name, Known) else given(name)

        np.testing.assert_array_equal(evaluate(smaller, asked, rest, with_numpy), whole)
    leaves = flat(state)
    first = evaluate(begun.graph, list(begun.nodes), given, with_numpy)
    expected = [leaves[place.leaf][place.at] for place in made.carried]
    np.testing.assert_allclose(first, expected, atol=1e-13)


@pytest.mark.parametrize(("name", "changes"), ALL)
def test_every_primitive_of_the_systems_is_known(name, changes):
    """A step that uses another one would not run as a kernel: this tells which."""
    p, state, samples = prepared(name, changes)
    sample = jax.tree.map(lambda x: x[0], samples)
    jaxpr = jax.make_jaxpr(tools.advance_of(system(name)))(p, state, sample).jaxpr
    assert primitives(jaxpr) - KNOWN == set()
    assert len(primitives(jaxpr)) > 20


def test_every_system_is_among_the_choices():
    ours = {"iez", "ma2018", "aiez", "wang", "munoz_diaz", "munoz_diaz_twin", "pocket"}
    assert set(CHOICES) == ours


def test_symmetric_matrices_are_kept_once():
    p, state, samples = prepared("iez", {})
    advance = tools.advance_of(system("iez"))
    made = program(advance, like(p), like(state), like(jax.tree.map(lambda x: x[0], samples)))
    assert len(made.twins) == 5 * 3


def test_what_has_no_effect_is_not_carried():
    lane = {"gain": 1.0, "spread": 1.0, "limit": 1.0}
    state = jax.eval_shape(lambda p: toy.start(p, jnp.zeros(2)), like(lane))
    made = program(toy.advance, like(lane), state, like({"force": jnp.zeros(2), "flag": True}))
    leaves = {place.leaf for place in made.carried}
    assert leaves == {0, 1, 2, 3, 4}
    assert len(made.carried) == 2 + 3 + 2 + 1 + 1  # of `turned` one column


@pytest.mark.parametrize(
    ("stopping", "step"),
    [
        ("sort", lambda x, i: jnp.sort(x)),
        ("gather|dynamic_slice", lambda x, i: x + x[i]),
        ("while", lambda x, i: jax.lax.while_loop(lambda v: v[0] < 1, lambda v: v + 1, x)),
        ("loop of 100 turns", lambda x, i: jax.lax.scan(lambda v, _: (v + 1, None), x, length=100)[0]),
    ],
)
def test_what_cannot_be_unrolled_is_named(stopping, step):
    import re

    def advance(p, state, sample):
        return step(state, sample), {}, {}, jnp.int32(0)

    reason = supports(advance, like({}), like(jnp.ones(3)), like(jnp.int32(1)))
    assert re.search(stopping, reason)


def by_numpy(function, *given):
    """A function's results by way of its graph."""
    from pedjax.kernels.unroll import unroll

    graph = Graph()
    closed = jax.make_jaxpr(function)(*given)
    arrays = [np.asarray(x) for x in given]
    names = [
        np.array([graph.input((k, i), x.dtype) for i in range(x.size)], np.int32).reshape(x.shape)
        for k, x in enumerate(arrays)
    ]
    found = unroll(graph, closed.jaxpr, closed.consts, names)
    outputs = [int(k) for numbers in found for k in numbers.flat]
    values = iter(evaluate(graph, outputs, lambda name: arrays[name[0]].flat[name[1]], with_numpy))
    return [np.array([next(values) for _ in range(n.size)]).reshape(n.shape) for n in found]


A = np.arange(1.0, 13).reshape(3, 4) / 7
FUNCTIONS = {
    "moves": lambda a: jnp.flip(jnp.concatenate([a.T[:, ::2], a.T], 1)).reshape(2, -1)[:, 1:-2],
    "pad": lambda a: jnp.pad(a, 1) + 1,
    "set": lambda a: a.at[1, 2].set(5.0).at[0].set(a[2]),
    "index": lambda a: a[jnp.array([2, 0]), jnp.array([1, 3])],
    "slice": lambda a: jax.lax.dynamic_slice(a, (1, 1), (2, 2)),
    "update": lambda a: jax.lax.dynamic_update_slice(a, a[:1, :1] * 2, (2, 3)),
    "split": lambda a: [x * 2 for x in jnp.split(a, [1], axis=0)],
    "product": lambda a: a @ a.T,
    "einsum": lambda a: jnp.einsum("ij,ik->kj", a, a),
    "powers": lambda a: (a**2, a**7, a**-3, a**2.5, jnp.square(a), a**0),
    "sums": lambda a: (a.sum(), a.sum(0), a.prod(1), a.max(1), a.min(0), (a > 0.5).any(0), (a > 0.1).all()),
    "running": lambda a: (jnp.cumsum(a, 1), jnp.cumprod(a, 0), jax.lax.cummax(a, 1, reverse=True)),
    "extremes": lambda a: (jnp.argmax(jnp.sin(9 * a), 0), jnp.argmin(jnp.sin(9 * a), 1)),
    "cond": lambda a: jax.lax.cond(a[0, 0] > 0.1, lambda x: x + 1, lambda x: x * 2, a),
    "switch": lambda a: jax.lax.switch((a[0, 1] * 7).astype(int), [jnp.sin, jnp.cos, jnp.exp, jnp.log], a),
    "loop": lambda a: jax.lax.scan(lambda c, x: (c * x, c + x), a[0], a, reverse=True),
    "clamp": lambda a: jnp.clip(a, 0.3, 0.9),
    "logic": lambda a: ((a > 0.3) & ~(a > 0.5) | (a == 1 / 7)) ^ (a < 1),
    "constants": lambda a: a * jnp.eye(3, 4) + jnp.ones((3, 4)) * 0 - jnp.zeros(4) + (-1.0) * a + -a,
    "quantile": lambda a: jax.scipy.special.ndtri(a / 2),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_unrolled_functions_are_what_they_were(name):
    expected = jax.tree.leaves(FUNCTIONS[name](jnp.asarray(A)))
    for mine, theirs in zip(by_numpy(FUNCTIONS[name], A), expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-13, atol=1e-14)


INVERSE = {"acosh": lambda x: x + 1}


@pytest.mark.parametrize(
    "name", [n for n in OPERATIONS if n not in {"and", "or", "xor", "not", "select_n", "sort"}]
)
def test_operations_mean_the_same_in_numpy_and_in_jax(name):
    meaning = OPERATIONS[name]
    x, y = np.array([0.3, 0.71, 0.05]), np.array([0.2, 0.71, 0.9])
    x = INVERSE.get(name, lambda x: x)(x)
    given = (x,) if meaning.numpy is not None and _unary(meaning.lax, x) else (x, y)
    np.testing.assert_allclose(meaning.numpy(*given), meaning.lax(*map(jnp.asarray, given)), rtol=1e-13)


def _unary(function, x):
    try:
        function(jnp.asarray(x))
    except TypeError:
        return False
    return True
