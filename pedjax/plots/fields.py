"""A magnetic field over a plane."""

from __future__ import annotations

from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from pedjax.errors import InputError, suggest
from pedjax.rotations import wrap
from pedjax.simulation.earth import declination, inclination, norm
from pedjax.simulation.fields import Field, Mode, field_at, inside

What = Literal["norm", "inclination", "heading_error"]

_ACROSS = 300  # points along the longer side
_ARROWS = 24
_LABELS = {
    "norm": "norm of the field (µT)",
    "inclination": "inclination, positive down (°)",
    "heading_error": "heading error of a compass, counter-clockwise (°)",
}
_field_at = jax.jit(field_at, static_argnames="mode")
_inside = jax.jit(inside)


def field_map(
    field: Field,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    height: float,
    what: What = "norm",
    time: float = 0.0,
    mode: Mode = "superpose",
    limits: tuple[float, float] | None = None,
) -> Figure:
    """The field in the plane z = `height` m, seen from above: colour for `what`, arrows for its direction.

    `norm` in µT; `inclination` in degrees; `heading_error`, in degrees, of the yaw that a compass shows which
    takes the horizontal field for the background's. Inside of iron nothing is drawn. The colours leave out
    the extremes next to iron, unless `limits`, in µT or degrees, say what they cover.
    """
    if what not in get_args(What):
        raise InputError(f"map of '{what}' is unknown{suggest(what, get_args(What))}")
    if x_range[0] >= x_range[1] or y_range[0] >= y_range[1]:
        raise InputError(f"x_range = {x_range} and y_range = {y_range} must rise")
    sides = np.array([x_range[1] - x_range[0], y_range[1] - y_range[0]])
    points = np.maximum(np.round(_ACROSS * sides / sides.max()), 2).astype(int)
    x, y = (np.linspace(*each, n) for each, n in zip((x_range, y_range), points, strict=True))
    position = jnp.stack([*jnp.meshgrid(jnp.asarray(x), jnp.asarray(y)), jnp.full(points[::-1], height)])
    vector = _field_at(field, position, time, mode=mode)
    values = np.where(_inside(field, position, time), np.nan, _values(vector, field, what))

    wide, high = sides / sides.max()
    figure = Figure(figsize=(max(7.5 * wide, 3.0) + 1.6, max(7.5 * high, 1.8) + 0.9), layout="constrained")
    ax = figure.subplots()
    mesh = ax.pcolormesh(x, y, values, shading="nearest", rasterized=True, **_colours(values, what, limits))
    low, high = mesh.get_clim()
    beyond = (np.nanmin(values) < low - 1e-9, np.nanmax(values) > high + 1e-9)
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    bar = figure.colorbar(mesh, ax=ax, label=_LABELS[what], extend=extend[bool(beyond[0]), bool(beyond[1])])
    bar.ax.ticklabel_format(useOffset=False)
    step = int(np.ceil(points.max() / _ARROWS))
    some = np.s_[step // 2 :: step, step // 2 :: step]
    level = np.asarray(vector[:2])
    size = np.hypot(*level)
    east, north = np.where(np.isnan(values) | (size == 0), np.nan, level / np.where(size == 0, 1.0, size))
    ax.quiver(
        *(each[some] for each in (*np.meshgrid(x, y), east, north)),
        pivot="mid", color="k", alpha=0.55, angles="xy", scale=1.5 * _ARROWS, scale_units="width",
        width=0.002, headwidth=4,
    )  # fmt: skip
    for place, radius in zip(
        np.asarray(field.cylinders.place), np.asarray(field.cylinders.radius), strict=True
    ):
        ax.add_patch(Circle(place, radius, facecolor="0.7", edgecolor="k", lw=0.6))
    ax.set(xlim=x_range, ylim=y_range, aspect="equal", xlabel="x, east (m)", ylabel="y, north (m)")
    ax.set_title(f"{height:g} m high" + (f", {mode} post only" if mode == "nearest" else ""), fontsize=10)
    return figure


def _values(vector: jax.Array, field: Field, what: What) -> np.ndarray:
    if what == "norm":
        return np.asarray(norm(vector))
    if what == "inclination":
        return np.rad2deg(inclination(vector))
    return np.rad2deg(wrap(declination(vector) - declination(field.background)))


def _colours(values: np.ndarray, what: What, limits: tuple[float, float] | None) -> dict[str, Any]:
    """Twice the range of the middle nine tenths of the values, as far as there are values."""
    low, high = np.nanquantile(values, [0.05, 0.95])
    wide = max(0.5 * (high - low), 1e-4 * max(abs(high), 1.0))
    low, high = max(low - wide, np.nanmin(values)), min(high + wide, np.nanmax(values))
    if high - low < wide:
        low, high = low - wide, high + wide
    if what == "heading_error":
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    low, high = limits or (low, high)
    return {"cmap": "RdBu_r" if what == "heading_error" else "viridis", "vmin": low, "vmax": high}
