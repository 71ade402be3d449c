"""Presets over recordings."""

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
    """A recording with a preset's system and parameters, with changes."""
    system, params = config.resolve(config.load(preset))
    return pedjax.run(recording, system, parameters.replace(params, changes or {}))


def score(track: pedjax.Track, recording: pedjax.Recording) -> pedjax.Score:
    """Landmark errors after the best yaw and translation."""
    found = pedjax.evaluate(track, recording, alignment="yaw_translation")
    assert found is not None
    return found
