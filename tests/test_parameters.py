"""Parameters: free numbers stay in bounds and invert, wrong values are refused in one sentence."""

import jax
import numpy as np
import pytest

from pedjax import parameters
from pedjax.errors import InputError
from pedjax.parameters import Spec
from pedjax.systems import SYSTEMS
from tests.tools import LEAVES


@pytest.fixture(params=list(SYSTEMS))
def params(request):
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


def test_settings_are_structure_and_not_leaves(params):
    changed = parameters.replace(params, {"stance.detector": "ared"})
    assert jax.tree.structure(changed) != jax.tree.structure(params)
    same = parameters.replace(params, {"stance.shoe.threshold": 1e6})
    assert jax.tree.structure(same) == jax.tree.structure(params)


def test_nested_and_flat_are_inverse(params):
    nested = parameters.to_nested(params)
    assert parameters.flatten(nested) == parameters.values(params)
    assert parameters.replace(params, parameters.flatten(nested)) == params


def test_replaced_leaves_carry_lanes(params):
    lanes = parameters.with_leaves(params, {"gravity": np.linspace(9.7, 9.9, 4)})
    assert lanes.gravity.shape == (4,)
    assert lanes.stance == params.stance


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
def test_wrong_values_are_refused(params, path, value, message):
    with pytest.raises(InputError, match=message) as error:
        parameters.replace(params, {path: value}, "here.toml: parameters")
    assert str(error.value).startswith("here.toml: parameters: ")
    assert "\n" not in str(error.value)


def test_bounds_themselves_are_allowed(params):
    for path, spec in parameters.specs(params).items():
        parameters.replace(params, {path: spec.low})
        parameters.replace(params, {path: spec.high})


def test_get_suggests(params):
    with pytest.raises(InputError, match=r"did you mean 'updates.zero_velocity'"):
        parameters.get(params, "updates.zero_velocit")


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
    for leaf in jax.tree.leaves(parameters.cast(params, np.float32)):
        assert leaf.dtype == np.float32


def test_leaves_listed_for_the_tests_are_those_of_iez():
    assert set(LEAVES) == set(parameters.specs(SYSTEMS["iez"].defaults()))


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
