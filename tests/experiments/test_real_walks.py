"""What the experiments show on public recordings, held to its bar. Skipped where they are not at hand."""

import os
from pathlib import Path

import numpy as np
import pytest

import pedjax
from experiments import pyshoe_vicon
from pedjax import config, parameters
from pedjax.identity import fingerprint
from pedjax.recording import Recording


@pytest.fixture(scope="module")
def vicon() -> list[Path]:
    folder = os.environ.get("PEDJAX_DATA")
    if not folder:
        pytest.skip("PEDJAX_DATA does not name the folder of real recordings")
    found = sorted((Path(folder) / "footmounted_gx5" / "vicon").glob("*.mat.gz"))
    if not found:
        pytest.skip("no Vicon trials in the folder that PEDJAX_DATA names")
    return found


@pytest.mark.slow
def test_errors_agree_with_those_of_pyshoe(vicon):
    differences = []
    for path in vicon[::3]:
        threshold, theirs = pyshoe_vicon.authors(path)
        recording = pedjax.read(str(path))
        params = parameters.replace(
            pedjax.system("iez").defaults(),
            {**pyshoe_vicon.NINE_STATES, "stance.shoe.threshold": threshold, "stance.rule": "block"},
        )
        track = pedjax.run(recording, "iez", params, clock="uniform")
        differences.append(pyshoe_vicon.direction_aligned_armse(track, recording) - theirs)
    assert np.abs(differences).max() < 0.012
    assert abs(np.median(differences)) < 0.003


@pytest.mark.slow
def test_the_adaptive_preset_holds_on_trials_it_was_not_tuned_on(vicon):
    preset = config.load("iez_adaptive")
    _, params = config.resolve(preset)
    recordings = [pedjax.read(str(path)) for path in vicon]
    _, held_back = pedjax.split(recordings, 0.5, seed=0)
    held: list[Recording] = [recordings[i] for i in held_back]
    assert not {fingerprint(r) for r in held} & set(preset.tuned_on)
    errors = pedjax.sweep(held, {"gravity": np.array([params.gravity])}, "iez", params).loss[0]
    assert errors.mean() < 0.08
    published = pedjax.sweep(held, {"stance.shoe.threshold": np.array([8.5e7])}).loss[0]
    assert errors.mean() < 0.5 * published.mean()
