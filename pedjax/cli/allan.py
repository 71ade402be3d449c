"""The command `allan`: the noise of one sensor at rest."""

from __future__ import annotations

import argparse
from typing import Any, NamedTuple

import numpy as np

from pedjax import __version__
from pedjax.cli.common import say
from pedjax.errors import InputError
from pedjax.evaluation.allan import AllanCurve, allan_curve, even_rate
from pedjax.evaluation.noise import (
    IEEE_FACTOR,
    PARAMETERS,
    TERMS,
    Noise,
    Readings,
    identify,
    published_gauss_markov,
    read_off,
)
from pedjax.output import folder, write_figure, write_json, write_table
from pedjax.recording import STANDARD_GRAVITY, Recording, Sensor, Stream
from pedjax.sources import read_all

STREAMS = ("gyroscope", "accelerometer", "magnetometer")

_HOUR, _ROOT_HOUR = 3600.0, 60.0
_SYMBOLS = dict(zip(PARAMETERS, ("Q", "N", "B", "K", "R", "std", "time"), strict=True))


class _Sheet(NamedTuple):
    """The unit of a stream, as it is in column names, the unit that is drawn, and by parameter the unit of
    data sheets, each with the factor that leads there."""

    unit: str
    column: str
    drawn: tuple[str, float]
    units: dict[str, tuple[str, float]]


def _sheet(
    unit: str,
    column: str,
    drawn: tuple[str, float],
    integral: tuple[str, float],
    walk: tuple[str, float],
    bias: tuple[str, float],
) -> _Sheet:
    name, factor = bias
    units = {
        "quantisation": integral,
        "white": walk,
        "bias_instability": bias,
        "random_walk": (f"{name}/sqrt(h)", factor * _ROOT_HOUR),
        "ramp": (f"{name}/h", factor * _HOUR),
        "gauss_markov_std": bias,
        "gauss_markov_time": ("s", 1.0),
    }
    return _Sheet(unit, column, drawn, units)


_DEGREE, _MG = 180.0 / np.pi, 1e3 / STANDARD_GRAVITY
_SHEETS = {
    "gyroscope": _sheet(
        "rad/s", "rad_per_s", ("deg/s", _DEGREE),
        ("deg", _DEGREE), ("deg/sqrt(h)", _DEGREE * _ROOT_HOUR), ("deg/h", _DEGREE * _HOUR),
    ),
    "accelerometer": _sheet(
        "m/s²", "m_per_s2", ("mg", _MG), ("m/s", 1.0), ("m/s/sqrt(h)", _ROOT_HOUR), ("mg", _MG)
    ),
    "magnetometer": _sheet(
        "µT", "ut", ("nT", 1e3), ("µT s", 1.0), ("nT sqrt(s)", 1e3), ("nT", 1e3)
    ),
}  # fmt: skip


def add_parser(commands: Any, recordings: argparse.ArgumentParser) -> None:
    """Add `allan` to the commands; `recordings` is the parser that commands with recordings share."""
    parser = commands.add_parser(
        "allan", parents=[recordings], help="noise of a sensor at rest: Allan deviation and what makes it"
    )
    parser.add_argument("--stream", choices=STREAMS, default="gyroscope", help="default: gyroscope")
    parser.add_argument(
        "--rest", type=float, nargs=2, metavar=("START", "END"),
        help="the stretch at rest, s on the recording's clock (default: all of it)",
    )  # fmt: skip
    parser.add_argument(
        "--shortest", type=float, default=0.0, metavar="S",
        help="fit from this cluster time on, beyond the sensor's own filter (default: all)",
    )  # fmt: skip
    parser.add_argument(
        "--instability", choices=("ieee", "direct"), default="ieee",
        help="bias instability read off as the minimum over 0.664 (ieee), or the minimum itself (direct)",
    )  # fmt: skip


def allan(args: argparse.Namespace) -> int:
    """Curve, noise terms and their picture."""
    from pedjax.plots.allan import allan_figure  # here: the parser above is needed at every start

    if len(args.recordings) != 1:
        raise InputError(
            f"allan takes one recording, {len(args.recordings)} were named; run it once for each"
        )
    recording = read_all(args.recordings, args.format)[0]
    name = args.sensor or (next(iter(recording.sensors)) if len(recording.sensors) == 1 else "foot")
    sensor, where = recording.sensor(name), f"{args.recordings[0]}: {args.stream} of sensor '{name}'"
    stream = getattr(sensor, args.stream)
    if stream is None:
        raise InputError(f"{where}: the recording has none; choose another --stream")
    stream = _at_rest(stream, recording, args.rest, where)
    rate = even_rate(stream.time, where)
    curve = allan_curve(stream.values, rate)
    readings, noises = read_off(curve, args.instability), identify(curve, shortest=args.shortest)
    sheet = _SHEETS[args.stream]
    duration = len(stream.time) / rate
    say(f"{where}: {len(stream.time)} samples at {rate:.4g} Hz, {duration:.0f} s")
    notes = _moving(sensor, float(stream.time[0]), float(stream.time[-1]))
    notes += [f for f in recording.findings if args.stream in f or "gap" in f]
    for note in notes:
        say(f"  look at: {note}")
    for c, (axis, noise) in enumerate(zip("xyz", noises, strict=True)):
        say(*_lines(axis, noise, readings, c, args.instability, sheet))
    out = folder(args.out or "out")
    write_table(out / "allan.csv", _table(curve, noises, sheet))
    told = {
        "pedjax_version": __version__, "path": str(args.recordings[0]), "sensor": name, "stream": args.stream,
        "unit": sheet.unit, "rate_hz": rate, "samples": len(stream.time), "duration_s": duration,
        "fitted_from_s": args.shortest, "instability_reading": args.instability, "warnings": notes,
        "axes": {axis: _axis(c, curve, noise, readings, sheet) for c, (axis, noise) in
                 enumerate(zip("xyz", noises, strict=True))},
    }  # fmt: skip
    write_json(out / "noise.json", told)
    if not args.no_figures:
        labels = [{term: _amount(term, noise, sheet) for term in noise.terms} for noise in noises]
        title = f"{recording.name}: {args.stream} of sensor '{name}', {duration:.0f} s at {rate:.4g} Hz"
        figure = allan_figure(curve, noises, "xyz", sheet.drawn[0], sheet.drawn[1], labels, title)
        write_figure(out / "allan.png", figure)
    say(f"results in {out}")
    return 0


def _at_rest(stream: Stream, recording: Recording, rest: list[float] | None, where: str) -> Stream:
    """The samples between the two times, on the clock with which the recording is to be read."""
    time = stream.time
    if recording.clock == "uniform":  # late stamps of even samples
        time = np.linspace(time[0], time[-1], len(time))
    if rest is None:
        return Stream(time, stream.values)
    start, end = rest
    keep = (time >= start) & (time <= end)
    if not keep.any():
        raise InputError(
            f"{where}: --rest {start:g} {end:g} holds no sample; the recording goes from {time[0]:.3f} to "
            f"{time[-1]:.3f} s"
        )
    return Stream(time[keep], stream.values[keep])


def _moving(sensor: Sensor, start: float, end: float) -> list[str]:
    """A line for each instrument that shows motion: seconds that shake or turn more than noise at rest."""
    lines = []
    for kind, shake, turn, unit in (("gyroscope", 0.1, 0.02, "rad/s"), ("accelerometer", 0.5, 0.1, "m/s²")):
        stream: Stream = getattr(sensor, kind)
        inside = (stream.time >= start) & (stream.time <= end)
        values, width = stream.values[inside], max(round(stream.rate), 2)
        seconds = values[: len(values) // width * width].reshape(-1, width, values.shape[1])
        if not len(seconds):
            continue
        spread = np.linalg.norm(seconds.std(axis=1), axis=1)
        mean = seconds.mean(axis=1)
        away = np.linalg.norm(mean - np.median(mean, axis=0), axis=1)
        moves = (spread > shake) | (spread > 4 * np.median(spread)) | (away > turn)
        if moves.any():
            at = float(stream.time[inside][int(moves.argmax()) * width])
            lines.append(
                f"it is not at rest: the {kind} shows motion in {moves.sum()} of {len(moves)} s, first at "
                f"{at:.0f} s (spread up to {spread.max():.3g} {unit}); the curve is then no sensor's noise, "
                "cut with --rest START END"
            )
    return lines


def _number(value: float, sigma: float | None = None) -> str:
    return f"{value:.4g}" if sigma is None else f"{value:.4g} ± {sigma:.2g}"


def _seconds(value: float) -> str:
    return f"{value:.0f} s" if value >= 100 else f"{value:.3g} s"


def _amount(term: str, noise: Noise, sheet: _Sheet) -> str:
    """A term's parameters in the units of data sheets."""
    said = []
    for name in TERMS[term]:
        unit, factor = sheet.units[name]
        number = _number(factor * noise.values[name], factor * noise.sigmas[name])
        said.append(f"{_SYMBOLS[name]} {number} {unit}")
    return ", ".join(said)


def _lines(axis: str, noise: Noise, readings: Readings, c: int, rule: str, sheet: _Sheet) -> list[str]:
    """What is found on one axis, a line a term, and what the curve reads."""
    lines = [f"{axis}  fitted: {', '.join(term.replace('_', ' ') for term in noise.terms)}" + (
        f"; deviations are off by {noise.misfit:.1%} beyond chance" if noise.misfit > 0 else ""
    )]  # fmt: skip
    for term in noise.terms:
        si = ", ".join(f"{noise.values[name]:.3g} {_si(name, sheet.unit)}" for name in TERMS[term])
        doubt = "" if noise.support[term] > 0.95 else f", support {noise.support[term]:.0%}"
        lines.append(f"     {term.replace('_', ' ')}: {_amount(term, noise, sheet)} ({si}{doubt})")
    read = []
    for name, value in (("white", readings.white[c]), ("random_walk", readings.random_walk[c])):
        unit, factor = sheet.units[name]
        said = f"{_number(factor * value)} {unit}" if np.isfinite(value) else "no such slope"
        read.append(f"{_SYMBOLS[name]} {said}")
    unit, factor = sheet.units["bias_instability"]
    at_most = "at most " if readings.at_end[c] else ""
    how = "minimum / 0.664" if rule == "ieee" else "minimum"
    read.append(
        f"bias instability {at_most}{_number(factor * readings.instability[c])} {unit} "
        f"({how}, at {_seconds(readings.instability_tau[c])})"
    )
    return [*lines, f"     read off: {', '.join(read)}"]


def _si(name: str, unit: str) -> str:
    """The unit of a parameter where samples are in `unit`."""
    return {
        "quantisation": f"{unit} s", "white": f"{unit} sqrt(s)", "random_walk": f"{unit}/sqrt(s)",
        "ramp": f"{unit}/s", "gauss_markov_time": "s",
    }.get(name, unit)  # fmt: skip


def _axis(c: int, curve: AllanCurve, noise: Noise, readings: Readings, sheet: _Sheet) -> dict[str, Any]:
    """Everything about one axis, for the file."""
    published = published_gauss_markov(curve)
    minimum = float(curve.deviation[:, c].min())
    return {
        "terms": noise.terms,
        "parameters": {
            name: {
                "value": value, "sigma": noise.sigmas[name], "unit": _si(name, sheet.unit),
                "data_sheet": {
                    "value": sheet.units[name][1] * value,
                    "sigma": sheet.units[name][1] * noise.sigmas[name],
                    "unit": sheet.units[name][0],
                },
            }
            for name, value in noise.values.items()
        },
        "support": noise.support,
        "chi2": noise.chi2, "dof": noise.dof, "misfit": noise.misfit,
        "read_off": {
            "white": readings.white[c], "random_walk": readings.random_walk[c],
            "minimum": minimum, "minimum_s": readings.instability_tau[c],
            "minimum_at_end": readings.at_end[c],
            "bias_instability_ieee": minimum / IEEE_FACTOR, "bias_instability_direct": minimum,
        },
        "published_gauss_markov": {name: value[c] for name, value in published._asdict().items()},
    }  # fmt: skip


def _table(curve: AllanCurve, noises: list[Noise], sheet: _Sheet) -> dict[str, list[Any]]:
    low, high = curve.band()
    table: dict[str, list[Any]] = {
        "tau_s": curve.tau.tolist(), "size": curve.size.tolist(), "clusters": curve.clusters.tolist()
    }  # fmt: skip
    for c, axis in enumerate("xyz"):
        columns = {
            "deviation": curve.deviation[:, c], "low": low[:, c], "high": high[:, c],
            "fit": noises[c].deviation(curve.tau),
        }  # fmt: skip
        table |= {f"{name}_{axis}_{sheet.column}": values.tolist() for name, values in columns.items()}
        table[f"edf_{axis}"] = curve.edf[:, c].tolist()
    return table
