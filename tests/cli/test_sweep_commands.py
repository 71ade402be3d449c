"""`sweep` and `sweep-report`: a table, the best parameters, a report; stopped, resumed, refused."""

import csv
import shutil
import tomllib
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from pedjax import parameters
from pedjax.config import Config, load, presets, sweep_axes
from pedjax.readers import write_csv
from pedjax.recording import Stream
from pedjax.sweeping.store import read_store
from tests import tools
from tests.cli.calling import call, metrics, refused

BARE = ("--no-figures", "--no-gradient")
THRESHOLD = "stance.shoe.threshold"


def said_by(*args):
    with redirect_stdout(StringIO()) as out:
        assert call(*args) == 0
    return out.getvalue()


@pytest.fixture(scope="module")
def default(tmp_path_factory):
    """The shortest sweep there is, with all that comes of it; `said` is what it said."""
    out = tmp_path_factory.mktemp("default") / "out"
    return out, said_by("sweep", "demo:0", "--set", "sweep.count=16", "--out", out)


def test_the_default_is_what_tuning_would_vary(default):
    out, _ = default
    store, columns = read_store(out)
    _, axes = sweep_axes(Config())
    assert [a["path"] for a in store.manifest["axes"]] == [a.path for a in axes]
    assert len(axes) >= 5
    assert columns["run"].tolist() == list(range(16))
    for axis in axes:
        centre = float(parameters.get(tools.iez(), axis.path))
        assert axis.low >= centre / 10.001
        assert columns[axis.path].min() < centre < columns[axis.path].max()


def test_metrics_say_which_is_best(default):
    out, said = default
    _, columns = read_store(out)
    whole = metrics(out)
    row = int(np.argmin(columns["armse_m"]))
    assert whole["best_run"] == row
    assert whole["best_mean_m"] == columns["armse_m"][row]
    assert whole["best"] == {path: columns[path][row] for path in whole["best"]}
    assert (whole["runs"], whole["recordings"], whole["diverged"]) == (16, ["demo:0"], 0)
    assert f"run {row}" in said
    assert "slopes at the best set" in said


def test_the_report_is_written(default):
    report = default[0] / "report"
    for name in ("best", "effects", "interactions", "marginals", "pairs", "optimum", "recordings", "slopes"):
        with (report / f"{name}.csv").open() as file:
            assert list(csv.DictReader(file)), name
    for name in ("marginals", "pairs", "effects", "pareto"):
        assert (report / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_run_takes_the_best_parameters(default, tmp_path):
    out, _ = default
    args = ("--config", out / "best.toml", "--no-figures", "--out", tmp_path)
    assert call("run", "demo:0", *args, "--alignment", "yaw_translation") == 0
    (entry,) = metrics(tmp_path)["recordings"]
    assert entry["tuned_on"]
    assert entry["landmarks"]["armse_m"] == pytest.approx(metrics(out)["best_mean_m"], rel=1e-6)


def test_again_it_goes_on_where_it_stopped(default):
    out, _ = default
    before = {p: p.stat().st_mtime_ns for p in (out / "table").iterdir()}
    for args in (("demo:0", "--set", "sweep.count=16"), ("--config", out / "config.toml")):
        said = said_by("sweep", *args, *BARE, "--out", out)
        assert said.startswith("16 of 16 runs are there already\n")
    assert {p: p.stat().st_mtime_ns for p in (out / "table").iterdir()} == before


def test_the_report_again(default, tmp_path):
    """By another score, somewhere else."""
    shutil.copytree(default[0], tmp_path / "copy")
    shutil.rmtree(tmp_path / "copy" / "report")
    score = ("--score", "max_2d_m", "--against", "armse_m")
    said = said_by("sweep-report", tmp_path / "copy", *BARE, *score)
    _, columns = read_store(tmp_path / "copy")
    assert metrics(tmp_path / "copy")["best_run"] == int(np.argmin(columns["max_2d_m"]))
    assert "max_2d_m against armse_m" in said
    assert (tmp_path / "copy" / "report" / "best.csv").exists()
    assert not list((tmp_path / "copy" / "report").glob("*.png"))


def test_another_sweep_into_the_same_folder_is_refused(default, capsys):
    out, _ = default
    for change in (("--seed", 1), ("--set", "sweep.loss=rms_2d"), ("--set", "gate.width=0.1")):
        error = refused(capsys, "sweep", "demo:0", "--set", "sweep.count=16", *BARE, "--out", out, *change)
        assert "holds another sweep" in error


def test_it_does_not_go_on_where_a_recording_has_changed(tmp_path, demos, monkeypatch, capsys):
    """A walk of the same name whose field is another."""
    foot = demos[0].sensors["foot"]
    time = foot.gyroscope.time

    def write(field):
        sensor = replace(foot, magnetometer=Stream(time, np.tile(field, (len(time), 1))))
        write_csv(replace(demos[0], sensors={"foot": sensor}), tmp_path / "walk.csv")

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    args = ("sweep", tmp_path / "walk.csv", "--set", "sweep.count=16", *BARE, "--out", tmp_path / "out")
    monkeypatch.setattr("pedjax.cli.sweeps.run_campaign", interrupt)
    write([20.0, 0.0, -43.0])
    assert call(*args) == 130
    assert call(*args) == 130
    write([0.0, 20.0, -43.0])
    error = refused(capsys, *args)
    assert "recordings, namely" in error
    assert "foot.magnetometer); choose another --out" in error


@pytest.fixture(scope="module")
def chosen(tmp_path_factory, files):
    """Ranges, values, settings and rounds from the command line, two recordings."""
    out = tmp_path_factory.mktemp("chosen")
    options = (
        f"sweep.ranges.{THRESHOLD}=[1e6, 1e9]",
        "sweep.ranges.updates.zero_velocity={low = 0.01, high = 0.1, scale = 'linear', steps = 3}",
        "sweep.values.gravity=[9.80, 9.81]",
        'sweep.settings.stance.rule=["causal", "any"]',
        "sweep.count=12", "sweep.design=grid", "sweep.refine=1", "sweep.loss=rms_3d",
    )  # fmt: skip
    args = [x for option in options for x in ("--set", option)]
    return out, said_by("sweep", files[2], files[0], *args, *BARE, "--out", out)


def test_ranges_values_and_settings_by_option(chosen):
    _, columns = read_store(chosen[0])
    first = columns["round"] == 0
    assert columns["run"][first].max() == 23
    assert set(columns["stance.rule"]) == {"causal", "any"}
    assert set(columns["gravity"]) == {9.80, 9.81}
    np.testing.assert_allclose(np.unique(columns["updates.zero_velocity"][first]), [0.01, 0.055, 0.1])
    np.testing.assert_allclose(np.unique(columns[THRESHOLD][first]), [1e6, 1e9])
    assert len(set(columns["recording"])) == 2


def test_rounds_by_option(chosen):
    """Around the best of the first, with its setting."""
    _, columns = read_store(chosen[0])
    first = columns["round"] == 0
    mean = np.bincount(columns["run"][first], columns["rms_3d_m"][first])
    best = 2 * int(np.argmin(mean))
    assert set(columns["stance.rule"][~first]) == {columns["stance.rule"][best]}
    assert columns[THRESHOLD][~first].min() > 1.1e6 or columns[THRESHOLD][~first].max() < 0.9e9


def test_best_parameters_hold_the_best_setting(chosen):
    best = tomllib.loads((chosen[0] / "best.toml").read_text())["parameters"]
    assert best["stance"]["rule"] == metrics(chosen[0])["best"]["stance.rule"]
    assert best["stance"]["shoe"]["threshold"] == metrics(chosen[0])["best"][THRESHOLD]


def test_sets_from_a_file_beside_the_config(files, tmp_path):
    (tmp_path / "sets.csv").write_text(f"run,{THRESHOLD},rms_2d_m\n7,1e7,0.1\n8,2e8,0.2\n")
    (tmp_path / "own.toml").write_text('[sweep]\nfile = "sets.csv"\n')
    out = tmp_path / "out"
    assert call("sweep", files[2], "--config", tmp_path / "own.toml", *BARE, "--out", out) == 0
    assert read_store(out)[1][THRESHOLD].tolist() == [1e7, 2e8]
    said = said_by("sweep", "--config", out / "config.toml", *BARE, "--out", out)
    assert "2 of 2 runs are there already" in said


def test_no_slopes_without_the_recordings(demos, tmp_path):
    """The report goes without what it cannot read any more."""
    walk, out = tmp_path / "walk.csv", tmp_path / "out"
    write_csv(demos[2], walk)
    assert call("sweep", walk, "--set", "sweep.count=4", *BARE, "--out", out) == 0
    write_csv(demos[0], walk)
    assert "no slopes at the best set: the recordings have changed" in said_by("sweep-report", out, BARE[0])
    walk.unlink()
    assert "no slopes at the best set: " in said_by("sweep-report", out, BARE[0])


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--set", "sweep.ranges.stance.shoe.treshold=[1e6,1e7]"), "did you mean 'stance.shoe.threshold'"),
        (("--set", "sweep.ranges.gravity=[9, 9.8]"), "gravity = 9 m/s^2 is outside its bounds"),
        (("--set", "sweep.ranges.gravity=9.8"), "must be [low, high]"),
        (("--set", "sweep.ranges=[1, 2]"), "sweep.ranges must be a table"),
        (("--set", "sweep.values.gate.kind=['fixed']"), "'gate.kind' is a setting"),
        (("--set", "sweep.settings.stance.rule='any'"), "must list choices"),
        (("--set", "sweep.settings.stance.rule=['any', 'any']"), "each once"),
        (("--set", "sweep.settings.stance.rule=['anny']"), "did you mean 'any'"),
        (("--set", "sweep.settings.gravity=[9.8]"), "'gravity' is a number; sweep it in sweep.values"),
        (("--set", "sweep.desing=grid"), "did you mean 'design'"),
        (("--set", "sweep.design=gird"), "did you mean 'grid'"),
        (("--set", "sweep.loss=rms2d"), "did you mean 'rms_2d'"),
        (("--set", "sweep.count=0"), "sweep.count = 0 must lie between 1 and"),
        (("--set", "sweep.count=2.5"), "must be of the kind of 1024"),
        (("--set", "sweep.shrink=2"), "sweep.shrink = 2.0 must lie between 0.001 and 1"),
        (("--set", "sweep.file=nowhere.csv"), "nowhere.csv: cannot be read"),
        (("--set", "sweep.file=a.csv", "--set", "sweep.refine=1"), "leave ranges, values and refine out"),
        (("--devices", -2), "devices = -2 must be at least 1"),
        (("--distributed",), "name --coordinator, --processes and --process-id"),
        (("--coordinator", "127.0.0.1:1"), "name --coordinator, --processes and --process-id"),
        (("--loss", "x"), None),
        (("--precision", "float16"), None),
    ],
)
def test_wrong_sweeps(files, tmp_path, capsys, args, message):
    place = tmp_path / "out"
    if message is None:
        with pytest.raises(SystemExit, match="2"):
            call("sweep", files[2], "--out", place, *args)
        return
    assert message in refused(capsys, "sweep", files[2], "--out", place, *args)
    assert not (place / "manifest.json").exists()


def test_no_devices_at_all_are_refused(tmp_path, capsys):
    args = ("--devices", 0, "--set", "sweep.count=0", "--out", tmp_path)
    assert "devices = 0" in refused(capsys, "sweep", "demo:0", *args)


@pytest.mark.parametrize(
    "options",
    [
        ("sweep.count=4", "sweep.count.x=3"),
        ("sweep.ranges=[1, 2]", "sweep.ranges.gravity=[9.8, 9.81]"),
        ("sweep.settings.stance.rule=[['any']]",),
    ],
)
def test_options_of_the_wrong_shape_are_refused(tmp_path, capsys, options):
    args = [x for option in options for x in ("--set", option)]
    refused(capsys, "sweep", "demo:0", "--out", tmp_path, *args)


def test_what_is_no_sweep_has_no_report(tmp_path, capsys):
    assert "is not a sweep" in refused(capsys, "sweep-report", tmp_path)
    assert "is not a sweep" in refused(capsys, "sweep-report", tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()


def test_unknown_scores_have_no_report(default, capsys):
    for option in ("--score", "--against"):
        error = refused(capsys, "sweep-report", default[0], *BARE, option, "armse")
        assert "did you mean 'armse_m'" in error


def test_presets_can_be_swept():
    """Every config that comes with the package names something to sweep."""
    assert presets()
    for name in presets():
        assert sweep_axes(load(name))[1]
