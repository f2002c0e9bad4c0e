"""Runs on a Dask cluster: a real scheduler and worker processes on this machine."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from cosim.errors import UserError
from cosim.scenario import load_scenario
from cosim.studies.cluster import Cluster
from cosim.studies.draws import draw_changes
from cosim.studies.engine import Job, judge_all, run_numbers
from cosim.studies.journal import Journal
from cosim.studies.numbers import numbers

pytest.importorskip("distributed")

DRAWS = 24


class Processes:
    """A scheduler and its workers."""

    def __init__(self, folder):
        self.folder = folder
        self.file = folder / "scheduler.json"
        self.started = []
        self.scheduler = self.start("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(self.file))
        wait(self.file.is_file)
        self.address = f"tcp://{self._address()}"

    def _address(self):
        import json

        wait(lambda: self.file.read_text().strip().endswith("}"))
        return json.loads(self.file.read_text())["address"].removeprefix("tcp://")

    def worker(self, **environment):
        options = ["--nthreads", "1", "--no-dashboard", "--no-nanny", "--local-directory", str(self.folder)]
        return self.start("worker", self.address, *options, **environment)

    def start(self, kind, *options, **environment):
        command = [sys.executable, "-m", "distributed.cli.dask_" + kind, *options]
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self.folder,
            env={**os.environ, "TMPDIR": str(self.folder), **environment},
        )
        self.started.append(process)
        return process

    def close(self):
        for process in reversed(self.started):
            process.kill()
            process.wait()


def wait(condition, seconds=40.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@contextmanager
def processes(folder):
    started = Processes(folder)
    try:
        yield started
    finally:
        started.close()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler with two workers, in a folder that has nothing else."""
    with processes(tmp_path_factory.mktemp("cluster")) as started:
        for _ in range(2):
            started.worker()
        connected = Cluster(started.address)
        connected.client.wait_for_workers(2, timeout=60)
        yield connected
        connected.close()


@pytest.fixture
def jobs(design, tmp_path):
    scenario, folder = load_scenario("tilt")
    design.scaled_to(u_max=2.0).save(tmp_path / "scenario" / "mine.json")
    scenario = scenario.changed({"run.duration": 0.3, "run.seed": None, "controller.design": "mine.json"})
    folder = tmp_path / "scenario"
    return [
        Job((law, k), scenario, folder, {**draw_changes(scenario, k), "controller.start.law": law})
        for k in range(1, DRAWS + 1)
        for law in ("LC", "IHC")
    ]


def test_the_numbers_are_those_of_one_process_to_the_last_bit(cluster, jobs, fmus, tmp_path):
    seen = []
    with Journal(tmp_path / "here", "test") as here, Journal(tmp_path / "there", "test") as there:
        alone = run_numbers(jobs, fmus, here, workers=1)
        found = run_numbers(jobs, fmus, there, workers=cluster, progress=lambda *counts: seen.append(counts))
        assert repr(found) == repr(alone)
        assert here.known.keys() == there.known.keys()
    assert seen[-1] == (2 * DRAWS, 2 * DRAWS)
    assert len({numbers["integral_q2"] for numbers in found.values()}) == len(jobs)


def test_other_entries_and_files_travel_too(cluster, jobs, fmus, design, tmp_path):
    design.save(tmp_path / "scenario" / "other.json")
    changed = [
        Job(k, jobs[0].scenario, jobs[0].folder, changes)
        for k, changes in enumerate(
            ({"controller.design": "other.json"}, {"plant.parameters": "hcs"}, {"run.step": 5e-4})
        )
    ]
    assert repr(judge_all(changed, fmus, numbers, cluster)) == repr(judge_all(changed, fmus, numbers, 1))


def test_a_mistake_ends_with_its_sentence(cluster, jobs, fmus):
    with pytest.raises(UserError, match=r"controller\.a_min must lie in"):
        judge_all([Job(0, jobs[0].scenario, jobs[0].folder, {"controller.start.a_min": -1.0})], fmus, numbers, cluster)


def test_an_fmu_that_fails_has_no_numbers(cluster, jobs, fmus, tmp_path):
    failing = [Job(0, jobs[0].scenario, jobs[0].folder, {"controller.start.a_min": 2.0}), jobs[1]]
    with Journal(tmp_path / "journal", "test") as journal:
        found = run_numbers(failing, fmus, journal, workers=cluster)
    assert found[0] == {}
    assert found[jobs[1].key]["duration"] == pytest.approx(0.3)


def test_a_killed_worker_and_a_killed_scheduler_lose_nothing(jobs, fmus, tmp_path):
    longer = [Job(job.key, job.scenario, job.folder, {**job.changes, "run.duration": 10.0}) for job in jobs]
    with processes(tmp_path) as started, Journal(tmp_path / "journal", "test") as journal:
        first, _ = started.worker(), started.worker()
        cluster = Cluster(started.address)
        cluster.client.wait_for_workers(2, timeout=60)

        def kill(done, total):
            if done == 4 and first.poll() is None:
                first.send_signal(signal.SIGKILL)
            if done == total // 2:
                started.scheduler.kill()

        with pytest.raises(UserError, match=r"scheduler at .* is gone; what has come back is kept"):
            run_numbers(longer, fmus, journal, workers=cluster, progress=kill)
        kept = len(journal.known)
        assert 2 * DRAWS > kept >= DRAWS
        cluster.close()
        seen = []
        found = run_numbers(longer, fmus, journal, progress=lambda done, _: seen.append(done))
    assert seen[0] == kept
    assert len(found) == 2 * DRAWS


def test_nobody_at_an_address_is_said_in_a_sentence(monkeypatch):
    monkeypatch.setattr("cosim.studies.cluster.ANSWER", 1.0)
    with pytest.raises(UserError, match=r"no Dask scheduler answers at 'tcp://127\.0\.0\.1:1'"):
        Cluster("tcp://127.0.0.1:1")
    for address in ("nonsense://x:1", "127.0.0.1", "", "foo", "tcp://127.0.0.1:no", "http://127.0.0.1:8786"):
        with pytest.raises(UserError, match=f"--cluster takes the address of a scheduler, .* found '{address}'"):
            Cluster(address)


def test_workers_of_another_version_are_refused(cluster, jobs, fmus, monkeypatch):
    monkeypatch.setattr("cosim.studies.cluster.identity", lambda: "another")
    with pytest.raises(UserError, match="workers must have this version of qube-ihc"):
        judge_all(jobs[:1], fmus, numbers, cluster)
