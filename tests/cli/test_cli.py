"""The command line in process: files written, fields, exit statuses, and every refusal in one sentence."""

import csv
import json
import tomllib
from dataclasses import replace

import pytest

import pedjax
from pedjax.cli.main import main
from pedjax.errors import InputError
from pedjax.readers import write_csv
from pedjax.sources import spelled_out
from tests.cli.calling import call, metrics, refused

SCORE = {
    "count", "alignment", "rms_2d_m", "rms_3d_m", "mean_2d_m", "max_2d_m", "final_2d_m",
    "percent_of_distance", "armse_m",
}  # fmt: skip


def test_run_writes_what_it_says(files, tmp_path, capsys):
    out = tmp_path / "out"
    assert call("run", *files[:2], "--out", out, "--seed", 5) == 0
    whole = metrics(out)
    assert whole["pedjax_version"] == pedjax.__version__
    assert whole["system"] == "iez"
    assert whole["seed"] == 5
    assert [entry["path"] for entry in whole["recordings"]] == files[:2]
    for entry in whole["recordings"]:
        assert {"path", "distance_m", "duration_s", "healthy", "landmarks"} <= set(entry)
        assert set(entry["landmarks"]) >= SCORE
        assert entry["healthy"] is True
        assert entry["landmarks"]["rms_2d_m"] < 1.0
    printed = capsys.readouterr().out
    assert f"results in {out}" in printed
    assert "RMS" in printed
    for entry, stem in zip(whole["recordings"], ("demo_0", "demo_1"), strict=True):
        with (out / f"{stem}_track.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert float(rows[-1]["time_s"]) == pytest.approx(entry["duration_s"], abs=1e-6)
        assert {"position_x_m", "velocity_z_m_per_s", "yaw_rad", "stance", "sigma_horizontal_m"} <= set(
            rows[0]
        )
        for picture in ("trajectory", "stance"):
            assert (out / f"{stem}_{picture}.png").read_bytes().startswith(b"\x89PNG")
    config = tomllib.loads((out / "config.toml").read_text())
    assert config["parameters"]["stance"]["shoe"]["threshold"] == 8.5e7


def test_run_equals_the_library(files, tmp_path):
    out = tmp_path / "out"
    assert call("run", files[0], "--out", out, "--no-figures", "--alignment", "yaw") == 0
    recording = pedjax.read(files[0])
    track = pedjax.run(recording)
    (entry,) = metrics(out)["recordings"]
    assert entry["landmarks"]["rms_2d_m"] == pytest.approx(pedjax.evaluate(track, recording, "yaw").rms_2d_m)
    assert entry["distance_m"] == pytest.approx(track.distance)
    assert not list(out.glob("*.png"))


def test_its_own_config_repeats_a_run(files, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    changed = ("--set", "stance.detector=ared", "--set", "gate.width=0.2", "--no-figures")
    assert call("run", files[0], "--out", first, *changed) == 0
    assert call("run", "--config", first / "config.toml", "--out", second, "--no-figures") == 0
    assert metrics(first)["recordings"][0]["landmarks"] == metrics(second)["recordings"][0]["landmarks"]


def test_two_files_of_one_name_do_not_overwrite_each_other(demos, tmp_path):
    paths = []
    for folder, recording in zip("ab", demos[:2], strict=True):
        (tmp_path / folder).mkdir()
        paths.append(tmp_path / folder / "walk.csv")
        write_csv(replace(recording, name="walk"), paths[-1])
    out = tmp_path / "out"
    assert call("run", *paths, "--out", out, "--no-figures") == 0
    assert len(metrics(out)["recordings"]) == 2
    assert len(list(out.glob("*_track.csv"))) == 2


def test_demo_by_name_and_info(tmp_path, capsys):
    out = tmp_path / "info"
    assert call("info", "demo:3", "--out", out) == 0
    assert "sensor 'foot'" in capsys.readouterr().out
    (entry,) = json.loads((out / "info.json").read_text())["recordings"]
    assert entry["sensors"] == {"foot": {"rate_hz": pytest.approx(200.0)}}
    assert list(out.glob("*.png"))


def test_several_made_walks_are_named_at_once():
    assert spelled_out(["a.csv", "demo:9..11", "office-loop"]) == [
        "a.csv", "demo:9", "demo:10", "demo:11", "office-loop",
    ]  # fmt: skip
    for wrong in ("demo:3..1", "demo:..2", "demo:1..x"):
        with pytest.raises(InputError, match=r"as in demo:1\.\.8"):
            spelled_out([wrong])


def test_parameters_are_listed(capsys):
    assert call("parameters", "--set", "gate.width=0.125") == 0
    printed = capsys.readouterr().out
    assert "gate.width" in printed
    assert "0.125" in printed


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('sytem = "iez"', "key 'sytem' is unknown; did you mean 'system'"),
        ('system = "iezz"', "system 'iezz' is unknown; did you mean 'iez'"),
        ("[parameters.stance.shoe]\ntreshold = 1.0", "did you mean 'stance.shoe.threshold'"),
        ("[parameters.updates]\nzero_velocity = 100.0", "is outside its bounds, 1e-05 to 10"),
        ("[tune]\niteratons = 3", "'tune.iteratons' is unknown; did you mean 'iterations'"),
        ("[tune]\niterations = 'many'", "must be of the kind of"),
        ("[sweep]\ndesign = 'spiral'", "'spiral'"),
        ("seed = 'x'", "must be a int"),
        ("split = 1.5", "must lie between 0 and 1"),
        ("= 3", "is not valid TOML"),
    ],
)
def test_wrong_configs(files, tmp_path, capsys, text, message):
    config = tmp_path / "wrong.toml"
    config.write_text(text)
    error = refused(capsys, "run", files[0], "--config", config, "--out", tmp_path)
    assert message in error
    assert "wrong.toml" in error or "system 'iezz'" in error
    assert not (tmp_path / "metrics.json").exists()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--set", "updates.zero_velocity=100"), "outside its bounds"),
        (("--set", "updates.zero_velocity"), "write path=value"),
        (("--set", "stance.rule=anny"), "did you mean 'any'"),
        (("--sensor", "hip"), "no sensor 'hip'"),
        (("--alignment", "yow"), "alignment 'yow' is unknown; did you mean 'yaw'"),
        (("--config", "nowhere.toml"), "no such config file"),
    ],
)
def test_wrong_options(files, tmp_path, capsys, args, message):
    assert message in refused(capsys, "run", files[0], "--out", tmp_path, "--no-figures", *args)


@pytest.mark.parametrize("name", ["nowhere.csv", "demo:x"])
def test_files_that_are_not_there(tmp_path, capsys, name):
    refused(capsys, "run", name, "--out", tmp_path)


def test_output_that_cannot_be_written(files, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert "choose another --out" in refused(capsys, "run", files[0], "--out", tmp_path / "file" / "out")


@pytest.mark.parametrize(
    "args", [[], ["walk"], ["run", "--nonsense"], ["run"], ["run", "demo", "--clock", "sun"]]
)
def test_wrong_usage_is_status_two(args, capsys):
    with pytest.raises(SystemExit) as ended:
        main(args)
    assert ended.value.code == 2
    assert "usage: pedjax" in capsys.readouterr().err


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.strip() == f"pedjax {pedjax.__version__}"


def test_roc(files, tmp_path):
    out = tmp_path / "roc"
    assert call("roc", "demo:0", "--detectors", "shoe", "ared", "--out", out) == 0
    found = metrics(out)["roc"]
    assert set(found) == {"shoe", "ared"}
    assert all(0.8 < curve["auc"] <= 1 for curve in found.values())
    assert (out / "roc.png").exists()
    assert (out / "roc_shoe.csv").exists()


def test_roc_refusals(files, tmp_path, capsys):
    assert "did you mean 'shoe'" in refused(capsys, "roc", "demo:0", "--detectors", "sheo", "--out", tmp_path)
    assert "between 0 and 1" in refused(capsys, "roc", "demo:0", "--false-alarm", 2, "--out", tmp_path)


@pytest.mark.parametrize("arrangement", ["option", "copy"])
def test_held_back_that_was_tuned_on_is_refused(files, demos, tmp_path, capsys, arrangement):
    held = files[1]
    if arrangement == "copy":
        held = tmp_path / "renamed.csv"
        write_csv(demos[1], held)
    error = refused(capsys, "tune", *files[:2], "--held-back", held, "--out", tmp_path / "out")
    assert "was tuned on" in error
    assert not (tmp_path / "out" / "metrics.json").exists()


@pytest.mark.slow
def test_tune_and_run_with_what_it_found(files, tmp_path, capsys):
    out = tmp_path / "tune"
    few = ("tune.iterations=4", "tune.starts=2", "tune.check_every=2", "tune.grid=3", "tune.mode='forward'")
    options = [x for setting in few for x in ("--set", setting)]
    bad = ("--set", "stance.shoe.threshold=2e6", "--set", "updates.zero_velocity=0.2")
    names = ("--names", "stance.shoe.threshold", "updates.zero_velocity")
    args = (files[0], files[1], files[3], "--held-back", files[2], "--out", out)
    assert call("tune", *args, *options, *bad, *names) == 0
    whole = metrics(out)
    for part, count in (("tuned_on", 3), ("held_back", 1)):
        for when in ("before", "after"):
            assert whole[when][part]["count"] == count
            assert whole[when][part]["mean_m"] > 0
    assert whole["after"]["tuned_on"]["mean_m"] < whole["before"]["tuned_on"]["mean_m"]
    assert [entry["part"] for entry in whole["recordings"]] == ["tuned_on"] * 3 + ["held_back"]
    assert set(whole["tuned"]) == {"stance.shoe.threshold", "updates.zero_velocity"}
    assert (out / "history.csv").exists()
    assert (out / "tuning.png").exists()

    again = tmp_path / "again"
    assert call("run", *files, "--config", out / "tuned.toml", "--out", again, "--no-figures") == 0
    entries = metrics(again)["recordings"]
    assert [entry.get("tuned_on", False) for entry in entries] == [True, True, False, True]
    for entry, part in zip(entries, ("tuned_on", "tuned_on", "held_back", "tuned_on"), strict=True):
        name = pedjax.read(entry["path"]).name
        expected = whole["after"][part]["each_m"][name]
        assert entry["landmarks"]["armse_m"] == pytest.approx(expected, rel=1e-6)

    held = ("--config", out / "tuned.toml", "--held-back", files[0], "--out", tmp_path / "no")
    capsys.readouterr()
    assert "was tuned on" in refused(capsys, "tune", files[2], *held, *options, *names)


def test_split_and_held_back_do_not_mix_sides(files, tmp_path, capsys):
    error = refused(capsys, "tune", files[0], files[0], "--split", 0.5, "--out", tmp_path / "out")
    assert "two different recordings" in error
