"""Many runs in threads: equal to single runs, stopped at once, and a journal that gives back what was kept and no more."""

import math
import os
import shutil
import signal
import sqlite3
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.errors import UserError
from cosim.fmu_files import UnpackedFmu
from cosim.metrics import evaluate
from cosim.pendulum_export import Kind, export_units
from cosim.prepared import Prepared
from cosim.results import Result, SimulationError
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from cosim.studies import engine
from cosim.studies import journal as journal_module
from cosim.studies.engine import Job, run_all, run_numbers
from cosim.studies.journal import Journal, code_files

SHORT = {"run.duration": 0.2, "plant.start.noise_std": 1e-4}
LONG = {"run.duration": 20_000.0, "record.every": 1000}
"""Half a minute on an idle machine."""
FAILING = {"controller.start.sample_time": 0.0015}
SOON = 5.0
"""Seconds; a tenth of one on an idle machine."""


@pytest.fixture
def job():
    """Make a job of the tilt scenario with changes, its key beside them."""

    def make(key, *changes, name="tilt", **more):
        scenario, folder = load_scenario(name)
        merged = SHORT | {k: v for change in changes for k, v in change.items()}
        return Job(key, scenario.changed(merged | {k.replace("__", "."): v for k, v in more.items()}), folder)

    return make


@pytest.fixture
def begun(monkeypatch):
    """The seeds of the runs that have begun; each run is the real one."""
    seeds = []

    def run(scenario, *rest):
        seeds.append(scenario.run.seed)
        return run_scenario(scenario, *rest)

    def run_prepared(prepared, changes, *rest):
        seeds.append(changes.get("run.seed", prepared.scenario.run.seed))
        return prepared_run(prepared, changes, *rest)

    prepared_run = Prepared.run
    monkeypatch.setattr(engine, "run_scenario", run)
    monkeypatch.setattr(Prepared, "run", run_prepared)
    return seeds


@pytest.fixture(scope="module")
def python_fmus(tmp_path_factory, design):
    folder = tmp_path_factory.mktemp("Python FMUs")
    export_units(design, output=folder, kind=Kind.python)
    return folder


def identity(result: Result) -> Result:
    return result


def measured(result: Result) -> dict[str, float]:
    return {name: float(value) for name, value in evaluate(result).as_dict().items()}


def bits(numbers):
    """Return numbers so that equality is to the last bit: NaN equals NaN, 0 is not -0."""
    return {name: "nan" if math.isnan(v) else struct.pack("<d", v) for name, v in numbers.items()}


# Running


@pytest.mark.parametrize("workers", [1, 2, None, 20])
def test_runs_in_threads_equal_single_runs(fmus, job, same, workers):
    jobs = [
        job((law, seed), run__seed=seed, controller__start__law=law) for law in ("LC", "SMC", "IHC") for seed in (1, 2)
    ]
    found = run_all(jobs, fmus, identity, workers)
    for one in jobs:
        same(found[one.key], run_scenario(one.scenario, fmus, one.folder))
    angles = {result["plant.theta"].tobytes() for result in found.values()}
    assert len(angles) == len(jobs)


def test_the_order_is_that_of_the_jobs_not_of_their_ends(fmus, job):
    ended = []
    jobs = [job("long", run__duration=200.0, record__every=1000), *(job(f"short {k}") for k in (3, 1, 2))]
    found = run_all(jobs, fmus, identity, 2, done=lambda one, _: ended.append(one.key))
    assert ended[-1] == "long"
    assert list(found) == ["long", "short 3", "short 1", "short 2"]
    assert found["long"].time[-1] == pytest.approx(200.0)


def test_progress_counts_and_what_is_done_comes_with_its_job_in_the_calling_thread(fmus, job):
    seen, finishing = [], set()

    def finish(result):
        finishing.add(threading.current_thread())
        return result.metadata["scenario"]["run"]["seed"]

    def done(one, value):
        seen.append((one.key, value, threading.current_thread()))

    def progress(*counts):
        seen.append((*counts, threading.current_thread()))

    here = threading.current_thread()
    assert run_all([job(k, run__seed=k) for k in range(4)], fmus, finish, 2, progress, done) == {k: k for k in range(4)}
    assert {thread for *_, thread in seen} == {here}
    assert here not in finishing
    assert [entry[:2] for entry in seen[1::2]] == [(k, 4) for k in (1, 2, 3, 4)]
    assert sorted(entry[:2] for entry in seen[::2]) == [(k, k) for k in range(4)]


def test_without_jobs_there_is_nothing(fmus):
    seen = []
    assert run_all([], fmus, identity, progress=lambda *counts: seen.append(counts)) == {}
    assert seen == []


def test_python_fmus_run_in_threads_as_alone_and_as_native_ones(python_fmus, fmus, job):
    jobs = [job(seed, run__seed=seed, run__duration=0.05) for seed in (1, 2, 3)]
    found = run_all(jobs, python_fmus, identity, 2)
    native = run_all(jobs, fmus, identity, 2)
    for one in jobs:
        alone = run_scenario(one.scenario, python_fmus, one.folder)
        for name in ("plant.theta", "plant.delta", "controller.voltage"):
            assert found[one.key][name].tobytes() == alone[name].tobytes()
            assert found[one.key][name] == pytest.approx(native[one.key][name], abs=1e-9)
    assert {found[1].metadata["engine"], native[1].metadata["engine"]} == {"fmpy", "native"}


def test_relative_paths_are_found_while_another_thread_loads_a_library(elsewhere, job, monkeypatch):
    """As it happens now and then by itself, but always: the second run looks for its FMUs while the first loads one."""
    loading, looked, load = threading.Event(), threading.Event(), UnpackedFmu.library

    def load_slowly(*arguments):
        if not loading.is_set():
            where = Path.cwd()
            os.chdir("/")
            loading.set()
            looked.wait(0.5)
            os.chdir(where)
        return load(*arguments)

    def run(scenario, *rest):
        if scenario.run.seed == 2:
            assert loading.wait(10.0)
        try:
            return run_scenario(scenario, *rest)
        finally:
            if scenario.run.seed == 2:
                looked.set()

    monkeypatch.chdir(elsewhere)
    monkeypatch.setattr(UnpackedFmu, "library", load_slowly)
    monkeypatch.setattr(engine, "run_scenario", run)
    found = run_all([job(seed, run__seed=seed) for seed in (1, 2)], Path("fmus"), lambda _: "fine", 2)
    assert found == {1: "fine", 2: "fine"}


# Failures


@pytest.mark.parametrize("workers", [1, 2])
def test_an_fmu_that_fails_ends_all_with_its_error_and_soon(fmus, job, begun, workers):
    jobs = [job(0, FAILING, run__seed=0), *(job(k, LONG, run__seed=k) for k in range(1, 20))]
    start = time.monotonic()
    with pytest.raises(SimulationError, match="sample_time must be a multiple of the communication step") as failure:
        run_all(jobs, fmus, identity, workers)
    assert time.monotonic() - start < SOON
    assert failure.value.instance == "controller"
    assert sorted(begun) == list(range(len(begun)))
    assert len(begun) <= workers + 1  # those at work, and one taken up before the failure is known


def test_the_failure_of_an_fmu_becomes_a_value_where_that_is_wanted(fmus, job):
    seen = []
    jobs = [job("bad", FAILING), job("good"), job("worse", controller__start__a_min=2.0)]
    found = run_all(jobs, fmus, lambda _: "fine", 2, lambda *c: seen.append(c), failed=str)
    assert (list(found), found["good"]) == (["bad", "good", "worse"], "fine")
    assert "sample_time must be a multiple" in found["bad"]
    assert "a_min must not exceed b_max" in found["worse"]
    assert seen == [(k, 3) for k in (1, 2, 3)]


def test_the_failure_of_a_python_fmu_becomes_a_value_too(python_fmus, job):
    found = run_all(
        [job("bad", FAILING), job("good", run__duration=0.01)], python_fmus, lambda _: "fine", 2, failed=str
    )
    assert found["good"] == "fine"
    assert "sample_time must be a multiple" in found["bad"]


@pytest.mark.parametrize(
    "changes", [{"controller.start.lwa": 1.0}, {"plant.fmu": "No.fmu"}, {"controller.design": "No.json"}], ids=str
)
def test_a_mistake_of_the_user_is_no_failure_of_an_fmu(fmus, job, changes):
    with pytest.raises(UserError, match=r"lwa|No\."):
        run_all([job(0, changes), job(1, LONG)], fmus, identity, 1, failed=lambda _: pytest.fail("a value"))


@pytest.mark.parametrize("where", ["finish", "done", "progress"])
def test_an_error_of_the_callers_functions_arrives_and_stops_the_runs(fmus, job, begun, where):
    def fail(*_):
        raise ZeroDivisionError(where)

    functions = {"finish": identity, "done": None, "progress": None, where: fail}
    jobs = [job(0, run__seed=0), *(job(k, LONG, run__seed=k) for k in range(1, 20))]
    start = time.monotonic()
    with pytest.raises(ZeroDivisionError, match=where):
        run_all(jobs, fmus, workers=2, **functions)
    assert time.monotonic() - start < SOON
    assert len(begun) <= 3


# Ctrl-C


@pytest.mark.parametrize("kind", ["native", "python"])
def test_an_interrupt_stops_what_runs_drops_what_waits_and_arrives(fmus, python_fmus, job, begun, kind):
    def interrupt(done, total):
        raise KeyboardInterrupt

    kept = []
    jobs = [job(0, run__seed=0), *(job(k, LONG, run__seed=k) for k in range(1, 20))]
    threads, start = threading.active_count(), time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_all(
            jobs,
            fmus if kind == "native" else python_fmus,
            identity,
            2,
            interrupt,
            done=lambda one, _: kept.append(one.key),
        )
    assert time.monotonic() - start < SOON
    assert kept == [0]
    assert len(begun) <= 3
    assert threading.active_count() == threads


def test_ctrl_c_while_all_threads_are_at_work_stops_them(fmus, job, begun):
    """The signal itself, to this process, as a terminal sends it."""
    sent = []

    def interrupt():
        while len(begun) < 2:
            time.sleep(0.01)
        time.sleep(0.2)
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    sender = threading.Thread(target=interrupt)
    sender.start()
    with pytest.raises(KeyboardInterrupt):
        run_all([job(k, LONG, run__seed=k) for k in range(20)], fmus, identity, 2)
    took = time.monotonic() - sent[0]
    sender.join()
    assert took < SOON
    assert sorted(begun) == [0, 1]


class CutShort(list):
    """Jobs among which Ctrl-C comes before the last."""

    def __iter__(self):
        for k, item in enumerate(super().__iter__()):
            if k == len(self) - 1:
                raise KeyboardInterrupt
            yield item


def test_ctrl_c_while_the_jobs_are_handed_out_stops_those_already_at_work(fmus, job):
    ended = []
    with pytest.raises(KeyboardInterrupt):
        run_all(CutShort(job(k, run__duration=100.0, record__every=1000) for k in range(5)), fmus, ended.append, 2)
    assert ended == []


def test_after_an_interrupt_the_same_runs_are_as_ever(fmus, job, same):
    def interrupt(done, total):
        raise KeyboardInterrupt

    before = run_scenario(job(0).scenario, fmus, job(0).folder)
    with pytest.raises(KeyboardInterrupt):
        run_all([job(0), job(1, LONG), job(2, LONG)], fmus, identity, 2, interrupt)
    same(run_all([job(0)], fmus, identity, 1)[0], before)


# The journal's file

digests = st.text("0123456789abcdef", min_size=32, max_size=32)
kept_numbers = st.dictionaries(st.text(), st.floats(allow_nan=True, allow_infinity=True))


@settings(max_examples=20, deadline=None)
@given(kept=st.dictionaries(digests, kept_numbers, max_size=8))
def test_numbers_come_back_to_the_last_bit(tmp_path_factory, kept):
    path = tmp_path_factory.getbasetemp() / "numbers" / "journal"
    path.unlink(missing_ok=True)
    with Journal(path, "test") as journal:
        for digest, numbers in kept.items():
            journal.keep([(digest, numbers)])
            assert bits(journal.found([digest])[digest]) == bits(numbers)
    with Journal(path, "test") as journal:
        assert {digest: bits(numbers) for digest, numbers in journal.known.items()} == {
            digest: bits(numbers) for digest, numbers in kept.items()
        }


def test_a_number_kept_again_replaces_the_first(tmp_path):
    for value in (1.0, 2.0):
        with Journal(tmp_path / "journal", "test") as journal:
            journal.keep([("a", {"x": value})])
    with Journal(tmp_path / "journal", "test") as journal:
        assert journal.known == {"a": {"x": 2.0}}


def test_a_journal_begins_with_its_first_numbers_in_a_new_folder_or_an_empty_file(tmp_path):
    (tmp_path / "empty").touch()
    for path in (tmp_path / "new folder" / "deep" / "journal", tmp_path / "empty"):
        with Journal(path, "test") as journal:
            assert (journal.known, journal.found(["a"])) == ({}, {})
            assert not path.parent.exists() or path == tmp_path / "empty"
            journal.keep([("a", {})])
        assert [file.name for file in path.parent.glob("*") if file.is_file()] == [path.name]


def test_what_is_kept_is_seen_by_others_at_once_and_outlives_a_killed_process(tmp_path):
    path = tmp_path / "journal"
    script = (
        "import os, pathlib, signal, sys; from cosim.studies.journal import Journal;"
        "Journal(pathlib.Path(sys.argv[1]), 'test').keep([('a', {'x': 1.5})]); os.kill(os.getpid(), 9)"
    )
    with Journal(path, "test") as journal:
        journal.keep([("b", {})])
        subprocess.run([sys.executable, "-c", script, str(path)], check=False)
        assert journal.found(["a"]) == {"a": {"x": 1.5}}
    with Journal(path, "test") as journal:
        assert journal.known == {"b": {}, "a": {"x": 1.5}}


def sqlite_of_another(path):
    with sqlite3.connect(path) as file:
        file.execute("CREATE TABLE notes (text TEXT)")
    file.close()


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (
            lambda path: path.write_bytes(b'qube-ihc journal 1\n["a", {"x": 1.0}]\n'),
            "is a journal of an earlier version",
        ),
        (lambda path: path.write_bytes(b"mu,u_max,a_min\n1,2,3\n"), "is not a journal of finished runs"),
        (lambda path: path.write_bytes(b"SQLite"), "is not a journal of finished runs"),
        (sqlite_of_another, "is not a journal of finished runs"),
        (lambda path: path.write_bytes(b"SQLite format 3\0" + b"\xff" * 1000), "is damaged or cannot be used"),
        (lambda path: path.mkdir(), "cannot be read"),
    ],
)
def test_another_file_is_refused_and_left_as_it_is(tmp_path, make, cause):
    path = tmp_path / "other"
    make(path)
    before = path.read_bytes() if path.is_file() else None
    with pytest.raises(UserError, match=cause) as refusal:
        Journal(path, "test")
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert (path.read_bytes() if path.is_file() else None) == before
    assert [file.name for file in tmp_path.iterdir()] == ["other"]


def test_a_changed_digit_is_refused(tmp_path):
    path = tmp_path / "journal"
    with Journal(path, "test") as journal:
        journal.keep([("a", {"x": 1.25})])
    content = path.read_bytes()
    assert content.count(b"1.25") == 1
    path.write_bytes(content.replace(b"1.25", b"1.75"))
    with Journal(path, "test") as journal, pytest.raises(UserError, match="numbers do not fit their checksum"):
        journal.found(["a"])


# What numbers are kept under


@pytest.fixture
def digest(tmp_path, fmus):
    """Return what a journal keeps a job's numbers under."""

    def of(one, folder=fmus, purpose="test"):
        with Journal(tmp_path / "digests.jsonl", purpose) as journal:
            return journal.digests(folder)(one)

    return of


CHANGES = {
    "run.step": 5e-4,
    "run.duration": 0.3,
    "run.order": "parallel",
    "run.engine": "fmpy",
    "run.seed": 2,
    "plant.parameters": "hcs",
    "plant.measurement": "ideal",
    "plant.start.delta_0": math.nextafter(0.1, 1.0),
    "controller.start.a_min": 0.7,
    "disturbance.input": "plant.disturbance_voltage",
    "disturbance.start": 0.1,
    "disturbance.sines": [{"amplitude": 1.0, "frequency": 2.0}],
    "record.every": 2,
    "record.outputs": ["plant.theta"],
}


def test_every_changed_entry_gives_another_digest_and_the_same_the_same(digest, job):
    one = job("key")
    found = {"": digest(one)} | {name: digest(job("key", {name: value})) for name, value in CHANGES.items()}
    assert len(set(found.values())) == len(found)
    again = [digest(job("another key")), digest(Job(0, one.scenario.changed({}), one.folder))]
    assert again == [found[""]] * 2
    assert all(len(value) == 32 and set(value) <= set("0123456789abcdef") for value in found.values())


def test_another_purpose_or_other_code_gives_another_digest(digest, job, monkeypatch, tmp_path):
    before = digest(job(0))
    assert before == digest(job(0), purpose="test") != digest(job(0), purpose="test 2")
    names = {"/".join(file.parts[-2:]) for file in code_files()}
    assert names >= {
        "cosim/metrics.py",
        "paper/study.py",
        "native/loop.c",
        "plant_fmu/parameters.py",
        "ihc_fmu/kalman.py",
    }
    copies = [tmp_path / str(k) for k, _ in enumerate(code_files())]
    for copy, file in zip(copies, code_files(), strict=True):
        shutil.copy(file, copy)
    monkeypatch.setattr(journal_module, "code_files", lambda: copies)
    found = []
    for _ in range(2):
        journal_module.code_digest.cache_clear()
        found.append(digest(job(0)))
        copies[-1].write_bytes(copies[-1].read_bytes() + b"\n")
    journal_module.code_digest.cache_clear()
    assert found[0] == before != found[1]


@pytest.mark.parametrize("unit", ["plant", "controller"])
def test_fmus_count_with_their_start_values_not_with_their_place(digest, job, design, tmp_path, unit):
    name = {"plant": "delta_0", "controller": "a_min"}[unit]
    export_units(design, output=tmp_path / "same")
    export_units(design, output=tmp_path / "other", changes={unit: {name: 0.5}})
    assert digest(job(0)) == digest(job(0), tmp_path / "same") != digest(job(0), tmp_path / "other")


def test_fmus_of_another_kind_count_as_others(digest, job, python_fmus):
    assert digest(job(0)) != digest(job(0), python_fmus)


def test_a_design_counts_with_its_content_not_with_its_place(digest, job, design, tmp_path):
    for folder, found in (("a", design), ("b", design), ("c", design.scaled_to(u_max=3.0))):
        found.save(tmp_path / folder / "mine.json")
    scenario = job(0).scenario.changed({"controller.design": "mine.json"})
    a, b, c = (digest(Job(0, scenario, tmp_path / folder)) for folder in "abc")
    assert a == b != c
    design.scaled_to(u_max=2.0).save(tmp_path / "a" / "mine.json")
    assert digest(Job(0, scenario, tmp_path / "a")) not in (a, c, digest(job(0)))


def test_an_fmu_that_does_not_exist_is_named(digest, job, tmp_path):
    with pytest.raises(UserError, match=r"FMU .*nowhere.* does not exist"):
        digest(job(0), tmp_path / "nowhere")


def test_a_design_that_does_not_exist_is_named_as_by_a_run(digest, job, tmp_path):
    with pytest.raises(UserError, match=r"design file .*No\.json does not exist"):
        digest(Job(0, job(0).scenario.changed({"controller.design": "No.json"}), tmp_path))


# Runs with a journal


class Evaluations(list):
    """The metrics as numbers; remembers the results' first angles."""

    def __call__(self, result):
        self.append(float(result["plant.delta"][0]))
        return measured(result)


def test_a_second_call_runs_nothing_and_gives_the_same_numbers(fmus, job, tmp_path, begun):
    jobs = [job(("draw", seed), run__seed=seed) for seed in range(4)]
    seen, found, evaluations = [], [], Evaluations()
    for _ in range(2):
        with Journal(tmp_path / "journal", "test") as journal:
            found.append(run_numbers(jobs, fmus, journal, evaluations, 2, lambda *c: seen.append(c)))
    assert sorted(begun) == [0, 1, 2, 3]
    assert len(evaluations) == 4
    assert seen == [(k, 4) for k in range(5)] + [(4, 4)]
    assert list(found[0]) == list(found[1]) == [one.key for one in jobs]
    for one in jobs:
        alone = measured(run_scenario(one.scenario, fmus, one.folder))
        assert bits(found[0][one.key]) == bits(found[1][one.key]) == bits(alone)
        assert math.isnan(alone["settling_time"])


def test_only_what_is_new_is_run(fmus, job, tmp_path, begun):
    seen = []
    with Journal(tmp_path / "journal", "test") as journal:
        run_numbers([job(seed, run__seed=seed) for seed in (1, 2)], fmus, journal, measured, 1)
        jobs = [job(seed, run__seed=seed) for seed in (3, 2, 1, 4)]
        found = run_numbers(jobs, fmus, journal, measured, 1, lambda *counts: seen.append(counts))
    assert begun == [1, 2, 3, 4]
    assert list(found) == [3, 2, 1, 4]
    assert seen == [(2, 4), (3, 4), (4, 4)]


def test_interrupted_half_way_and_repeated_is_as_never_interrupted(fmus, job, tmp_path):
    jobs = [job(seed, run__seed=seed) for seed in range(8)]
    evaluations = Evaluations()

    def interrupt(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with Journal(tmp_path / "cut", "test") as journal, pytest.raises(KeyboardInterrupt):
        run_numbers(jobs, fmus, journal, Evaluations(), 2, interrupt)
    with Journal(tmp_path / "cut", "test") as journal:
        kept = len(journal.known)
        assert 3 <= kept <= 8  # what was under way has ended and is kept too
        found = run_numbers(jobs, fmus, journal, evaluations, 2)
    assert len(evaluations) == 8 - kept
    with Journal(tmp_path / "whole", "test") as journal:
        whole = run_numbers(jobs, fmus, journal, measured, 1)
    assert {seed: bits(numbers) for seed, numbers in found.items()} == {s: bits(n) for s, n in whole.items()}


def test_processes_share_the_work_of_one_journal(fmus, job, tmp_path, begun):
    """The second leaves what the first has begun to the end, and then takes what the first has done meanwhile."""
    jobs = [job(seed, run__seed=seed) for seed in range(4)]
    with Journal(tmp_path / "journal", "test") as first, Journal(tmp_path / "journal", "test") as second:
        keys = list(map(first.digests(fmus), jobs))
        assert first.claim(keys[:1]) == set(keys[:1])
        assert second.claim(keys[:1]) == set()
        assert first.claim(keys[:2]) == set(keys[:2])
        seen = []

        def progress(done, total):
            seen.append(done)
            if done == 2:  # the first has ended one of its runs, and is killed in the other
                first.keep([(keys[0], {"kept": 1.0})])

        found = run_numbers(jobs, fmus, second, measured, 1, progress)
    assert begun == [2, 3, 1]
    assert seen == [0, 1, 2, 3, 4]
    assert (list(found), found[0]) == ([0, 1, 2, 3], {"kept": 1.0})


def test_a_run_that_an_fmu_ends_has_no_numbers_and_is_not_tried_again(fmus, job, tmp_path, begun):
    jobs = [job("bad", FAILING, run__seed=1), job("good", run__seed=2)]
    found = []
    for _ in range(2):
        with Journal(tmp_path / "journal", "test") as journal:
            found.append(run_numbers(jobs, fmus, journal, measured, 2))
    assert sorted(begun) == [1, 2]
    assert [numbers["bad"] for numbers in found] == [{}, {}]
    assert bits(found[0]["good"]) == bits(found[1]["good"])


def test_a_mistake_of_the_user_is_not_kept(fmus, job, tmp_path):
    jobs = [job(1, run__seed=1), job(0, controller__start__lwa=1.0)]
    with Journal(tmp_path / "journal", "test") as journal:
        with pytest.raises(UserError, match="lwa"):
            run_numbers(jobs, fmus, journal, measured, 1)
        assert len(journal.known) == 1


def test_python_fmus_have_numbers_of_their_own(fmus, python_fmus, job, tmp_path):
    evaluations = Evaluations()
    with Journal(tmp_path / "journal", "test") as journal:
        for folder in (fmus, python_fmus, fmus, python_fmus):
            run_numbers([job(0, run__duration=0.01)], folder, journal, evaluations, 1)
    assert len(evaluations) == 2


def test_jobs_that_come_to_the_same_run_are_run_once(fmus, job, tmp_path, begun):
    one = job(0, run__seed=1)
    jobs = [one, Job(1, one.scenario, one.folder), Job(2, one.scenario, one.folder, {"controller.start.a_min": 0.5})]
    with Journal(tmp_path / "journal", "test") as journal:
        found = run_numbers(jobs, fmus, journal, measured, 2)
    assert len(begun) == 2
    assert bits(found[0]) == bits(found[1]) != bits(found[2])
