"""scripts/repm-cluster: what it starts it ends, and its job scripts hold what the options say."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import pathlib
import signal
import socket
import ssl
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


def greeting(address, key):
    """What a scheduler says to a program that trusts everybody and shows a key, or none."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    if key:
        context.load_cert_chain(key)
    host, port = address.partition("//")[2].split(":")
    with contextlib.suppress(OSError), socket.create_connection((host, int(port)), 10) as plain:  # ssl's errors too
        with context.wrap_socket(plain) as connection:
            return connection.recv(100)
    return b""


@needs_dask
@posix
@pytest.mark.parametrize("how", ["Ctrl-C", "TERM", "KILL"])
@pytest.mark.slow
def test_a_local_cluster_works_and_ends_with_all_that_it_started(tmp_path, how):
    from distributed import Client

    from repm_qgis.contracts.errors import ClusterError
    from repm_qgis.runtime.cluster import cluster_workers, key_file, security
    from repm_qgis.runtime.parallel import run_tasks
    from repm_qgis.runtime.progress import Silent

    command = [sys.executable, str(SCRIPT), "local", "2", "--memory", "600"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, **pipes, text=True, env=environment, start_new_session=True)
    try:
        lines = [process.stdout.readline() for _ in range(3)]
        file = lines[1].strip().removeprefix("CLUSTER=")
        address = json.loads(pathlib.Path(file).read_text(encoding="utf-8"))["address"]
        assert address.startswith("tls://127.0.0.1:")
        key = pathlib.Path(file).with_name("repm-cluster.pem")
        assert key.stat().st_mode & 0o777 == 0o600
        strange = key_file(str(tmp_path))  # other users of this machine reach the port, but do not have the key
        assert greeting(address, str(key)) and not greeting(address, strange) and not greeting(address, None)
        os.unlink(strange)
        with Client(scheduler_file=file, security=security(str(key)), set_as_default=False) as client:
            workers = client.scheduler_info()["workers"].values()
            threads = set(client.run(lambda: __import__("os").environ["OMP_NUM_THREADS"]).values())
            found = client.run(lambda: __import__("repm_qgis").__file__).values()
        assert [(each["nthreads"], each["memory_limit"]) for each in workers] == [(1, 600 << 20)] * 2
        assert all(each["nanny"] for each in workers) and threads == {"1"}
        assert {pathlib.Path(each).parents[1] for each in found} == {SCRIPT.parents[1]}
        with cluster_workers(file, (), (), Silent()):  # REPM finds the key beside the scheduler file
            assert run_tasks(abs, [-1, 2, -3], 0, Silent(), str) == [1, 2, 3]
        with pytest.raises(
            ClusterError,
            match=r"requires encryption \(TLS\): give the scheduler file that lies beside its repm-cluster",
        ):
            with cluster_workers(address, (), (), Silent()):
                pytest.fail("it did not ask for the key")
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
            assert not list(tmp_path.iterdir())
            said = process.stderr.read().splitlines()
            assert len(said) == 2 and all("TLS handshake failed" in line for line in said)
    finally:
        if alive(process.pid):
            os.killpg(process.pid, signal.SIGKILL)


@needs_dask
@posix
def test_a_key_that_others_could_read_is_made_again(tmp_path):
    from repm_qgis.runtime.cluster import key_file

    made = pathlib.Path(key_file(str(tmp_path)))
    own = made.read_bytes()
    assert key_file(str(tmp_path)) == str(made) and made.read_bytes() == own
    for spoil in (
        lambda: made.chmod(0o644),
        lambda: os.utime(made, (0, 0)),
        lambda: (made.rename(tmp_path / "other"), made.symlink_to(tmp_path / "other")),
    ):
        before = made.read_bytes()
        spoil()
        key_file(str(tmp_path))
        assert made.read_bytes() != before and made.lstat().st_mode & 0o777 == 0o600


@needs_dask
@posix
@pytest.mark.parametrize("system", ["slurm", "pbs"])
@pytest.mark.long
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
        key = f"{folder}/repm-cluster.pem"
        assert f"--protocol tls --tls-ca-file {key} --tls-cert {key} --tls-key {key}" in done
        assert "--interface ib0" in done
    assert "--nthreads 1 --nanny" in done and "--memory-limit 3000MiB" in done


@needs_dask
@posix
@pytest.mark.long
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
    if words[0] != "pbs" and importlib.util.find_spec("distributed") is None:
        pytest.skip("Dask is not installed")
    code, text = run(*words)
    assert code != 0 and sentence in text and "Traceback" not in text
