"""The command `roc`: curves with bands, areas, and thresholds that other commands take."""

import csv
import tomllib

import numpy as np
import pytest

from tests.cli.calling import call, metrics, refused


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_field_detectors(tmp_path, capsys):
    out = tmp_path / "roc"
    names = ("ma", "iqsf", "vector")
    options = ("--detection", 0.8, "--same-field", 6, "--same-heading", 10)
    assert call("roc", "corridor:0", "corridor:1", "--detectors", *names, *options, "--out", out) == 0
    told = capsys.readouterr().out
    assert "vector AUC 0." in told
    assert told.count("intervals and bands need at least 5 recordings") == 1
    found = metrics(out)
    assert found["kind"] == "field"
    assert found["system"] == "ma2018"
    assert found["same_field_uT"] == 6
    assert set(found["differences"]) == {"ma - iqsf", "ma - vector", "iqsf - vector"}
    for name in names:
        point = found["roc"][name]
        assert 0.8 <= point["p_detection"] <= 0.85
        assert 0.5 < point["auc"] < 1
        assert point["auc_interval"] == point["partial_auc_interval"] == [None, None]
        assert f"{name:6} AUC {point['auc']:.3f} [?]" in told
        assert {"all", "straight"} <= set(point["parts"])
        curve = rows(out / f"roc_{name}.csv")
        whole = [row for row in curve if row["part"] == "all"]
        assert float(whole[-1]["p_detection"]) == 1
        for row in whole:
            assert row["p_detection_low"] == row["p_detection_high"] == "nan"
        chosen = tomllib.loads((out / f"roc_{name}.toml").read_text())
        assert chosen["system"] == "ma2018"
        assert chosen["parameters"]["field"]["detector"] == name
        assert chosen["parameters"]["compass"]["update"] == "heading"
        assert len(chosen["tuned_on"]) == 2
    written = tomllib.loads((out / "roc_ma.toml").read_text())["parameters"]["field"]["ma"]["threshold"]
    assert written == pytest.approx(found["roc"]["ma"]["threshold"], rel=1e-9)
    areas = rows(out / "roc.csv")
    assert {row["detector"] for row in areas} == set(names)
    assert {row["auc_low"] for row in areas} == {"nan"}
    assert found["differences"]["ma - vector"]["auc"]["low"] is None
    assert (out / "roc.png").exists()
    run = tmp_path / "run"
    assert call("run", "corridor:1", "--config", out / "roc_vector.toml", "--out", run, "--no-figures") == 0
    assert metrics(run)["recordings"][0]["tuned_on"]


def test_stance_detectors_have_the_same_files(files, tmp_path, capsys):
    """With intervals and bands, for there are five walks."""
    out = tmp_path / "roc"
    assert call("roc", *files, "demo:4", "--detectors", "shoe", "eps", "--out", out) == 0
    assert "[?]" not in capsys.readouterr().out
    found = metrics(out)
    assert found["kind"] == "stance"
    apart = found["differences"]["shoe - eps"]["auc"]
    assert -1 <= apart["low"] <= apart["value"] <= apart["high"] <= 1
    assert (out / "roc.png").exists()
    for name in ("shoe", "eps"):
        point = found["roc"][name]
        assert point["p_false_alarm"] <= 0.05
        assert point["auc_interval"][0] <= point["auc"] <= point["auc_interval"][1]
        columns = ("p_detection_low", "p_detection", "p_detection_high")
        low, found_there, high = np.array([
            [float(row[x]) for x in columns] for row in rows(out / f"roc_{name}.csv")
        ]).T  # fmt: skip
        assert (low <= found_there).all()
        assert (found_there <= high).all()
    chosen = tomllib.loads((out / "roc_shoe.toml").read_text())
    assert chosen["parameters"]["stance"]["shoe"]["threshold"] == pytest.approx(
        found["roc"]["shoe"]["threshold"], rel=1e-6
    )
    assert call("parameters", "--config", out / "roc_eps.toml") == 0


def test_refusals(files, tmp_path, capsys):
    def said(*args):
        return refused(capsys, "roc", *args, "--out", tmp_path)

    assert "name a made walk, as office-loop:0" in said(files[0], "--kind", "field")
    assert "name those of one kind" in said("demo:0", "--detectors", "shoe", "ma")
    assert "detector 'ma' is unknown" in said("demo:0", "--kind", "stance", "--detectors", "ma")
    assert "--detection 1.5 must lie between 0 and 1" in said("demo:0", "--detection", 1.5)
    assert "--same-field 0 must be a positive change" in said("demo:0", "--same-field", 0)
    assert "does not look at the field; choose another --system" in said(
        "demo:0", "--kind", "field", "--system", "iez"
    )
