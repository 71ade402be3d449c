"""The Earth's magnetic field, and the angles in which it is told.

Vectors are ENU, `(3, *L)` in µT. Declination D is positive where the field points east of true north,
inclination I positive where it points down: B = [H sin D, H cos D, −F sin I] with F = |B| and H = F cos I.
Angles are in rad; only latitude and longitude, which come from maps, are in degrees.
"""

from __future__ import annotations

import datetime
import importlib
import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from pedjax.errors import InputError, suggest
from pedjax.lanes import norm

_DIP = math.radians(64.0)
_PLACES = {
    "north_pole": (0.0, 0.0, -65.0),
    "equator": (0.0, 25.0, 0.0),
    "munich": (0.0, 48.0 * math.cos(_DIP), -48.0 * math.sin(_DIP)),
}


def declination(field: Array) -> Array:
    """Angle `(*L)` in rad from north towards east of `field (3, *L)`; 0 where it has no horizontal part."""
    upright = norm(field[:2]) == 0
    return jnp.arctan2(field[0], jnp.where(upright, 1.0, field[1]))


def homogeneous(place: str) -> Array:
    """The field `(3,)`, ENU in µT, of `north_pole`, `equator` or `munich`.

    As Munoz Diaz et al. (Sensors 2017, 17, 832) emulate them: 65 straight down, 25 to the north, 48 to the
    north with a dip of 64°. Real fields at the equator are between 25 and 42.
    """
    if place not in _PLACES:
        raise InputError(f"magnetic field of '{place}' is unknown{suggest(place, _PLACES)}")
    return jnp.array(_PLACES[place])


def earth(latitude_deg: float, longitude_deg: float, height_m: float, date: float | datetime.date) -> Array:
    """The field `(3,)`, ENU in µT, of the World Magnetic Model.

    Geodetic latitude and longitude, height above the WGS 84 ellipsoid, and the date or decimal year, 2010
    to 2030; the model of that time is taken. Needs pygeomag.
    """
    if not -90 <= latitude_deg <= 90:
        raise InputError(f"latitude_deg = {latitude_deg} must be between -90 and 90")
    if not -360 <= longitude_deg <= 360:
        raise InputError(f"longitude_deg = {longitude_deg} must be between -360 and 360")
    if not -1000 <= height_m <= 850e3:
        raise InputError(f"height_m = {height_m} is outside the model, from -1000 to 850000")
    year = _decimal_year(date)
    if not 2010 <= year < 2030:
        raise InputError(f"date = {date} is outside the model, from 2010 until 2030")
    found = _world_model(year).calculate(latitude_deg, longitude_deg, height_m / 1000, year)
    return jnp.array([found.y, found.x, -found.z]) / 1000  # from north, east, down in nT


def _decimal_year(date: float | datetime.date) -> float:
    if not isinstance(date, datetime.date):
        return float(date)
    first, next_first = datetime.date(date.year, 1, 1), datetime.date(date.year + 1, 1, 1)
    return date.year + (date.toordinal() - first.toordinal()) / (next_first - first).days


def _world_model(year: float) -> Any:
    try:
        pygeomag = importlib.import_module("pygeomag")
    except ImportError:
        raise InputError(
            "the Earth's field at a place needs pygeomag: install it with pip install 'pedjax[magnetics]'"
        ) from None
    return pygeomag.GeoMag(base_year=year)
