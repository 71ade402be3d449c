"""A system of another kind, registered from outside, through all that the kit does."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pedjax
from pedjax import parameters, plots
from pedjax.cli import main
from pedjax.errors import InputError
from pedjax.readers.writing import write_csv
from pedjax.simulation.footsteps import Leg
from pedjax.simulation.scenarios import Scenario
from pedjax.tuning import TuneSettings
from tests.toy import pocket

NAMES = ("gravity.sigma", "field.sigma", "gyroscope")


@pytest.fixture(scope="module")
def made():
    """Two short walks with a sensor in the pocket and one at the waist, called belt."""
    scenario = Scenario(
        name="toy",
        rate_hz=100.0,
        standing_s=2.0,
        legs=(Leg(points=((0.0, 0.0), (8.0, 0.0), (8.0, 6.0)), radius=1.0),),
        sensors={"pocket": "xsens_mtw", "waist": "xsens_mtw"},
    )
    return [_renamed(pedjax.simulate(scenario, seed)) for seed in (1, 2)]


def _renamed(world):
    return world.recording.renamed({"waist": "belt"}), world


@pytest.fixture(scope="module")
def site(made):
    return pocket.Site(jnp.asarray(np.asarray(made[0][1].field.background, float)))


@pytest.fixture(scope="module")
def tracks(made, site):
    return [
        pedjax.run(walk, "toy_pocket", sensor={"waist": "belt"}, site=site, params=_started())
        for walk, _ in made
    ]


def _started():
    """Loose gates: both sensors bounce while walking."""
    return parameters.replace(pocket.PocketParameters(), {"gravity.threshold": 4.0, "field.threshold": 25.0})


def test_run_follows_the_heading_and_counts_steps(made, tracks):
    for track, (walk, world) in zip(tracks, made, strict=True):
        assert track.healthy
        assert track.sensor == "pocket"
        assert list(track.gates) == ["field", "gravity", "step"]
        assert set(track.sigma) == {"attitude", "gyroscope_bias"}
        assert "stance" not in track.gates
        assert not any("stance" in note or "foot" in note for note in track.warnings), track.warnings
        score = pedjax.evaluate(track, walk)
        assert score.heading_rms_deg < 6.0
        steps = track.gates["step"].weight.sum()
        assert steps == pytest.approx(len(world.steps), abs=0.25 * len(world.steps))


def test_heading_is_tuned_by_gradient(made, site):
    walks = [walk for walk, _ in made]
    poor = parameters.replace(_started(), {"field.sigma": 300.0, "gyroscope": 0.3})
    settings = TuneSettings(
        names=NAMES, loss="heading_rms", iterations=4, starts=1, grid=0, check_every=1, validation=0.0
    )
    tuned = pedjax.tune(
        walks[:1], settings, "toy_pocket", poor, held_back=walks[1:], sensor={"waist": "belt"}, site=site
    )
    assert tuned.loss == "heading_rms"
    assert tuned.after["tuned_on"]["toy:1"] < 0.9 * tuned.before["tuned_on"]["toy:1"]
    track = pedjax.run(walks[0], "toy_pocket", tuned.params, sensor={"waist": "belt"}, site=site)
    assert tuned.after["tuned_on"]["toy:1"] == pytest.approx(
        pedjax.evaluate(track, walks[0]).heading_rms_deg, rel=0.05
    )  # of points at 10 Hz, and of every sample


def test_sweep_by_heading_has_all_scores_and_gates(made, site):
    walks = [walk for walk, _ in made]
    values = {"field.sigma": np.array([1.0, 100.0]), "step_length": np.array([0.7, 0.5])}
    found = pedjax.sweep(
        walks, values, "toy_pocket", _started(), loss="heading_rms", sensor={"waist": "belt"}, site=site
    )
    assert set(found.gates) == {"field", "gravity", "step"}
    assert found.scores["heading_rms_deg"].shape == (2, 2)
    assert np.isfinite(found.scores["armse_m"]).all()
    assert found.healthy.all()
    for r, walk in enumerate(walks):
        p = parameters.replace(_started(), {path: float(v[0]) for path, v in values.items()})
        track = pedjax.run(walk, "toy_pocket", p, sensor={"waist": "belt"}, site=site)
        assert found.gates["step"][0, r] == pytest.approx(track.gates["step"].weight.mean(), abs=1e-12)


def test_pictures(made, tracks):
    plots.trajectory(tracks[0], made[0][0])
    plots.gate_over_signals(tracks[0], made[0][0], "field")


def test_command_line(made, site, tmp_path, capsys):
    table = tmp_path / "walk.csv"
    write_csv(made[0][0], table)
    place = tmp_path / "place.toml"
    place.write_text(f"field = {np.asarray(site.field).tolist()}\n")
    plugin = str(pocket.__file__)
    common = [
        str(table), "--with", plugin, "--system", "toy_pocket", "--sensor", "waist=belt", "--map", str(place),
    ]  # fmt: skip
    out = tmp_path / "out"
    assert main(["run", *common, "--out", str(out)]) == 0, capsys.readouterr().err
    entry = json.loads((out / "metrics.json").read_text())["recordings"][0]
    assert entry["healthy"]
    assert {"field_fraction", "gravity_fraction", "step_fraction"} <= set(entry)
    assert entry["landmarks"]["heading_rms_deg"] < 10
    assert list(out.glob("*_field.png"))
    again = tmp_path / "again"
    assert main(["run", "--config", str(out / "config.toml"), "--out", str(again), "--no-figures"]) == 0
    assert main(["run", str(table), "--with", plugin, "--system", "toy_pocket", "--out", str(out)]) == 1
    assert "'waist'" in capsys.readouterr().err
    sets = ["--set", "tune.loss=heading_rms", "--set", "tune.iterations=1", "--set", "tune.starts=1"]
    tuned = tmp_path / "tuned"
    names = ["--names", "field.sigma", "--set", "tune.grid=0"]
    assert main(["tune", *common, *sets, *names, "--out", str(tuned), "--no-figures"]) == 0
    assert "deg" in capsys.readouterr().out


def test_refusals(made, site):
    walk, _ = made[0]
    with pytest.raises(InputError, match="roles are pocket, waist"):
        pedjax.run(walk, "toy_pocket", sensor={"foot": "belt"}, site=site)
    bare = replace(
        walk, sensors={**walk.sensors, "pocket": replace(walk.sensors["pocket"], magnetometer=None)}
    )
    with pytest.raises(InputError, match="needs a magnetometer"):
        pedjax.run(bare, "toy_pocket", sensor={"waist": "belt"}, site=site)


def test_a_run_that_leaves_the_numbers_says_why(made, site):
    broken = parameters.with_leaves(_started(), {"gyroscope": jnp.nan})
    track = pedjax.run(made[0][0], "toy_pocket", broken, sensor={"waist": "belt"}, site=site)
    assert not track.healthy
    assert "left the numbers" in track.warnings[0]


def test_gradient_of_the_heading_is_that_of_differences(made, site):
    from pedjax.ensemble import Problem, losses, walks_for
    from pedjax.packing import pack_all
    from pedjax.tuning.loop import gated

    params = parameters.cast(gated(_started(), 0.3), float)
    walks = walks_for(pocket.POCKET, params, [made[0][0]], {"waist": "belt"}, None, "heading_rms")
    batches = pack_all(pocket.POCKET, params, walks, float, site)
    problem = Problem(pocket.POCKET, "heading_rms", "none")

    def loss(x):
        return losses(problem, params, {"field.sigma": jnp.exp(x)[None]}, batches)[0, 0]

    at, h = 0.3, 1e-4
    slope = float(jax.grad(loss)(at))
    assert slope == pytest.approx(float(loss(at + h) - loss(at - h)) / (2 * h), rel=1e-4)
