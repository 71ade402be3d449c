"""The Earth's field: signs of its angles, published values, and NOAA's test values of the world model."""

import datetime
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pedjax import InputError
from pedjax.detectors.field import inclination
from pedjax.lanes import norm
from pedjax.simulation import earth

NOAA = [  # year, height km, latitude, longitude (deg); H and Z nT, D and I deg; WMM2025 and WMM2020
    (2025.0, 28, 89, -121, 1504.298, 56194.289, -99.77, 88.47),
    (2020.0, 0, 80, 0, 6572.0, 54606.0, -1.28, 83.14),
    (2020.0, 0, 0, 120, 39624.4, -10932.5, 0.16, -15.42),
    (2020.0, 100, -80, 240, 15875.4, -49969.4, 68.78, -72.37),
    (2022.5, 0, -80, 240, 16885.0, -52251.6, 69.13, -72.09),
    (2022.5, 100, 80, 0, 6224.2, 52527.0, -0.41, 83.24),
]


def test_signs_of_the_angles():
    np.testing.assert_allclose(inclination(jnp.array([0.0, 1.0, -1.0])), np.pi / 4)
    np.testing.assert_allclose(earth.declination(jnp.array([1.0, 1.0, 0.0])), np.pi / 4)
    np.testing.assert_allclose(earth.declination(jnp.array([-1.0, -1.0, 0.0])), -3 * np.pi / 4)


def test_angles_are_inverted_in_any_lanes(rng):
    d, i, f = rng.uniform(-3, 3, (2, 5)), rng.uniform(-1.5, 1.5, (1, 5)), rng.uniform(20, 70, (2, 1))
    level = np.cos(i)
    field = jnp.asarray(f * np.stack(np.broadcast_arrays(level * np.sin(d), level * np.cos(d), -np.sin(i))))
    assert field.shape == (3, 2, 5)
    np.testing.assert_allclose(earth.declination(field), d, atol=1e-13)
    np.testing.assert_allclose(inclination(field), np.broadcast_to(i, (2, 5)), atol=1e-13)
    np.testing.assert_allclose(norm(field), np.broadcast_to(f, (2, 5)), rtol=1e-13)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (0.0, 0.0, -65.0), (0.0, 25.0, 0.0)])
@pytest.mark.parametrize("angle", [norm, inclination, earth.declination])
def test_values_and_gradients_are_finite_where_an_angle_is_not_defined(angle, vector):
    value, slope = jax.value_and_grad(angle)(jnp.array(vector))
    assert np.isfinite(value)
    assert np.isfinite(slope).all()


def test_published_places():
    for place, strength, dip in (("north_pole", 65, 90), ("equator", 25, 0), ("munich", 48, 64)):
        field = earth.homogeneous(place)
        np.testing.assert_allclose(norm(field), strength, rtol=1e-14)
        np.testing.assert_allclose(inclination(field), np.deg2rad(dip), atol=2e-8)  # slopes stay finite
        assert field[0] == 0
        assert field[1] >= 0
    with pytest.raises(InputError, match="did you mean 'munich'"):
        earth.homogeneous("munic")


@pytest.mark.parametrize(("year", "height", "latitude", "longitude", "h", "z", "d", "i"), NOAA)
def test_world_model_gives_noaas_values(year, height, latitude, longitude, h, z, d, i):
    pytest.importorskip("pygeomag")
    field = earth.earth(latitude, longitude, 1000.0 * height, year)
    digits = 1e-6 if year == 2025.0 else 1e-4  # half a unit of the last digit printed, in µT
    np.testing.assert_allclose(norm(field[:2]), h / 1000, atol=0.51 * digits)
    np.testing.assert_allclose(-field[2], z / 1000, atol=0.51 * digits)
    np.testing.assert_allclose(np.rad2deg(earth.declination(field)), d, atol=0.0051)
    np.testing.assert_allclose(np.rad2deg(inclination(field)), i, atol=0.0051)


def test_dates_are_decimal_years():
    pytest.importorskip("pygeomag")
    by_date = earth.earth(48.1, 11.6, 520.0, datetime.date(2026, 1, 1))
    np.testing.assert_array_equal(by_date, earth.earth(48.1, 11.6, 520.0, 2026.0))
    later = earth.earth(48.1, 11.6, 520.0, datetime.datetime(2026, 7, 2, 12))
    np.testing.assert_array_equal(later, earth.earth(48.1, 11.6, 520.0, 2026 + 182 / 365))
    assert 0 < np.abs(later - by_date).max() < 0.1
    np.testing.assert_allclose(norm(by_date), 48.6, atol=0.5)  # Munich, so that 48 and 64 deg are near
    np.testing.assert_allclose(np.rad2deg(inclination(by_date)), 64.0, atol=1.0)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((91.0, 0.0, 0.0, 2025.0), "latitude_deg = 91"),
        ((0.0, 400.0, 0.0, 2025.0), "longitude_deg = 400"),
        ((0.0, 0.0, 1e6, 2025.0), "height_m = 1000000"),
        ((0.0, 0.0, 0.0, 2030.0), "date = 2030"),
        ((0.0, 0.0, 0.0, float("nan")), "date = nan"),
    ],
)
def test_places_and_dates_outside_the_model_are_named(arguments, named):
    with pytest.raises(InputError, match=named):
        earth.earth(*arguments)


def test_missing_library_is_named_with_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygeomag", None)
    with pytest.raises(InputError, match=r"pip install 'pedjax\[magnetics\]'"):
        earth.earth(48.0, 11.0, 0.0, 2025.0)
