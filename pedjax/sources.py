"""Recordings by name: files, and the walks that the package makes itself."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pedjax.errors import InputError
from pedjax.readers import read
from pedjax.recording import Recording
from pedjax.simulation.motion import Motion
from pedjax.simulation.scenarios import scenarios
from pedjax.simulation.truth import SensorTruth
from pedjax.simulation.world import Simulated, simulate


def is_made(name: str) -> bool:
    """Whether a name stands for a walk that the package makes: a scenario that comes along, as `demo` or
    `office-loop:3` (`SCENARIO:SEED`), or several, as `demo:1..8`."""
    return name.partition(":")[0] in scenarios() and not Path(name).exists()


def read_any(name: str | os.PathLike[str], config: str | None = None, sensor: str | None = None) -> Recording:
    """A file, or `SCENARIO:SEED`."""
    name = os.fspath(name)
    return made(name).recording if is_made(name) else read(name, config=config, sensor=sensor)


def made(name: str) -> Simulated:
    """A walk that the package makes, with all that is true of it."""
    scenario, _, seed = name.partition(":")
    if not (seed or "0").isdigit():
        raise InputError(f"'{name}': the seed of a made walk is a whole number, as in {scenario}:3")
    return simulate(scenario, int(seed or "0"))


def spelled_out(names: Sequence[str]) -> list[str]:
    """The same names, `SCENARIO:FIRST..LAST` replaced by each of its walks.

    >>> spelled_out(["walk.csv", "demo:1..3"])
    ['walk.csv', 'demo:1', 'demo:2', 'demo:3']
    """
    found: list[str] = []
    for name in names:
        scenario, _, seeds = name.partition(":")
        first, dots, last = seeds.partition("..")
        if not (dots and is_made(name)):
            found.append(name)
        elif first.isdigit() and last.isdigit() and int(first) <= int(last):
            found += [f"{scenario}:{seed}" for seed in range(int(first), int(last) + 1)]
        else:
            raise InputError(
                f"'{name}': several made walks are named by whole numbers, as in {scenario}:1..8"
            )
    return found


def read_all(
    names: Sequence[str | os.PathLike[str]], config: str | None = None, sensor: str | None = None
) -> list[Recording]:
    """All of them, in order."""
    return [read_any(name, config, sensor) for name in names]


def read_labelled(
    name: str | os.PathLike[str], config: str | None = None, sensor: str = "foot"
) -> tuple[Recording, SensorTruth]:
    """A recording and what is true of one of its sensors: a made walk, or a file that `pedjax simulate` wrote
    with its truth beside it."""
    name = os.fspath(name)
    if is_made(name):
        walk = made(name)
        if sensor not in walk.truth:
            raise InputError(f"{name}: has no sensor '{sensor}', but {', '.join(walk.truth)}")
        return walk.recording, walk.truth[sensor]
    recording = read(name, config=config)
    return recording, _truth_of(_beside(name), recording, sensor)


def read_with_truth(
    name: str | os.PathLike[str], config: str | None = None, sensor: str = "foot"
) -> tuple[Recording, SensorTruth | None]:
    """A recording, and what is true of one of its sensors where that is known, as in `read_labelled`."""
    name = os.fspath(name)
    if is_made(name) or _beside(name).exists():
        return read_labelled(name, config, sensor)
    return read(name, config=config), None


def _beside(name: str) -> Path:
    """Where `pedjax simulate` writes the truth of a file."""
    path = Path(name)
    return path.with_name(f"{path.name.removesuffix('.gz').removesuffix('.csv')}.truth.npz")


_REMEDY = (
    "name a made walk, as office-loop:0, or a file that 'pedjax simulate' wrote with its truth beside it"
)


def _truth_of(beside: Path, recording: Recording, sensor: str) -> SensorTruth:
    """The truth that `pedjax simulate` writes."""
    if not beside.exists():
        raise InputError(
            f"{recording.name}: an ROC of field detectors needs the true field at the foot, and there is no "
            f"{beside.name} beside it; {_REMEDY}"
        )
    try:
        with np.load(beside) as file:
            known = [
                name.removesuffix("_magnetic_field") for name in file if name.endswith("_magnetic_field")
            ]
            if sensor not in known:
                raise InputError(
                    f"{beside}: has no truth of sensor '{sensor}', but of {', '.join(known) or 'none'}"
                )
            motion = Motion(*(file[f"{sensor}_{name}"] for name in Motion._fields))
            own = [x for x in SensorTruth._fields if x not in ("time", "motion")]
            given = {name: file[f"{sensor}_{name}"] for name in own}
    except KeyError as error:
        raise InputError(f"{beside}: has no {error.args[0]}; repeat 'pedjax simulate'") from None
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{beside}: cannot be read ({error}); repeat 'pedjax simulate'") from None
    truth = SensorTruth(time=motion.time, motion=motion, **given)
    stamps = recording.sensors[sensor].gyroscope.time if sensor in recording.sensors else truth.time
    if stamps[0] < truth.time[0] - 0.1 or stamps[-1] > truth.time[-1] + 0.1:
        raise InputError(f"{beside}: ends before {recording.name} does; it belongs to another walk")
    return truth
