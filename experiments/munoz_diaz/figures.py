"""What Munoz Diaz 2017 shows of its means: the fields and noises of Tables 1 and 2, the template of
Fig. 4, the Allan deviations of Fig. 5, what a fibre gyroscope strays in an hour, and the walk past lights and
cars."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from experiments.munoz_diaz import emulated as walks
from experiments.munoz_diaz.emulated import Back, Emulated, emulated, wandering
from experiments.table import Row, row
from pedjax import rotations
from pedjax.evaluation.allan import AllanCurve, allan_curve, log_sizes
from pedjax.evaluation.noise import Readings, read_off
from pedjax.output import write_figure, write_table
from pedjax.runtime import double_precision
from pedjax.simulation import fields
from pedjax.simulation.earth import homogeneous
from pedjax.simulation.presets import preset
from pedjax.simulation.sensors import apply

HOURS = 14.0
"""At rest, for Fig. 5."""
UNITS = {"FOG": "kvh_dsp_1750", "MTw": "xsens_mtw"}
EARTH_RATE, LATITUDE = 7.29e-5, np.radians(48.14)  # rad/s; Munich
PRINTED = {
    "north_pole": (0.0, 0.0, -65.0),
    "equator": (0.0, 25.0, 0.0),
    "munich": (0.0, 48 * np.cos(np.radians(64)), -48 * np.sin(np.radians(64))),
}
"""Table 1, µT."""
LEAST, MOST = 5.0, 50.0  # µT, the colours of Fig. 4
BACKS: tuple[Back, Back] = ("same", "other")


def run(seeds: range, out: Path) -> list[Row]:
    with double_precision():
        rows = [*table_1(), *template(out), *allan(seeds[0], out), *drift(seeds, out)]
        return [*rows, *table_2(seeds), *walk(seeds[0], out)]


def table_1() -> list[Row]:
    rows = []
    for place, printed in PRINTED.items():
        ours = np.asarray(homogeneous(place))
        published, told = ("({})".format(", ".join(f"{x:.2f}" for x in v)) for v in (printed, ours))
        rows.append(
            row(
                "DI-T1",
                f"field, {place}, ENU, uT",
                published,
                told,
                bool(np.allclose(ours, printed, atol=1e-3)),
            )
        )
    return rows


def table_2(seeds: range) -> list[Row]:
    """Noises and biases as they come out of a recording."""
    found = []
    for seed in seeds:
        made = emulated(seed)
        sensor = made.recording.sensors["pocket"]
        assert sensor.magnetometer is not None
        wrong = np.degrees(sensor.gyroscope.values - made.exact.rate)
        seen = np.einsum("tji,tj->ti", made.exact.attitude, made.field)
        found.append([wrong.std(axis=0), wrong.mean(axis=0), (sensor.magnetometer.values - seen).std(axis=0)])
    noise, bias, field = np.mean(found, axis=0)
    rows = []
    for name, ours, printed, within in (
        ("gyroscope noise, deg/s", noise, [0.1, 0.1, 0.1], 0.001),
        ("gyroscope bias, deg/s", bias, [-0.1, 0.1, -0.1], 0.001),
        ("magnetometer noise, uT", field, [0.015, 0.015, 0.015], 0.0002),
    ):
        published, told = (
            "({})".format(", ".join(f"{x:g}" for x in np.round(v, 4))) for v in (printed, ours)
        )
        rows.append(
            row("DI-T2", f"{name}, x y z", published, told, bool(np.allclose(ours, printed, atol=within)))
        )
    return rows


def template(out: Path) -> list[Row]:
    """Fig. 4."""
    street = fields.street_template()
    usual = float(np.linalg.norm(np.asarray(street.background)))
    posts = street.cylinders
    place, radius = np.asarray(posts.place), np.asarray(posts.radius)
    north, east = (
        np.linalg.norm(_at(street, place + (1 + 1e-9) * radius[:, None] * np.array(way)), axis=0)
        for way in ((0.0, 1.0), (1.0, 0.0))
    )
    rows = [
        row("DI-F4", "at the poles, uT", f"scale to {MOST:g} (twice 25)", f"{north.max():.2f}",
            bool(np.allclose(north, 2 * usual, rtol=2e-3))),
        row("DI-F4", "at the sides, uT", f"scale from {LEAST:g}", f"{east.max():.3f}",
            bool(east.max() < 0.1)),
    ]  # fmt: skip
    rng = np.random.default_rng(101)
    free = np.column_stack([rng.uniform(6, 22, 2000), rng.uniform(-20, 15, 2000)])
    free = free[np.all(np.linalg.norm(free[:, None] - place, axis=2) > radius, axis=1)]
    slopes = np.asarray(_slopes(street, jnp.asarray(_upright(free).T)))
    flow = np.abs(np.trace(slopes)).max()
    twist = np.abs(slopes - slopes.transpose(1, 0, 2)).max()
    told = f"{flow:.0e}, {twist:.0e} (slopes up to {np.abs(slopes).max():.0f})"
    rows.append(row("DI-F4", "divergence, curl, uT/m", "none (Eq. 19)", told, bool(max(flow, twist) < 1e-10)))
    write_figure(out / "template.png", _template_figure(street))
    return rows


def _upright(place: np.ndarray) -> np.ndarray:
    return np.column_stack([place, np.ones(len(place))])


def _at(field: fields.Field, place: np.ndarray) -> np.ndarray:
    """The field `(3, N)` at places `(N, 2)`, by the nearest post."""
    return np.asarray(_field_at(field, jnp.asarray(_upright(place).T)))


@jax.jit
def _field_at(field: fields.Field, place: jax.Array) -> jax.Array:
    return fields.field_at(field, place, mode="nearest")


@jax.jit
def _slopes(field: fields.Field, place: jax.Array) -> jax.Array:
    """`(3, 3, N)`, of each component along each axis, off the lines where another post gets nearer."""

    def one(at: jax.Array) -> jax.Array:
        return fields.field_at(field, at, mode="nearest")

    return jax.vmap(jax.jacfwd(one), in_axes=1, out_axes=2)(place)


def _template_figure(street: fields.Field) -> Figure:
    x, y = np.linspace(6, 22, 321), np.linspace(-20, 15, 701)
    grid = np.stack([a.ravel() for a in np.meshgrid(x, y)], axis=1)
    strength = np.linalg.norm(_at(street, grid), axis=0).reshape(len(y), len(x))
    place, radius = np.asarray(street.cylinders.place), np.asarray(street.cylinders.radius)
    figure = Figure(figsize=(9.6, 7.4), layout="constrained")
    whole, car, light = (figure.add_subplot(s) for s in _panels(figure))
    mesh: Any = None
    for ax, (low, high), step in (
        (whole, ((6, -20), (22, 15)), 1.0),
        (car, place[4] + [[-3, -3], [3, 3]], 0.5),
        (light, place[0] + [[-0.3, -0.3], [0.3, 0.3]], 0.05),
    ):
        if ax is whole:
            mesh = ax.pcolormesh(x, y, strength, vmin=LEAST, vmax=MOST, cmap="jet", rasterized=True)
        else:
            a, b = (np.linspace(low[k], high[k], 301) for k in (0, 1))
            fine = np.stack([g.ravel() for g in np.meshgrid(a, b)], axis=1)
            there = np.linalg.norm(_at(street, fine), axis=0).reshape(301, 301)
            ax.pcolormesh(a, b, there, vmin=LEAST, vmax=MOST, cmap="jet", rasterized=True)
        dots = [np.arange(low[k] + step / 2, high[k], step) for k in (0, 1)]
        spots = np.stack([g.ravel() for g in np.meshgrid(*dots)], axis=1)
        away = np.linalg.norm(spots[:, None] - place, axis=2) - radius
        spots = spots[(away > 0.02 * step).all(axis=1)]
        way = _at(street, spots)[:2]
        ax.quiver(*spots.T, *(way / np.linalg.norm(way, axis=0)), scale=1 / (0.7 * step), scale_units="xy",
                  angles="xy", pivot="mid", width=0.004, color="k")  # fmt: skip
        for at, size in zip(place, radius, strict=True):
            ax.add_patch(_disc(at, size))
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(low[1], high[1])
        ax.set_aspect("equal")
        ax.set_xlabel("east (m)")
        ax.set_ylabel("north (m)")
    whole.set_title("a tile: four lights and a car", fontsize=10)
    car.set_title("the car", fontsize=10)
    light.set_title("a light", fontsize=10)
    figure.colorbar(mesh, ax=[car, light], label="strength (µT)", shrink=0.7)
    return figure


def _panels(figure: Figure) -> tuple[Any, Any, Any]:
    grid = figure.add_gridspec(2, 2)
    return grid[:, 0], grid[0, 1], grid[1, 1]


def _disc(place: np.ndarray, radius: float) -> Any:
    from matplotlib.patches import Circle

    return Circle((float(place[0]), float(place[1])), float(radius), color="0.35")


def allan(seed: int, out: Path, hours: float = HOURS) -> list[Row]:
    """Fig. 5."""
    curves = {name: _curve(seed + k, unit, hours) for k, (name, unit) in enumerate(UNITS.items())}
    read = {name: read_off(_before_peak(curve, UNITS[name]), "direct") for name, curve in curves.items()}

    def decades(key: str) -> float:
        logs = {name: np.log10(getattr(r, key)).mean() for name, r in read.items()}
        return float(logs["MTw"] - logs["FOG"])

    rows = []
    for what, key, wanted, sign in (
        ("white noise", "white", 2.0, 1), ("bias stability B", "instability", 2.0, 1),
        ("its time t_B", "instability_tau", 1.0, -1),
    ):  # fmt: skip
        found = sign * decades(key)
        values = " ".join(f"{name} {np.exp(np.log(getattr(r, key)).mean()):.2g}" for name, r in read.items())
        which = "FOG longer" if sign < 0 else "MTw larger"
        published = f"{which} by {wanted:g} decade{'s' if wanted > 1 else ''}"
        rows.append(row("DI-F5", what, published, f"{found:.2f} ({values})", abs(found - wanted) <= 0.5))
    write_table(out / "allan.csv", _allan_table(curves))
    write_figure(out / "allan.png", _allan_figure(curves, read, hours))
    return rows


def _curve(seed: int, unit: str, hours: float) -> AllanCurve:
    """Of a unit's gyroscope at rest, the Earth's rate taken away, in deg/s."""
    triad, rate = preset(unit).gyroscope, walks.RATE
    rng = np.random.default_rng([103, seed])
    count = int(hours * 3600 * rate)
    values = _number(triad.noise) * np.sqrt(rate) * rng.normal(size=(count, 3))
    values += wandering(rng, count, _number(triad.drift_std), _number(triad.drift_time))
    return allan_curve(np.degrees(values), rate, log_sizes(count, per_decade=6))


def _before_peak(curve: AllanCurve, unit: str) -> AllanCurve:
    """The curve before a Gauss-Markov bias peaks, beyond which it averages out and the curve falls again."""
    return curve.at(curve.tau <= _number(preset(unit).gyroscope.drift_time))


def _number(x: Any) -> float:
    return float(x)


def _allan_table(curves: dict[str, AllanCurve]) -> dict[str, list[Any]]:
    table: dict[str, list[Any]] = {"unit": [], "tau_s": [], "x": [], "y": [], "z": []}
    for name, curve in curves.items():
        for tau, deviation in zip(curve.tau, curve.deviation, strict=True):
            for key, value in zip(table, (name, tau, *deviation), strict=True):
                table[key].append(value)
    return table


def _allan_figure(curves: dict[str, AllanCurve], read: dict[str, Readings], hours: float) -> Figure:
    figure = Figure(figsize=(7, 4.6), layout="constrained")
    ax = figure.subplots()
    for (name, curve), style in zip(curves.items(), ("-", "--"), strict=True):
        for axis, colour in enumerate(("C0", "C3", "C2")):
            rad = np.radians(curve.deviation[:, axis])
            ax.loglog(curve.tau, rad, style, color=colour, lw=1.2, label=f"{name}, {'xyz'[axis]}")
            b = np.radians(read[name].instability[axis])
            ax.plot(read[name].instability_tau[axis], b, "v", color=colour, ms=6, mfc="none")
    ax.set_xlabel("averaged time (s)")
    ax.set_ylabel("Allan deviation (rad/s)")
    ax.set_title(f"{hours:g} h at rest; triangles: B at t_B", fontsize=10)
    ax.grid(alpha=0.3, which="both", lw=0.5)
    ax.legend(fontsize=8, ncols=2)
    return figure


def drift(seeds: range, out: Path) -> list[Row]:
    """Eq. 26 and 27: a fibre gyroscope that lies level in Munich for an hour, no bias subtracted. A second
    is a step: nothing turns but the Earth."""
    turning = EARTH_RATE * jnp.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
    triad = preset("kvh_dsp_1750").gyroscope
    still = jnp.broadcast_to(turning, (3600, 3))

    @jax.jit
    def angles(key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        measured = apply(triad, key, 1.0, still)
        return (
            _strayed(measured.values, turning),
            _strayed(measured.values - measured.bias[0], turning),
            _strayed(measured.values, 0 * turning),
        )

    found = np.degrees(np.stack([np.stack(angles(jax.random.key(s + 104729))) for s in seeds]))
    most = np.abs(found).max(axis=(2, 3))  # of any axis at any time
    whole, steady, raw = most.T
    told = (
        f"{np.median(whole):.2f} in the median, below 1 in {100 * (whole < 1).mean():.0f} % of {len(whole)}"
    )
    steady_told = f"{np.median(steady):.3f} in the median, {steady.max():.3f} at most"
    rows = [
        row("DI-t", "FOG, angles after 1 h, deg", "below 1 in any angle", told, bool(np.median(whole) < 1)),
        row("DI-t", "  without its turn-on bias", "-", steady_told, None),
        row("DI-t", "  the Earth's rate left in", "15 deg/h", f"{np.median(raw):.1f}", None),
    ]
    write_table(
        out / "drift.csv", {"seed": list(seeds), "deg": whole, "no_bias_deg": steady, "earth_deg": raw}
    )
    return rows


def _strayed(rate: jax.Array, turning: jax.Array) -> jax.Array:
    """Euler angles `(N, 3)` rad of a strapdown from level, its rates `(N, 3)` at 1 Hz."""

    def step(c: jax.Array, measured: jax.Array) -> tuple[jax.Array, jax.Array]:
        c = c @ rotations.exp(measured - c.T @ turning)
        return c, rotations.to_euler(c)

    return jax.lax.scan(step, jnp.eye(3), rate)[1]


def walk(seed: int, out: Path) -> list[Row]:
    """Fig. 7 and 10a, on one line and on lines of their own; and how the thigh swings."""
    rows: list[Row] = []
    found = {back: emulated(seed, "street", back=back) for back in BACKS}
    lines = []
    for back, made in found.items():
        met = walks.meetings(made, walks.street(back))
        path = made.exact.position[:, :2]
        far = float(np.linalg.norm(np.diff(path[::50], axis=0), axis=1).sum()) / 1e3
        time = made.exact.time[-1] / 60
        told = f"{time:.1f} min, {far:.2f} km"
        near = abs(time - 39) < 0.5 and abs(far - 3) < 0.2
        rows.append(row("DI-F7", f"walk, {back} line", "39 min, about 3 km", told, near))
        norm = np.linalg.norm(made.field, axis=1)
        inside = norm.min() > 21.5 and norm.max() < 28.5
        told = f"{norm.min():.1f} to {norm.max():.1f}"
        rows.append(row("DI-F10", f"strength, {back} line, uT", "about 22 to 28", told, bool(inside)))
        large = [m for m in met if abs(m.size) > 1]
        told = f"{len(large)} times"
        wanted = "lights at 24, 35 min, cars at 16, 32"
        if back == "other":
            told = ", ".join(f"{m.what} {m.time / 60:.1f}" for m in large)
            times = np.array([m.time / 60 for m in large])
            hit = len(times) == 4 and bool(np.abs(times - [16, 24, 32, 35]).max() < 0.5)
        else:
            hit = None
        rows.append(row("DI-F10", f"above 1 uT, {back} line", wanted, told, hit))
        lines += [{"back": back, **m._asdict()} for m in met]
    write_table(out / "meetings.csv", {key: [line[key] for line in lines] for key in lines[0]})
    s = walks.swing(found["same"].exact)
    close = abs(s.amplitude - 22) < 3, abs(s.frequency - 0.95) < 0.1, s.off_upright < 5
    calm, upright = "moments of ||f| - 9.8| < 0.5", "  z off upright in them (always), deg"
    told = f"{s.off_upright:.0f} ({s.off_upright_all:.0f})"
    rows += [
        row("DI-t", "swing of the thigh, deg", "22, assumed", f"{s.amplitude:.1f}", close[0]),
        row("DI-t", "its frequency, Hz", "0.95, assumed", f"{s.frequency:.2f}", close[1]),
        row("DI-t", calm, "-", f"{100 * s.share:.0f} % of the walk", None),
        row("DI-t", upright, "leg completely vertical", told, close[2]),
    ]
    write_figure(out / "street.png", _walk_figure(found))
    write_figure(out / "thigh.png", _thigh_figure(found["same"]))
    return rows


def _walk_figure(found: dict[Back, Emulated]) -> Figure:
    figure = Figure(figsize=(10, 6), layout="constrained")
    axes = figure.subplots(2, 2)
    for (above, below), (back, made) in zip(axes.T, found.items(), strict=True):
        posts = walks.street(back).cylinders
        place, is_car = np.asarray(posts.place), np.asarray(posts.radius) > 0.5
        path = made.exact.position[::100]
        above.plot(path[:, 0], path[:, 1], color="C3", lw=0.8)
        above.plot(*place[~is_car].T, ".", color="C2", ms=5, label="lights")
        above.plot(*place[is_car].T, "o", color="C0", ms=6, label="cars")
        above.set_title(f"back on {'the same line' if back == 'same' else 'other lines'}", fontsize=10)
        above.set_xlabel("east (m)")
        above.set_ylabel("north (m)")
        above.set_ylim(-35, 35)
        norm = np.linalg.norm(made.field, axis=1)
        below.plot(made.exact.time / 60, norm, lw=0.8)
        crossing = made.crossing
        below.plot(made.exact.time[crossing] / 60, norm[crossing], "|", color="C3", ms=7,
                   label="another post is the nearest")  # fmt: skip
        for time in (16, 24, 32, 35):
            below.axvline(time, color="0.7", lw=0.8, ls=":", zorder=0)
        below.set_xlabel("time (min); dotted: disturbances in the paper")
        below.set_ylabel("strength (µT)")
        below.set_ylim(22, 29)
        for ax in (above, below):
            ax.legend(fontsize=8, loc="lower right")
            ax.grid(alpha=0.3)
    return figure


def _thigh_figure(made: Emulated) -> Figure:
    figure = Figure(figsize=(7, 5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    some = slice(3000, 3500)
    time, exact = made.exact.time[some], made.exact
    pitch = np.degrees(-np.arcsin(exact.attitude[some, 2, 0]))
    force = np.linalg.norm(exact.force[some], axis=1)
    calm = np.abs(force - 9.8) < 0.5
    for ax, values, name in (
        (above, pitch, "pitch of the thigh (deg)"),
        (below, force, "specific force (m/s²)"),
    ):
        ax.plot(time, values, lw=1)
        ax.plot(time[calm], values[calm], ".", color="C3", ms=5, label="within 0.5 m/s² of 9.8")
        ax.set_ylabel(name)
        ax.grid(alpha=0.3)
    below.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2))
    below.set_xlabel("time (s)")
    return figure
