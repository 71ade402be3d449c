"""The command `sigmas`: a detector's sigmas as a config that other commands take."""

import tomllib

import pytest

from pedjax import sources
from pedjax.readers import write_csv
from tests import tools
from tests.cli.calling import call, metrics, refused


@pytest.fixture(scope="module")
def walk(tmp_path_factory, straight):
    """A walk in a homogeneous field as a file, without its truth."""
    path = tmp_path_factory.mktemp("walk") / "walk.csv"
    write_csv(straight.recording, path)
    return path


def test_sigmas_are_a_config_that_run_takes(walk, tmp_path, capsys):
    out = tmp_path / "out"
    given = ("--config", "ma2018_zupt", "--set", "field.ma.sigma_strength=0.7")
    assert call("sigmas", walk, *given, "--out", out) == 0
    said = capsys.readouterr().out
    assert "windows count as quasi-static" in said
    assert "uT; default 0.535 (Ma 2018: 5.35 mGs), before 0.7" in said
    found = metrics(out)
    assert found["detector"] == "ma"
    assert found["recordings"][0]["used"] == found["used"] >= 20
    assert found["sigmas"]["sigma_strength"]["by_truth"] is None
    chosen = tomllib.loads((out / "sigmas.toml").read_text())
    assert chosen["system"] == "ma2018"
    assert chosen["parameters"]["compass"]["update"] == "none"
    assert len(chosen["tuned_on"]) == 1
    for name, row in found["sigmas"].items():
        assert chosen["parameters"]["field"]["ma"][name] == pytest.approx(row["value"], rel=1e-9)
    assert (out / "sigmas.png").exists()
    run = tmp_path / "run"
    assert call("run", walk, "--config", out / "sigmas.toml", "--out", run, "--no-figures") == 0
    again = tomllib.loads((run / "config.toml").read_text())["parameters"]["field"]
    assert again == chosen["parameters"]["field"]
    assert metrics(run)["recordings"][0]["tuned_on"]


def test_a_made_walk_has_its_true_label_beside(straight, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sources, "made", lambda name: straight)  # for want of time
    out = tmp_path / "out"
    options = ("--detector", "qsf", "--keep", 0.8, "--no-figures")
    assert call("sigmas", "corridor:0", *options, "--out", out) == 0
    assert "by truth" in capsys.readouterr().out
    found = metrics(out)
    assert found["detector"] == "qsf"
    assert found["quasi_static_by_truth"] >= 20
    assert found["sigmas"]["sigma_strength"]["by_truth"] > 0
    chosen = tomllib.loads((out / "sigmas.toml").read_text())["parameters"]["field"]
    assert chosen["detector"] == "qsf"
    assert not (out / "sigmas.png").exists()


def test_refusals(walk, straight, tmp_path, capsys):
    short = tmp_path / "short.csv"
    write_csv(tools.crop(straight.recording, 20.0, "short"), short)

    def said(*args):
        return refused(capsys, "sigmas", *args, "--out", tmp_path)

    assert "detector 'vector' has no sigmas of changes; choose one of ma" in said(
        walk, "--detector", "vector"
    )
    assert "--keep 1 must lie between 0 and 1" in said(walk, "--keep", 1)
    assert "does not look at the field; choose another --system" in said(walk, "--system", "iez")
    assert "pedjax: short: " in (told := said(short))
    assert "sigmas need 20; record a longer or calmer walk" in told
