"""Benchmarks: jobs that go on where they stopped, by any number of processes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ccdiff_env.bench.jobs import Job, run_jobs
from ccdiff_env.bench.planners import planner_jobs
from ccdiff_env.bench.scenes import chunks, scenes_of
from ccdiff_env.errors import ConfigError, DatasetError

VAL = "embedded/val"


def square(x, log=None):
    """A job's function; notes that it was run."""
    if log is not None:
        with open(log, "a", encoding="utf-8") as file:
            file.write(f"{x}\n")
    return {"square": x * x}


def sleepy(folder):
    """A job's function that leaves the number of its process, and goes on for long."""
    Path(folder, str(os.getpid())).touch()
    time.sleep(300)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # a zombie is not alive, only not yet collected
    return (
        Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    )


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT], ids=["kill", "Ctrl-C"])
def test_workers_end_with_the_run_that_was_ended(tmp_path, sent):
    """At once, although jobs wait and none is done."""
    pids = tmp_path / "pids"
    pids.mkdir()
    code = f"""
from pathlib import Path
from ccdiff_env.bench.jobs import Job, run_jobs
if __name__ == "__main__":
    jobs = [Job(str(x), "test_bench_jobs:sleepy", {{"folder": {str(pids)!r}}}) for x in range(6)]
    run_jobs(jobs, Path({str(tmp_path / "raw")!r}), workers=2, progress=False)
"""
    (tmp_path / "main.py").write_text(code, encoding="utf-8")
    path = os.pathsep.join([os.path.dirname(__file__), *sys.path])
    run = subprocess.Popen(
        [sys.executable, str(tmp_path / "main.py")],
        env={**os.environ, "PYTHONPATH": path},
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    while len(list(pids.iterdir())) < 2:
        time.sleep(0.1)
    workers = [int(file.name) for file in pids.iterdir()]
    os.killpg(run.pid, sent) if sent is signal.SIGINT else run.kill()
    said = run.communicate()[1].decode()
    assert len(workers) == 2
    assert said.count("Traceback") == (sent is signal.SIGINT)
    while any(alive(pid) for pid in workers):
        time.sleep(0.1)


def test_a_killed_run_goes_on_where_it_stopped(tmp_path):
    log = tmp_path / "log"
    jobs = [Job(f"job-{x}", f"{__name__}:square", {"x": x, "log": str(log)}) for x in range(4)]
    run_jobs(jobs[:2], tmp_path / "raw", progress=False)
    found = run_jobs(jobs, tmp_path / "raw", progress=False)
    assert log.read_text().split() == ["0", "1", "2", "3"]
    assert found == {f"job-{x}": {"square": x * x} for x in range(4)}
    assert not [p for p in (tmp_path / "raw").iterdir() if p.name.startswith(".")]


def test_results_do_not_depend_on_the_number_of_workers(tmp_path):
    arguments = {
        "source": VAL, "method": "constant_velocity", "num_controlled": 2, "replan_steps": 5,
        "seed": 0,
    }  # fmt: skip
    names = chunks(scenes_of(VAL).names, 3)[:2]
    jobs = [
        Job(f"cv-K2-T5-{i:03d}", "ccdiff_env.bench.traffic:evaluate", {**arguments, "names": n})
        for i, n in enumerate(names)
    ]
    jobs += planner_jobs(VAL, ["pdm", "ego"], ["idm"])  # with digests of every bit
    one = run_jobs(jobs, tmp_path / "one", progress=False)
    assert one == run_jobs(jobs, tmp_path / "two", workers=2, progress=False)


def test_damaged_results_and_doubled_names_are_refused(tmp_path):
    job = Job("job", f"{__name__}:square", {"x": 1})
    with pytest.raises(ConfigError, match="same name"):
        run_jobs([job, job], tmp_path, progress=False)
    with pytest.raises(ConfigError, match="workers"):
        run_jobs([job], tmp_path, workers=0, progress=False)
    (tmp_path / "job.json").write_text("{", encoding="utf-8")
    with pytest.raises(DatasetError, match=r"job\.json"):
        run_jobs([job], tmp_path, progress=False)
