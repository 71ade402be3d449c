"""Long sweeps: one table whatever happens in between, that anybody can read."""

import contextlib
import errno
import io
import os
import pickle
import signal
import time
from dataclasses import replace

import duckdb
import numpy as np
import pandas
import polars
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import pedjax
from pedjax.errors import InputError
from pedjax.evaluation.scores import told_with
from pedjax.recording import Stream
from pedjax.sweeping import engine
from pedjax.sweeping import store as keep
from pedjax.sweeping.campaign import Rounds, manifest_of, run_campaign
from pedjax.sweeping.designs import axes_of, lay_out, with_settings
from tests import tools
from tests.sweeping.processes import finish, start

IN_A_PART = 6
COUNT = 20
RANGES = {"stance.shoe.threshold": [1e6, 1e9], "updates.zero_velocity": [0.003, 0.1]}


@pytest.fixture(scope="module", autouse=True)
def small_parts(recordings):
    samples = sum(len(r.sensors["foot"].gyroscope.time) for r in recordings)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "_STEPS_IN_A_PART", IN_A_PART * samples)
        yield


@pytest.fixture(scope="module")
def recordings(demos):
    return [demos[2], demos[0]]


@pytest.fixture(scope="module")
def work(recordings):
    return engine.job(recordings)


def designed(count=COUNT, seed=0, settings=None, lost=()):
    axes = axes_of(tools.iez(), RANGES)
    values = lay_out(axes, count, "sobol", seed)
    values["updates.zero_velocity"][list(lost)] = 1e200
    return with_settings(axes, values, settings or {})


@pytest.fixture(scope="module")
def design():
    """Four parts, the last of them short; two runs diverge."""
    return designed(lost=(3, 11))


def campaign(path, work, recordings, design, rounds=Rounds(), progress=None):  # noqa: B008
    store = keep.open_store(path, manifest_of(work, recordings, design, rounds, {}))
    run_campaign(work, recordings, design, rounds, store, progress=progress)
    return store


def interrupt_after(calls):
    """A progress that presses Ctrl-C at its call of that number."""
    seen = []

    def progress(done, total):
        seen.append(done)
        if len(seen) > calls:
            raise KeyboardInterrupt

    return progress


def files(store):
    """Everything but what says who wrote last."""
    return {
        str(path.relative_to(store.path)): path.read_bytes() for path in sorted(store.path.rglob("*.parquet"))
    }


def assert_same(store, other):
    assert list(files(store)) == list(files(other))
    assert files(store) == files(other)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, work, recordings, design):
    return campaign(tmp_path_factory.mktemp("whole"), work, recordings, design)


def table_of(store):
    return pa.concat_tables([pq.read_table(p) for p in sorted(store.table.iterdir())]).unify_dictionaries()


def test_one_row_for_each_run_and_recording_in_order(whole, work, design):
    assert sorted(p.name for p in whole.table.iterdir()) == [f"part-{n:06d}.parquet" for n in range(4)]
    table = table_of(whole)
    assert table["run"].to_pylist() == [n for n in range(COUNT) for _ in range(2)]
    assert table["recording"].to_pylist() == list(work.names) * COUNT
    assert set(table["round"].to_pylist()) == {0}
    assert len(set(table["fingerprint"].to_pylist())) == 2
    for path, values in design.values.items():
        np.testing.assert_array_equal(table[path].to_numpy(), np.repeat(values, 2))


def test_each_column_has_its_type(whole):
    schema = pq.read_schema(keep.part_path(whole, 0))
    words, number = pa.dictionary(pa.int32(), pa.string()), pa.float64()
    wanted = {"run": pa.int64(), "round": pa.int32(), "recording": words, "fingerprint": words}
    wanted |= {"healthy": pa.bool_(), "status": pa.int32()}
    wanted |= {"stance_fraction": number, "straight_fraction": number}
    wanted |= dict.fromkeys((*RANGES, *(kind.column for kind in told_with("armse"))), number)
    assert dict(zip(schema.names, schema.types, strict=True)) == wanted
    for n in range(1, 4):
        assert pq.read_schema(keep.part_path(whole, n)) == schema


def test_the_table_holds_the_scores_of_a_sweep(whole, recordings, design):
    found = pedjax.sweep(recordings, design.values)
    table = table_of(whole)
    for name, scores in found.scores.items():
        np.testing.assert_array_equal(table[name].to_numpy(), scores.ravel())
    np.testing.assert_array_equal(table["stance_fraction"].to_numpy(), found.gates["stance"].ravel())
    np.testing.assert_array_equal(table["status"].to_numpy(), found.status.ravel())


def test_what_diverged_has_no_score(whole):
    """Null, not NaN, so that no database averages over it."""
    table = table_of(whole)
    lost = np.repeat(np.isin(np.arange(COUNT), (3, 11)), 2)
    np.testing.assert_array_equal(table["healthy"].to_numpy(zero_copy_only=False), ~lost)
    for name in (kind.column for kind in told_with("armse")):
        np.testing.assert_array_equal(table[name].is_null().to_numpy(), lost)


def test_anybody_can_read_the_table(whole):
    own = keep.read_store(whole.path)[1]
    total, rows = np.nansum(own["armse_m"]), len(own["run"])
    parts = f"{whole.table}/*.parquet"
    frame = pandas.read_parquet(whole.table)
    assert frame["armse_m"].sum() == pytest.approx(total, rel=1e-12)
    assert len(frame) == rows
    assert set(frame["recording"]) == {"demo:2", "demo:0"}
    by_polars = polars.read_parquet(parts)
    assert by_polars["armse_m"].sum() == pytest.approx(total, rel=1e-12)
    query = f"select sum(armse_m), count(*), count(armse_m), count(distinct recording) from '{parts}'"
    found, count, scored, names = duckdb.sql(query).fetchall()[0]
    assert found == pytest.approx(total, rel=1e-12)
    assert (count, scored, names) == (rows, rows - 4, 2)


def test_the_store_reads_back_what_was_swept(whole, design):
    again = keep.read_design(whole, 0)
    assert again.axes == design.axes
    for path, values in design.values.items():
        np.testing.assert_array_equal(again.values[path], values)
    store, columns = keep.read_store(whole.path)
    assert store.identity == whole.identity
    assert columns["healthy"].dtype == bool
    assert columns["recording"][:2].tolist() == ["demo:2", "demo:0"]


def test_settings_are_columns(tmp_path, work, recordings):
    """Parts do not cross a change of settings, and every row names its own."""
    settings = {"stance.rule": ["causal", "any"], "gate.straight_through": [False]}
    found = designed(8, settings=settings)
    store = campaign(tmp_path, work, recordings, found)
    assert [pq.read_metadata(p).num_rows for p in sorted(store.table.iterdir())] == [12, 4, 12, 4]
    _, columns = keep.read_store(tmp_path)
    assert columns["stance.rule"].tolist() == ["causal"] * 16 + ["any"] * 16
    assert not columns["gate.straight_through"].any()
    assert keep.read_design(store, 0).settings == found.settings
    alone = pedjax.sweep(recordings, {p: v[:8] for p, v in found.values.items()}, settings=settings)
    np.testing.assert_array_equal(columns["armse_m"], alone.loss.ravel())


@pytest.mark.parametrize("calls", [0, 1, 3])
def test_interrupted_and_resumed_is_the_same_table(tmp_path, work, recordings, design, whole, calls):
    with pytest.raises(KeyboardInterrupt):
        campaign(tmp_path, work, recordings, design, progress=interrupt_after(calls))
    parts = sorted((tmp_path / "table").iterdir())
    assert len(parts) == calls
    before = {p: (p.stat().st_ino, p.stat().st_mtime_ns) for p in parts}
    seen = []
    store = campaign(tmp_path, work, recordings, design, progress=lambda *call: seen.append(call))
    assert_same(store, whole)
    assert {p: (p.stat().st_ino, p.stat().st_mtime_ns) for p in parts} == before
    assert seen[0] == (calls * IN_A_PART, COUNT)
    assert seen[-1] == (COUNT, COUNT)


def test_a_finished_sweep_computes_nothing(tmp_path, work, recordings, design, whole, monkeypatch):
    campaign(tmp_path, work, recordings, design)
    monkeypatch.setattr("pedjax.sweeping.campaign.Engine", None)
    assert_same(campaign(tmp_path, work, recordings, design), whole)


@pytest.mark.parametrize("keep_bytes", [0, 100, 0.5])
def test_a_truncated_part_is_computed_again(tmp_path, work, recordings, design, whole, keep_bytes):
    part = keep.part_path(campaign(tmp_path, work, recordings, design), 2)
    content = part.read_bytes()
    cut = int(keep_bytes * len(content)) if keep_bytes < 1 else keep_bytes
    part.write_bytes(content[:cut])
    assert_same(campaign(tmp_path, work, recordings, design), whole)


def test_a_part_without_all_its_rows_is_computed_again(tmp_path, work, recordings, design, whole):
    part = keep.part_path(campaign(tmp_path, work, recordings, design), 1)
    pq.write_table(pq.read_table(part).slice(0, 5), part)
    assert_same(campaign(tmp_path, work, recordings, design), whole)


def test_a_part_that_was_deleted_is_computed_again(tmp_path, work, recordings, design, whole):
    keep.part_path(campaign(tmp_path, work, recordings, design), 1).unlink()
    assert_same(campaign(tmp_path, work, recordings, design), whole)


FOREIGN = {
    "design": lambda w, r, d: manifest_of(w, r, designed(seed=1), Rounds(), {}),
    "loss": lambda w, r, d: manifest_of(
        replace(w, problem=w.problem._replace(loss="rms_2d")), r, d, Rounds(), {}
    ),
    "parameters": lambda w, r, d: manifest_of(replace(w, params=tools.iez(gravity=9.81)), r, d, Rounds(), {}),
    "precision": lambda w, r, d: manifest_of(replace(w, dtype=np.dtype("float32")), r, d, Rounds(), {}),
    "recordings": lambda w, r, d: manifest_of(w, r[::-1], d, Rounds(), {}),
    "rounds": lambda w, r, d: manifest_of(w, r, d, Rounds(refine=1, count=4), {}),
    "sensors": lambda w, r, d: manifest_of(replace(w, sensors={"foot": "foot_left"}), r, d, Rounds(), {}),
    "site": lambda w, r, d: manifest_of(replace(w, site={"map": np.ones(3)}), r, d, Rounds(), {}),
    "axis": lambda w, r, d: manifest_of(w, r, d, Rounds(), {"axis": "of the command"}),
}  # fmt: skip


@pytest.mark.parametrize("what", FOREIGN)
def test_a_folder_of_another_sweep_is_refused(tmp_path, work, recordings, design, what):
    keep.open_store(tmp_path, manifest_of(work, recordings, design, Rounds(), {}))
    with pytest.raises(
        InputError, match=rf"holds another sweep \(different: .*\b{what}\b.*\); choose another"
    ):
        keep.open_store(tmp_path, FOREIGN[what](work, recordings, design))


@pytest.mark.parametrize("what", ["landmarks", "time"])
def test_another_truth_or_clock_is_another_sweep(work, recordings, design, what):
    first = recordings[0]
    if what == "landmarks":
        marks = replace(first.landmarks, position=first.landmarks.position + np.array([1.0, 0, 0]))
        changed = replace(first, landmarks=marks)
    else:
        foot = first.sensors["foot"]
        slower = {
            name: replace(stream, time=1.1 * stream.time)
            for name in ("accelerometer", "gyroscope")
            for stream in [getattr(foot, name)]
        }
        changed = replace(first, sensors={"foot": replace(foot, **slower)}, landmarks=None)
    one, two = (manifest_of(engine.job([r]), [r], design, Rounds(), {}) for r in (first, changed))
    assert keep.identity_of(one) != keep.identity_of(two)


def field_turned(recording, degrees):
    """The recording with a steady field in body axes, turned about z by that angle."""
    foot, angle = recording.sensors["foot"], np.radians(degrees)
    time = foot.gyroscope.time
    field = np.tile([20 * np.cos(angle), 20 * np.sin(angle), -43.0], (len(time), 1))
    return replace(recording, sensors={"foot": replace(foot, magnetometer=Stream(time, field))})


def test_a_sweep_does_not_go_on_with_another_field(tmp_path, recordings, design):
    first, second = ([field_turned(recordings[0], angle), recordings[1]] for angle in (0.0, 90.0))
    one, two = (manifest_of(engine.job(r), r, design, Rounds(), {}) for r in (first, second))
    keep.open_store(tmp_path, one)
    with pytest.raises(
        InputError, match=r"\(different: recordings, namely [^;]* foot\.magnetometer\); choose another --out"
    ):
        keep.open_store(tmp_path, two)


def test_what_is_no_sweep_is_refused(tmp_path, whole):
    with pytest.raises(InputError, match="is not a sweep"):
        keep.read_store(tmp_path)
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(InputError, match=r"manifest\.json: cannot be read"):
        keep.read_store(tmp_path)
    (tmp_path / "manifest.json").write_text('{"format": 99}')
    with pytest.raises(InputError, match="is not of a sweep that this version can read"):
        keep.read_store(tmp_path)
    (tmp_path / "manifest.json").write_bytes((whole.path / "manifest.json").read_bytes())
    with pytest.raises(InputError, match="has no finished part yet"):
        keep.read_store(tmp_path)


def test_parts_without_a_manifest_are_refused(tmp_path, work, recordings, design):
    (tmp_path / "table").mkdir()
    (tmp_path / "table" / "part-000000.parquet").write_bytes(b"")
    with pytest.raises(InputError, match="no manifest"):
        keep.open_store(tmp_path, manifest_of(work, recordings, design, Rounds(), {}))


def test_two_at_once_are_refused(tmp_path):
    with (
        keep.locked(tmp_path),
        pytest.raises(InputError, match="another sweep is writing"),
        keep.locked(tmp_path),
    ):
        pass
    with keep.locked(tmp_path):
        pass


def test_leftovers_are_cleared_away(tmp_path, work, recordings, design, whole):
    store = campaign(tmp_path, work, recordings, design)
    (tmp_path / ".claims-old").mkdir()
    (tmp_path / ".claims-old" / "3").touch()
    for left in (tmp_path / ".manifest.json.x.tmp", store.table / ".part-000001.parquet.x.tmp"):
        left.write_bytes(b"half")
    campaign(tmp_path, work, recordings, design)
    assert not [p.name for p in tmp_path.rglob(".*") if p.name != ".lock"]
    assert_same(store, whole)


class Full(io.BufferedWriter):
    def write(self, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def full_disk(monkeypatch, where, good):
    """No space left after so many files that went well, on writing or on what writing put off."""
    real, made = {"fdopen": os.fdopen, "fsync": os.fsync}[where], []

    def call(handle, *args, **kwargs):
        made.append(handle)
        if len(made) <= good:
            return real(handle, *args, **kwargs)
        if where == "fdopen":
            return Full(io.FileIO(handle, "wb"))
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(f"pedjax.output.os.{where}", call)


@pytest.mark.parametrize("where", ["fdopen", "fsync"])
def test_a_full_disk_is_said_and_loses_nothing(tmp_path, work, recordings, design, whole, monkeypatch, where):
    with monkeypatch.context() as patch:
        full_disk(patch, where, good=4)  # manifest, design, two parts
        with pytest.raises(
            InputError, match=r"part-000002.parquet: cannot be written \(No space left on device\)"
        ):
            campaign(tmp_path, work, recordings, design)
    assert [p.name for p in sorted((tmp_path / "table").iterdir())] == [
        "part-000000.parquet",
        "part-000001.parquet",
    ]
    assert len(keep.read_store(tmp_path)[1]["run"]) == 4 * IN_A_PART
    assert_same(campaign(tmp_path, work, recordings, design), whole)


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, work, recordings, design):
    place = tmp_path / "closed"
    place.mkdir(mode=0o500)
    if os.access(place, os.W_OK):
        pytest.skip("this user may write anywhere")
    with pytest.raises(InputError, match="cannot write there"):
        campaign(place, work, recordings, design)


# rounds

ROUNDS = Rounds(refine=2, shrink=0.4, count=8, kind="sobol", seed=5)


@pytest.fixture(scope="module")
def refined(tmp_path_factory, work, recordings, design):
    return campaign(tmp_path_factory.mktemp("refined"), work, recordings, design, ROUNDS)


def test_rounds_follow_the_first(refined, whole):
    """The first round is the sweep without them."""
    columns, first = keep.read_store(refined.path)[1], keep.read_store(whole.path)[1]
    assert columns["run"].tolist() == [n for n in range(COUNT + 16) for _ in range(2)]
    assert columns["round"].tolist() == [0] * 2 * COUNT + [1] * 16 + [2] * 16
    np.testing.assert_array_equal(columns["armse_m"][: 2 * COUNT], first["armse_m"])


def test_rounds_close_in_on_the_best_so_far(refined):
    _, columns = keep.read_store(refined.path)
    mean = np.bincount(columns["run"], columns["armse_m"]) / 2
    first = keep.read_design(refined, 0)
    last, best = 0, []
    for number in (1, 2):
        last += [COUNT, 8][number - 1]
        best.append(int(np.nanargmin(mean[:last])))
        found = keep.read_design(refined, number)
        for axis, whole in zip(found.axes, first.axes, strict=True):
            centre = columns[axis.path][2 * best[-1]]
            assert axis == whole.zoomed(centre, 0.4**number)
            inside = columns[axis.path][(columns["round"] == number)]
            assert axis.low <= inside.min() <= inside.max() <= axis.high
    assert mean[best[1]] <= mean[best[0]]
    assert np.nanmin(mean) < mean[best[0]]  # these rounds found something better


@pytest.mark.parametrize("calls", [3, 5, 9])
def test_rounds_resume_to_the_same_table(tmp_path, work, recordings, design, refined, calls):
    with pytest.raises(KeyboardInterrupt):
        campaign(tmp_path, work, recordings, design, ROUNDS, interrupt_after(calls))
    assert len(list((tmp_path / "table").iterdir())) < 8
    assert_same(campaign(tmp_path, work, recordings, design, ROUNDS), refined)


def test_rounds_keep_the_best_settings(tmp_path, work, recordings):
    found = designed(4, settings={"stance.rule": ["causal", "any"]})
    store = campaign(tmp_path, work, recordings, found, replace(ROUNDS, refine=1, count=3))
    _, columns = keep.read_store(tmp_path)
    mean = np.bincount(columns["run"], columns["armse_m"])[: found.count]
    assert set(keep.read_design(store, 1).settings["stance.rule"]) == {
        columns["stance.rule"][2 * int(np.argmin(mean))]
    }


def test_progress_ends_where_it_said(tmp_path, work, recordings):
    axes = axes_of(tools.iez(), RANGES)
    first = with_settings(axes, lay_out(axes, 5, "grid"), {})
    seen = []
    rounds = Rounds(refine=1, count=5, kind="grid")
    campaign(tmp_path, work, recordings, first, rounds, progress=lambda *call: seen.append(call))
    assert seen[-1][0] == seen[-1][1]


# killed

CAMPAIGNS = """
import os, pickle, sys
import jax, pedjax
from pedjax.sweeping import engine
from pedjax.sweeping.campaign import Rounds, manifest_of, run_campaign
from pedjax.sweeping.store import open_store
recordings, design, steps, cache = pickle.load(open(sys.argv[1], "rb"))

def campaign(place):
    pedjax.configure(precision="float64", devices=1, cache=cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    engine._STEPS_IN_A_PART = steps
    work = engine.job(recordings)
    store = open_store(place, manifest_of(work, recordings, design, Rounds(), {}))
    run_campaign(work, recordings, design, Rounds(), store)

for line in sys.stdin:
    child = os.fork()  # before JAX has started: the child starts its own
    if not child:
        campaign(line.strip())
        os._exit(0)
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
"""A campaign into each folder that it is told, each in a process of its own that need not import anything."""

KILLS = 20


def parts_in(place):
    return {p.name: p for p in (place / "table").glob("part-*")}


def wait_for_parts(place, count, seconds):
    until = time.monotonic() + seconds
    while len(parts_in(place)) < count and time.monotonic() < until:
        time.sleep(0.002)


@pytest.mark.slow
def test_killed_at_any_moment_and_resumed_is_the_same_table(tmp_path, recordings):
    """Killed early, late, between two parts and in the middle of one; every part there is whole."""
    found = designed(192)
    with (tmp_path / "input").open("wb") as file:
        pickle.dump((recordings, found, engine._STEPS_IN_A_PART // 3, tmp_path / "cache"), file)
    process = start(CAMPAIGNS, tmp_path / "input")

    def begin(place):
        process.stdin.write(f"{place}\n")
        process.stdin.flush()
        return int(process.stdout.readline())

    begin(tmp_path / "whole")
    assert process.stdout.readline() == "0\n"
    wanted = {name: part.read_bytes() for name, part in parts_in(tmp_path / "whole").items()}
    assert len(wanted) == 96
    place, rng, ended = tmp_path / "killed", np.random.default_rng(), []
    for kill in range(KILLS):
        child = begin(place)
        if kill % 4 == 0:
            time.sleep(rng.uniform(0.0, 0.8))
        else:
            wait_for_parts(place, min(len(parts_in(place)) + rng.integers(1, 5), len(wanted)), 60)
            time.sleep(rng.uniform(0.0, 0.02))
        with contextlib.suppress(ProcessLookupError):  # it was faster
            os.kill(child, signal.SIGKILL)
        ended.append(int(process.stdout.readline()))
        for name, part in parts_in(place).items():
            assert part.read_bytes() == wanted[name]
    assert ended.count(-signal.SIGKILL) > KILLS // 2
    begin(place)
    assert process.stdout.readline() == "0\n"
    assert {name: part.read_bytes() for name, part in parts_in(place).items()} == wanted
    assert (place / "design-0.parquet").read_bytes() == (tmp_path / "whole" / "design-0.parquet").read_bytes()
    assert not list(place.rglob("*.tmp"))
    finish(process)
