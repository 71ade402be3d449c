"""Parameters: free numbers stay in bounds and invert, wrong values are refused in one sentence."""

import jax
import numpy as np
import pytest
from jax import Array

import pedjax
from pedjax import parameters
from pedjax.errors import InputError
from pedjax.parameters import Spec, group, leaf, setting
from pedjax.systems import SYSTEMS
from tests.tools import LEAVES


@pytest.fixture(params=list(SYSTEMS))
def params(request):
    return SYSTEMS[request.param].defaults()


FEET = [name for name, each in SYSTEMS.items() if hasattr(each.defaults(), "stance")]


@pytest.fixture(params=FEET)
def foot(request):
    return SYSTEMS[request.param].defaults()


LOG = Spec("m", 1e-3, 1e3, "log", "test")
LINEAR = Spec("m", -2.0, 6.0, "linear", "test")


@pytest.mark.parametrize("spec", [LOG, LINEAR])
def test_free_numbers_invert_and_stay_in_bounds(spec):
    spaced = np.geomspace if spec.scale == "log" else np.linspace
    value = spaced(spec.low, spec.high, 103)[1:-1]
    np.testing.assert_allclose(spec.from_free(spec.to_free(value)), value, rtol=1e-12)
    far = np.asarray(spec.from_free(np.array([-1e4, -40.0, 40.0, 1e4])))
    assert (far >= spec.low * (1 - 1e-12) if spec.low > 0 else far >= spec.low).all()
    assert (far <= spec.high * (1 + 1e-12)).all()
    assert np.isfinite(spec.to_free(np.array([spec.low, spec.high]))).all()


def test_a_free_step_is_an_e_fold_or_a_tenth_of_the_range():
    slope = jax.grad(lambda x: jax.numpy.log(LOG.from_free(x)))(0.0)
    assert float(slope) == pytest.approx(1.0)
    assert float(jax.grad(lambda x: LINEAR.from_free(x))(0.0)) == pytest.approx(0.1 * 8.0)


def test_every_leaf_has_a_unit_bounds_and_a_source(params):
    for path, spec in parameters.specs(params).items():
        assert spec.unit, path
        assert spec.source, path
        assert spec.low <= float(parameters.get(params, path)) <= spec.high
        assert spec.low < spec.high
    assert len(jax.tree.leaves(params)) == len(parameters.specs(params))


def test_settings_are_structure_and_not_leaves(foot):
    changed = parameters.replace(foot, {"stance.detector": "ared"})
    assert jax.tree.structure(changed) != jax.tree.structure(foot)
    same = parameters.replace(foot, {"stance.shoe.threshold": 1e6})
    assert jax.tree.structure(same) == jax.tree.structure(foot)


def test_nested_and_flat_are_inverse(params):
    nested = parameters.to_nested(params)
    assert parameters.flatten(nested) == parameters.values(params)
    assert parameters.replace(params, parameters.flatten(nested)) == params


def test_replaced_leaves_carry_lanes(foot):
    lanes = parameters.with_leaves(foot, {"gravity": np.linspace(9.7, 9.9, 4)})
    assert lanes.gravity.shape == (4,)
    assert lanes.stance == foot.stance


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("stance.shoe.treshold", 1.0, "did you mean 'stance.shoe.threshold'"),
        ("nonsense", 1.0, "parameter 'nonsense' is unknown; known are"),
        ("stance.shoe.threshold", 1e13, r"1e\+13 1 is outside its bounds, 1000 to 1e\+12"),
        ("gravity", 0.0, "outside its bounds"),
        ("gravity", float("nan"), "outside its bounds"),
        ("gravity", "heavy", "is not a number; its unit is m/s"),
        ("stance.detector", "sheo", "did you mean 'shoe'"),
        ("updates.zaru", 1, "must be of the same kind"),
        ("stance.shoe.window_s", -1.0, "not negative"),
        ("stance.shoe.window_s", float("inf"), "not negative"),
        ("stance.rule", 3, "is not a choice"),
    ],
)
def test_wrong_values_are_refused(foot, path, value, message):
    with pytest.raises(InputError, match=message) as error:
        parameters.replace(foot, {path: value}, "here.toml: parameters")
    assert str(error.value).startswith("here.toml: parameters: ")
    assert "\n" not in str(error.value)


def test_bounds_themselves_are_allowed(params):
    for path, spec in parameters.specs(params).items():
        parameters.replace(params, {path: spec.low})
        parameters.replace(params, {path: spec.high})


def test_get_suggests(foot):
    with pytest.raises(InputError, match=r"did you mean 'updates.zero_velocity'"):
        parameters.get(foot, "updates.zero_velocit")


def test_defaults_outside_their_bounds_cannot_be_written():
    with pytest.raises(ValueError, match="do not fit"):
        parameters.leaf(2.0, unit="m", low=0.0, high=1.0, scale="linear", source="")
    with pytest.raises(ValueError, match="do not fit"):
        parameters.leaf(0.5, unit="m", low=0.0, high=1.0, scale="log", source="")


def test_table_lists_every_path(params):
    table = parameters.table(params)
    for path in parameters.values(params):
        assert f"{path} " in table


def test_cast_makes_arrays_of_one_dtype(params):
    for value in jax.tree.leaves(parameters.cast(params, np.float32)):
        assert value.dtype == np.float32


def test_leaves_listed_for_the_tests_are_those_of_iez():
    assert set(LEAVES) == set(parameters.specs(SYSTEMS["iez"].defaults()))


# what has an effect


def number(value=1.0, **how):
    return leaf(value, unit="1", low=0.1, high=10.0, source="test", **how)


@parameters.parameters
class Inner:
    plain: Array = number(tune=True)
    deep: Array = number(tune=True, when={"mode": "far"})
    mine: Array = number(when={"own": ("x", "y")})
    own: str = setting("x", choices=("x", "y", "z"))


@parameters.parameters
class Tree:
    """`mode` is looked for around the groups, `own` in them, and `on` guards a whole group."""

    first: Array = number(tune=True, point=True)
    mode: str = setting("near", choices=("near", "far"))
    on: bool = setting(True)
    inner: Inner = group(Inner)
    guarded: Inner = group(Inner, when={"on": True})


CASES = {
    "as made": ({}, {"inner.deep": "mode is 'near'", "guarded.deep": "mode is 'near'"}),
    "far": ({"mode": "far"}, {}),
    "any of two": ({"mode": "far", "inner.own": "y"}, {}),
    "none of two": ({"mode": "far", "inner.own": "z"}, {"inner.mine": "inner.own is 'z'"}),
    "a group that is off": (
        {"on": False, "mode": "far", "guarded.own": "z"},
        {f"guarded.{name}": "on is False" for name in ("plain", "deep", "mine")},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_has_no_effect_says_why(case):
    changes, idle = CASES[case]
    tree = parameters.replace(Tree(), changes)
    every = parameters.specs(tree)
    assert {p: parameters.idle_because(tree, p) for p in every} == {p: idle.get(p, "") for p in every}
    assert parameters.active(tree) == every.keys() - idle.keys()
    wanted = [
        p for p in ("first", "inner.plain", "inner.deep", "guarded.plain", "guarded.deep") if p not in idle
    ]
    assert list(parameters.tunable(tree)) == wanted
    for path, reason in idle.items():
        lines = parameters.table(tree).splitlines()
        row = next(i for i, line in enumerate(lines) if line.startswith(f"{path} "))
        assert lines[row + 1].strip() == f"[no effect: {reason}]"


NOISES = {
    "updates.zero_velocity", "process.accelerometer", "process.gyroscope", "initial.accelerometer_bias",
    "initial.gyroscope_bias", "initial.attitude",
}  # fmt: skip
ADAPTIVE = {"gate.follow", "gate.follow_time", "gate.growth", "gate.floor"}
EPS = {"stance.eps.energy", "stance.eps.rate_energy"}
HEADING = {"compass.noise.floor", "compass.noise.field", "compass.tail", "compass.start_sigma"}


@pytest.mark.parametrize(
    ("name", "changes", "wanted"),
    [
        ("iez", {}, {"stance.shoe.threshold"}),
        ("iez", {"stance.detector": "ared"}, {"stance.ared.threshold"}),
        ("iez", {"stance.detector": "eps", "gate.kind": "adaptive"}, EPS | ADAPTIVE),
        ("ma2018", {}, {"stance.shoe.threshold", "field.ma.threshold"} | HEADING),
        ("ma2018", {"field.detector": "magyq"}, {"stance.shoe.threshold", "field.magyq.variance"} | HEADING),
        (
            "ma2018",
            {"field.detector": "vector"},
            {"stance.shoe.threshold", "field.vector.false_alarm", "field.vector.change"} | HEADING,
        ),
    ],
)
def test_what_is_tuned_by_default(name, changes, wanted):
    params = parameters.replace(SYSTEMS[name].defaults(), changes)
    assert set(parameters.tunable(params)) == wanted | NOISES


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("iez", {"stance.detector": "ared"}),
        ("ma2018", {"compass.update": "anchored", "compass.reference": "given"}),
        ("ma2018", {"compass.update": "none", "compass.start": "given", "field.detector": "qsf"}),
    ],
)
def test_what_has_no_effect_changes_no_bit(demos, name, changes):
    params = parameters.replace(SYSTEMS[name].defaults(), changes)
    idle = parameters.specs(params).keys() - parameters.active(params)
    assert idle
    moved = {p: 0.5 * (s.low + s.high) for p, s in parameters.specs(params).items() if p in idle}
    one, two = (pedjax.run(demos[2], name, p) for p in (params, parameters.replace(params, moved)))
    np.testing.assert_array_equal(one.position, two.position)
    for gate in one.gates:
        np.testing.assert_array_equal(one.gates[gate].weight, two.gates[gate].weight)


def test_groups_of_a_kind_are_found_whatever_their_names():
    tree = parameters.replace(Tree(), {"guarded.plain": 3.0})
    assert parameters.groups_of(tree, Inner) == {"inner": tree.inner, "guarded": tree.guarded}
    assert parameters.groups_of(tree, Tree) == {"": tree}
    Outer = parameters.grown(Tree, {"more": Tree}, "Outer")
    assert set(parameters.groups_of(Outer(), Inner)) == {"inner", "guarded", "more.inner", "more.guarded"}
    assert parameters.groups_of(tree, Spec) == {}


def test_a_grown_class_has_further_groups_behind_its_own():
    Grown = parameters.grown(Inner, {"tree": Tree, "other": Tree}, "Grown", "All of it.")
    made = Grown()
    assert (Grown.__name__, Grown.__doc__) == ("Grown", "All of it.")
    assert isinstance(made, Inner)
    assert list(parameters.values(made)) == [
        *parameters.values(Inner()),
        *(f"{name}.{path}" for name in ("tree", "other") for path in parameters.values(Tree())),
    ]
    changed = parameters.replace(made, {"other.inner.plain": 2.0})
    assert (made.other.inner.plain, changed.other.inner.plain, changed.tree.inner.plain) == (1.0, 2.0, 1.0)
    doubled = jax.jit(lambda tree: jax.tree.map(lambda x: 2 * x, tree))(changed)
    assert isinstance(doubled, Grown)
    assert float(doubled.other.inner.plain) == 4.0


def test_other_defaults_have_their_own_source():
    given = {"inner.plain": (2.0, "mine"), "inner.own": ("y", "mine, too"), "first": (3.0, "third")}
    Other = parameters.redefined(Tree, given)
    made = Other()
    assert isinstance(made, Tree)
    assert isinstance(made.inner, Inner)
    assert (made.inner.plain, made.inner.own, made.first, made.guarded.plain) == (2.0, "y", 3.0, 1.0)
    assert list(parameters.values(made)) == list(parameters.values(Tree()))
    about = parameters.specs(made)["inner.plain"]
    assert (about.source, about.unit, about.tune) == ("mine", "1", True)
    assert parameters.choices(made)["inner.own"].source == "mine, too"
    assert parameters.idle_because(made, "inner.deep") == "mode is 'near'"
    assert parameters.groups_of(made, Inner).keys() == parameters.groups_of(Tree(), Inner).keys()
    doubled = jax.jit(lambda tree: jax.tree.map(lambda x: 2 * x, tree))(made)
    assert float(doubled.inner.plain) == 4.0


@pytest.mark.parametrize("path", ["none", "inner", "inner.none", "first.deeper"])
def test_another_default_needs_a_leaf_or_setting(path):
    with pytest.raises(InputError, match=r"has no '.*' to give another default"):
        parameters.redefined(Tree, {path: (1.0, "mine")})


@parameters.parameters
class First:
    threshold: Array = number(tune=True, point=True)


@parameters.parameters
class Chooser:
    """Which detector."""

    kind: str = setting("first", choices=("first",), source="test", meaning="which")
    width: Array = number()
    first: First = group(First, when={"kind": "first"})


@parameters.parameters
class Second:
    limit: Array = number(tune=True)


@parameters.parameters
class Better:
    limit: Array = number(5.0)


def test_a_choice_can_be_offered_from_outside():
    before = Chooser()
    assert parameters.latest(Chooser) is Chooser
    parameters.offer(Chooser, "second", Second, "kind")
    tree = parameters.latest(Chooser)()
    assert isinstance(tree, Chooser)
    assert (type(tree).__name__, type(tree).__doc__) == ("Chooser", "Which detector.")
    about = parameters.choices(tree)["kind"]
    assert (about.choices, about.source, about.meaning) == (("first", "second"), "test", "which")
    assert tree.kind == "first"
    assert parameters.tunable(tree) == ("first.threshold",)
    assert parameters.idle_because(tree, "second.limit") == "kind is 'first'"
    chosen = parameters.replace(tree, {"kind": "second", "second.limit": 2.0})
    assert parameters.tunable(chosen) == ("second.limit",)
    assert parameters.idle_because(chosen, "first.threshold") == "kind is 'second'"
    assert len(jax.tree.leaves(chosen)) == 3
    with pytest.raises(InputError, match="'second' is not a choice"):  # what was made before is as it was
        parameters.replace(before, {"kind": "second"})

    parameters.offer(Chooser, "second", Better, "kind")
    parameters.offer(Chooser, "third", Second, "kind")
    again = parameters.latest(Chooser)()
    assert parameters.choices(again)["kind"].choices == ("first", "second", "third")
    assert again.second == Better()
    assert len(jax.tree.leaves(again)) == 4


def test_every_leaf_and_setting_says_what_it_means():
    """A sentence each; of two leaves that share one, both are the same field of the same class."""
    for system in SYSTEMS.values():
        tree = system.defaults()
        known = parameters.specs(tree) | parameters.choices(tree)
        assert set(known) == set(parameters.values(tree))
        for path, about in known.items():
            assert 20 <= len(about.meaning) <= 170, (system.name, path, about.meaning)
            assert about.meaning.endswith("."), (system.name, path, about.meaning)
        fields: dict[str, set[int]] = {}
        for spec in parameters.specs(tree).values():
            fields.setdefault(spec.meaning, set()).add(id(spec))
        assert [meaning for meaning, ids in fields.items() if len(ids) > 1] == []


def test_an_undisturbed_field_matters_only_to_a_heading_that_is_held_against_it():
    tree = SYSTEMS["ma2018"].defaults()
    given = parameters.replace(tree, {"compass.reference": "given"})
    assert "compass.strength" in parameters.active(given) - parameters.active(tree)
    anchored = parameters.replace(given, {"compass.update": "anchored"})
    assert parameters.idle_because(anchored, "compass.strength") == "compass.update is 'anchored'"
