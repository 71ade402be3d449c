"""The guide to systems, aids, detectors and losses of one's own: its blocks run, in every command."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import pedjax
from pedjax import parameters
from pedjax.aids import AIDS
from pedjax.cli import main
from pedjax.detectors.field import FIELD_DETECTORS
from pedjax.detectors.stance import DETECTORS
from pedjax.evaluation.scores import SCORES
from pedjax.systems import SYSTEMS, assembled
from pedjax.tuning import TuneSettings
from tests import tools

GUIDE = Path(__file__).parent.parent / "docs" / "extending.md"
BLOCKS = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)


@pytest.fixture(scope="module", autouse=True)
def forgotten():
    """What the blocks register is not there for other tests."""
    registries = (SYSTEMS, AIDS, DETECTORS, FIELD_DETECTORS, SCORES, parameters._OFFERED)
    before = [dict(registry) for registry in registries]
    yield
    for registry, known in zip(registries, before, strict=True):
        registry.clear()
        registry.update(known)


@pytest.fixture(scope="module")
def plugin(tmp_path_factory):
    """All blocks in one file, as a user would keep them."""
    path = tmp_path_factory.mktemp("plugin") / "mine.py"
    path.write_text("\n\n".join(BLOCKS))
    return str(path)


@pytest.fixture(scope="module")
def walk():
    return tools.crop(pedjax.read("demo:1"), 12.0)


def test_blocks_are_short():
    assert len(BLOCKS) == 4
    assert all(sum(map(bool, block.splitlines())) < 30 for block in BLOCKS)


def test_run_and_parameters_know_them(plugin, tmp_path, capsys):
    assert main(["parameters", "--with", plugin, "--system", "one_floor"]) == 0
    printed = capsys.readouterr().out
    assert "floor.sigma" in printed
    assert "stance.jerk.threshold" in printed
    assert "raised, heights are believed less" in printed
    out = tmp_path / "out"
    chosen = ["--system", "one_floor", "--set", "stance.detector=jerk"]
    assert main(["run", "demo:1", "--with", plugin, *chosen, "--out", str(out), "--no-figures"]) == 0
    entry = json.loads((out / "metrics.json").read_text())["recordings"][0]
    assert 0.1 < entry["stance_fraction"] < 0.9
    again = ["run", "--config", str(out / "config.toml"), "--out", str(tmp_path / "again"), "--no-figures"]
    assert main(again) == 0


def test_the_aid_does_what_it_says(plugin, walk):
    from pedjax.config import load_plugin

    load_plugin(plugin)
    one, none = (pedjax.run(walk, name) for name in ("one_floor", "iez"))
    assert np.abs(one.position[:, 2]).max() < 0.5 * np.abs(none.position[:, 2]).max() + 0.3
    assert list(one.gates) == ["stance"]


def test_tune_and_sweep_by_the_loss(plugin, walk):
    from pedjax.config import load_plugin

    load_plugin(plugin)
    given = {"stance.jerk.threshold": np.array([100.0, 400.0, 1600.0])}
    params = parameters.replace(pedjax.system("iez").defaults(), {"stance.detector": "jerk"})
    found = pedjax.sweep([walk], given, params=params, loss="height_rms")
    assert np.isfinite(found.scores["height_rms_m"]).all()
    settings = TuneSettings(
        names=("stance.jerk.threshold", "updates.zero_velocity"),
        loss="height_rms", iterations=2, starts=1, grid=3, check_every=1, validation=0.0,
    )  # fmt: skip
    tuned = pedjax.tune([walk], settings, "iez", params)
    assert tuned.after["tuned_on"]["demo:1"] <= tuned.before["tuned_on"]["demo:1"]


def test_roc_judges_the_detector(plugin, tmp_path, capsys):
    out = tmp_path / "out"
    options = [
        "--with",
        plugin,
        "--kind",
        "stance",
        "--detectors",
        "jerk",
        "shoe",
        "--out",
        str(out),
        "--no-figures",
    ]
    assert main(["roc", "demo:1", *options]) == 0, capsys.readouterr().err
    assert (out / "roc_jerk.toml").exists()


def test_a_config_makes_a_system_of_aids(tmp_path, capsys):
    config = tmp_path / "mine.toml"
    config.write_text(
        'system = { name = "compass_alone", filter = "inertial", aids = ["zero_velocity", '
        '"magnetic_heading"] }\n'
    )
    out = tmp_path / "out"
    assert main(["run", "demo:1", "--config", str(config), "--out", str(out), "--no-figures"]) == 0
    entry = json.loads((out / "metrics.json").read_text())["recordings"][0]
    assert {"stance_fraction", "field_fraction"} <= set(entry)
    assert main(["run", "--config", str(out / "config.toml"), "--out", str(out), "--no-figures"]) == 0
    config.write_text('system = { name = "x", aids = ["zero_velosity"] }\n')
    assert main(["run", "demo:1", "--config", str(config), "--out", str(out)]) == 1
    assert "did you mean 'zero_velocity'" in capsys.readouterr().err


def test_the_same_aids_once_more_are_the_same_system():
    first = assembled("again", "inertial", ["zero_velocity"])
    assert assembled("again", "inertial", ["zero_velocity"]) is first


@pytest.mark.parametrize(
    ("text", "message"),
    [("import nothing_of_that_name", "ModuleNotFoundError"), ("1 / 0", "ZeroDivisionError")],
)
def test_a_plugin_that_fails_is_named(tmp_path, capsys, text, message):
    path = tmp_path / "broken.py"
    path.write_text(text)
    assert main(["parameters", "--with", str(path)]) == 1
    assert message in capsys.readouterr().err
    assert main(["parameters", "--with", str(tmp_path / "missing.py")]) == 1
    assert "no such Python file" in capsys.readouterr().err
