"""Processes that share a sweep: every part once, one table."""

import itertools
import os
import re
import shutil
import signal
import socket

import pytest

from pedjax.readers import write_csv
from pedjax.sweeping import team
from pedjax.sweeping.store import read_store
from tests.sweeping.processes import finish, start

COMMAND = """
import sys, time
from pedjax.sweeping import engine, store
engine._STEPS_IN_A_PART = 8_000
write = store.write_part

def told(into, number, columns):
    write(into, number, columns)
    print("part", number, flush=True)
    time.sleep(0.05)

store.write_part = told
from pedjax.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
"""The command line, with small parts that it tells of."""

SMALL = ("--devices", 1, "--no-gradient", "--no-figures", "--precision", "float64")


@pytest.fixture(scope="module")
def walk_file(demos, tmp_path_factory):
    path = tmp_path_factory.mktemp("walk") / "walk.csv"
    write_csv(demos[2], path)
    return path


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


def parts_told(out):
    return [int(n) for n in re.findall(r"^part (\d+)$", out, re.MULTILINE)]


def test_every_part_falls_to_one(tmp_path):
    mates = [team.shared_out(team.Team(i, 3, "job"), tmp_path, range(10)) for i in range(3)]
    taken = [[], [], []]
    for turn in (0, 1, 1, 2, 0, 0, 0, 2, 1, 2):
        taken[turn].append(next(mates[turn]))
    assert sorted(itertools.chain(*taken)) == list(range(10))
    assert not [part for mate in mates for part in mate]
    team.disband(team.Team(1, 3, "job"), tmp_path)
    assert list(tmp_path.iterdir())
    team.disband(team.Team(0, 3, "job"), tmp_path)
    assert not list(tmp_path.iterdir())


def test_another_job_claims_anew(tmp_path):
    for token in ("one", "two"):
        assert list(team.shared_out(team.Team(0, 2, token), tmp_path, [4, 7])) == [4, 7]


def test_alone_nothing_is_claimed(tmp_path):
    assert team.assemble() == team.Team()
    assert list(team.shared_out(team.Team(), tmp_path, range(3))) == [0, 1, 2]
    assert not list(tmp_path.iterdir())


def options(walk_file):
    return ("sweep", walk_file, "--set", "sweep.count=120", "--set", "sweep.refine=1", *SMALL)


def table(out):
    return {p.name: p.read_bytes() for p in (out / "table").iterdir()}


@pytest.fixture(scope="module")
def alone(walk_file, cache, tmp_path_factory):
    """What one process makes of it: sixty parts."""
    out = tmp_path_factory.mktemp("alone")
    said, _ = finish(start(COMMAND, *options(walk_file), "--out", out, PEDJAX_CACHE=cache))
    assert parts_told(said) == list(range(60))
    return out


def together(walk_file, cache, out):
    """The parts that each of two processes computes."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    job = ("--coordinator", f"127.0.0.1:{port}", "--processes", 2, "--out", out)
    pair = [start(COMMAND, *options(walk_file), *job, "--process-id", i, PEDJAX_CACHE=cache) for i in (0, 1)]
    return [parts_told(finish(process)[0]) for process in pair]


@pytest.mark.slow
def test_two_processes_make_the_table_of_one(walk_file, cache, alone, tmp_path):
    shares = together(walk_file, cache, tmp_path)
    assert min(map(len, shares)) > 5
    assert sorted(itertools.chain(*shares)) == list(range(60))
    assert table(tmp_path) == table(alone)
    assert (tmp_path / "best.toml").read_bytes() == (alone / "best.toml").read_bytes()
    assert not list(tmp_path.glob(".claims-*"))


@pytest.mark.slow
def test_two_processes_go_on_where_one_stopped(walk_file, cache, alone, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(alone, out)
    for n in range(7, 60, 3):
        (out / "table" / f"part-{n:06d}.parquet").unlink()
    shares = together(walk_file, cache, out)
    assert set(itertools.chain(*shares)) == set(range(7, 60, 3))
    assert table(out) == table(alone)


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done(walk_file, cache, tmp_path):
    out = tmp_path / "out"
    args = ("sweep", walk_file, "--set", "sweep.count=400", *SMALL, "--out", out)
    process = start(COMMAND, *args, PEDJAX_CACHE=cache)
    while "part 4" not in process.stdout.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    said, _ = finish(process, status=130)
    assert f"interrupted; what is done is kept in {out}" in said
    parts = len(os.listdir(out / "table"))
    assert 5 <= parts < 100
    assert len(read_store(out)[1]["run"]) == 4 * parts
    again, _ = finish(start(COMMAND, *args, PEDJAX_CACHE=cache))
    assert f"{4 * parts} of 400 runs are there already" in again
    assert parts_told(again) == list(range(parts, 100))
    assert read_store(out)[1]["run"].tolist() == list(range(400))
