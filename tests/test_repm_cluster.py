"""scripts/repm-cluster: what it starts it ends, and its job scripts hold what the options say."""

from __future__ import annotations

import importlib.util
import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

SCRIPT = pathlib.Path(__file__).resolve().parents[1] / "scripts" / "repm-cluster"
needs_dask = pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="Dask is not installed")
posix = pytest.mark.skipif(os.name == "nt", reason="process groups")


def run(*words, **others):
    done = subprocess.run([sys.executable, str(SCRIPT), *words], capture_output=True, text=True, check=False, **others)
    return done.returncode, done.stdout + done.stderr


def alive(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@needs_dask
@posix
@pytest.mark.parametrize("how", ["Ctrl-C", "TERM", "KILL"])
def test_a_local_cluster_works_and_ends_with_all_that_it_started(tmp_path, how):
    from distributed import Client

    command = [sys.executable, str(SCRIPT), "local", "2", "--memory", "600"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, **pipes, text=True, env=environment, start_new_session=True)
    try:
        lines = [process.stdout.readline() for _ in range(4)]
        address, file = (line.strip().removeprefix("CLUSTER=") for line in lines[1:3])
        assert address.startswith("tcp://127.0.0.1:")
        assert json.loads(pathlib.Path(file).read_text(encoding="utf-8"))["address"] == address
        with Client(scheduler_file=file, set_as_default=False) as client:
            workers = client.scheduler_info()["workers"].values()
            threads = set(client.run(lambda: __import__("os").environ["OMP_NUM_THREADS"]).values())
            found = client.run(lambda: __import__("repm_qgis").__file__).values()
        assert [(each["nthreads"], each["memory_limit"]) for each in workers] == [(1, 600 << 20)] * 2
        assert all(each["nanny"] for each in workers) and threads == {"1"}
        assert {pathlib.Path(each).parents[1] for each in found} == {SCRIPT.parents[1]}
        if how == "Ctrl-C":  # a terminal sends it to all
            os.killpg(process.pid, signal.SIGINT)
        else:
            process.send_signal(getattr(signal, f"SIG{how}"))
        assert process.wait(10) == (-signal.SIGKILL if how == "KILL" else 0)
        deadline = time.monotonic() + 10
        while alive(process.pid):
            assert time.monotonic() < deadline, "a worker lives on"
            time.sleep(0.05)
        if how != "KILL":  # after which the next start removes the folder
            assert not list(tmp_path.iterdir()) and process.stderr.read() == ""
    finally:
        if alive(process.pid):
            os.killpg(process.pid, signal.SIGKILL)


@posix
@pytest.mark.parametrize("system", ["slurm", "pbs"])
def test_a_job_script_holds_what_the_options_say(tmp_path, system):
    folder = tmp_path / "a folder's"
    folder.mkdir()
    options = ["--workers", "12", "--memory", "3000", "--time", "02:30:00", "--account", "hills", "--queue", "long"]
    code, text = run(system, *options, "--interface", "ib0", "--folder", str(folder))
    assert code == 0 and "repm-cluster-JOB.json" in text
    script = folder / f"repm-cluster.{system}"
    lines = script.read_text(encoding="utf-8").splitlines()
    assert lines[0] == "#!/bin/bash"
    headers = {
        "slurm": {"array=0-12", "mem=3256M", "time=02:30:00", "account=hills", "partition=long", "cpus-per-task=1"},
        "pbs": {"-J 0-12", "-l select=1:ncpus=1:mem=3256mb", "-l walltime=02:30:00", "-A hills", "-q long"},
    }
    found = {line.replace("#SBATCH --", "").replace("#PBS ", "") for line in lines}
    assert not headers[system] - found
    names = {"slurm": ("SLURM_ARRAY_JOB_ID", "SLURM_ARRAY_TASK_ID"), "pbs": ("PBS_JOBID", "PBS_ARRAY_INDEX")}[system]
    # The body, with a Python that prints what it is asked: what each job of the array would run.
    body = script.read_text(encoding="utf-8").replace(next(line for line in lines if line.startswith("python=")), "")
    for index, program in (("0", "dask_scheduler"), ("3", "dask_worker")):
        job = {names[0]: "77" if system == "slurm" else "77[3].head", names[1]: index, "python": "echo"}
        done = subprocess.run(
            ["bash", "-c", body], capture_output=True, text=True, check=True, env={**os.environ, **job}
        ).stdout
        assert f"distributed.cli.{program} " in done and f"--scheduler-file {folder}/repm-cluster-77.json" in done
        assert "--interface ib0" in done
    assert "--nthreads 1 --nanny" in done and "--memory-limit 3000MiB" in done


@posix
def test_a_submitted_job_says_where_its_address_will_be(tmp_path):
    program = tmp_path / "sbatch"
    program.write_text('#!/bin/sh\necho "4711;hills"\n', encoding="utf-8")
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    code, text = run("slurm", "--submit", "--folder", str(tmp_path), env=environment)
    assert code == 0 and f"CLUSTER={tmp_path}/repm-cluster-4711.json\n" in text and "scancel 4711" in text
    program.write_text("#!/bin/sh\necho 'invalid account' >&2\nexit 1\n", encoding="utf-8")
    code, text = run("slurm", "--submit", "--folder", str(tmp_path), env=environment)
    assert code == 1 and "(invalid account)" in text and len(text.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["local", "0"], "'0' is not a whole number of at least 1"),
        (["local", "2", "--memory", "100"], "100 MiB for each of 2 workers are less than the 512"),
        (["slurm", "--folder", "nowhere"], "nowhere' is not a folder: make it"),
        (["pbs", "--time", "3h"], "'3h' is not a time such as 08:00:00"),
        (["slurm", "--account", "a\n#SBATCH --x"], "has characters that a job script cannot hold"),
    ],
)
def test_mistakes_are_one_sentence(words, sentence):
    if words[0] == "local" and importlib.util.find_spec("distributed") is None:
        pytest.skip("Dask is not installed")
    code, text = run(*words)
    assert code != 0 and sentence in text and "Traceback" not in text
