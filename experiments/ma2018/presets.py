"""The presets of Ma 2018 over recordings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pedjax
from pedjax import config, parameters


def params_of(preset: str, changes: Mapping[str, Any] | None = None) -> Any:
    """The parameters of a preset with changes."""
    _, params = config.resolve(config.load(preset))
    return parameters.replace(params, changes or {})


def run(recording: pedjax.Recording, preset: str, changes: Mapping[str, Any] | None = None) -> pedjax.Track:
    return pedjax.run(recording, "ma2018", params_of(preset, changes))


def score(track: pedjax.Track, recording: pedjax.Recording) -> pedjax.Score:
    """Landmark errors after the best yaw and translation."""
    found = pedjax.evaluate(track, recording, alignment="yaw_translation")
    assert found is not None
    return found
