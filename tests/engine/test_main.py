"""``python -m repm_qgis``: what goes over standard output, and the exit codes."""

from __future__ import annotations

import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from repm_qgis.contracts.stages import STAGES
from repm_qgis.imagery.raster import opened

ROOT = pathlib.Path(__file__).resolve().parents[2]


def engine(*arguments, **keywords):
    return subprocess.run(
        [sys.executable, "-m", "repm_qgis", *map(str, arguments)],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        check=False,
        **keywords,
    )


def messages(done):
    return [json.loads(line) for line in done.stdout.splitlines()]


def job(tmp_path, **options):
    path = tmp_path / "job.json"
    path.write_text(json.dumps(options))
    return path


def test_a_result_is_the_last_of_json_lines_and_code_0(tmp_path):
    done = engine("environment", job(tmp_path, report=str(tmp_path / "r.html")))
    assert done.returncode == 0
    said = messages(done)
    assert said[-1]["type"] == "result" and said[-1]["result"]["report"] == str(tmp_path / "r.html")
    fractions = [message["fraction"] for message in said if message["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[-1] == 1


def test_who_asks_for_help_gets_the_stages_and_their_options():
    done = engine("--help")
    assert done.returncode == 0 and done.stdout.startswith("usage: repm ") and not done.stderr
    assert set(STAGES) <= set(done.stdout.split()) and "STAGE JOB.json" in done.stdout
    done = engine("dtm", "--help")
    assert done.returncode == 0 and done.stdout.startswith("usage: repm dtm ") and "--slope" in done.stdout


def test_expected_failures_are_sentences_and_code_1(tmp_path):
    broken = tmp_path / "broken.json"
    broken.write_text('{"report": ')
    for arguments, words in (
        (["environment"], "must be a STAGE and a JOB.json"),
        (["nonsense", job(tmp_path)], "must be one of inspect, epmfit"),
        (["environment", broken], "must be a readable JSON file"),
        (["environment", tmp_path / "gone.json"], "must be a readable JSON file"),
        (["environment", job(tmp_path, colour="red")], "is not an option of this stage"),
    ):
        done = engine(*arguments)
        assert done.returncode == 1
        assert messages(done)[-1]["type"] == "error"
        assert words in messages(done)[-1]["text"]
        assert "Traceback" not in done.stdout + done.stderr


def test_a_job_comes_over_standard_input(tmp_path):
    options = json.dumps({"report": str(tmp_path / "r.html")})
    done = engine("environment", "-", input=f"{options}\n")
    assert done.returncode == 0 and messages(done)[-1]["result"]["report"] == str(tmp_path / "r.html")
    for line in ('{"report": ', ""):
        done = engine("environment", "-", input=line)
        assert done.returncode == 1 and "'-': it must be a readable JSON file" in messages(done)[-1]["text"]


@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM: test_ending has what takes its place")
def test_sigterm_cancels_and_cleans_up(tmp_path):
    folder = tmp_path / "scene"
    running = subprocess.Popen(
        [sys.executable, "-m", "repm_qgis", "sampledata", str(job(tmp_path, folder=str(folder), size=2000))],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    running.stdout.readline()  # it has begun
    time.sleep(0.5)
    os.killpg(running.pid, signal.SIGTERM)
    said, _ = running.communicate(timeout=10)
    assert running.returncode == 1
    assert json.loads(said.splitlines()[-1]) == {"type": "error", "kind": "Cancelled", "text": "Cancelled by the user."}


def test_the_engine_runs_where_qgis_cannot_be_imported(tmp_path):
    code = (
        "import sys; sys.modules['qgis'] = None; sys.modules['PyQt5'] = None; "
        "from repm_qgis.engine_process import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "environment", str(job(tmp_path))],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        check=False,
    )
    assert done.returncode == 0 and messages(done)[-1]["type"] == "result"


SWALLOWED = """
import os, signal, sys, time
from repm_qgis import engine_process
from repm_qgis.runtime.workspace import write_text
def run(asked, lines):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)
    except Exception:  # as native code does with what a callback raises
        if sys.argv[1] == "writes":
            write_text(sys.argv[2], "not all of it")
        raise ValueError("Failed to call write") from None
engine_process._run = run
sys.exit(engine_process.main(sys.argv[1:]))
"""


@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM")
@pytest.mark.parametrize("what", ("fails", "writes"))
def test_a_cancel_that_native_code_swallows_is_a_cancel_and_names_no_file(tmp_path, what):
    path = tmp_path / "product.txt"
    path.write_text("the old one")
    command = [sys.executable, "-c", SWALLOWED, what, str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 1 and json.loads(done.stdout.splitlines()[-1])["kind"] == "Cancelled", done.stderr
    assert path.read_text() == "the old one" and [each.name for each in tmp_path.iterdir()] == ["product.txt"]


LATE = """
import os, signal, sys
from repm_qgis import engine_process
from repm_qgis.contracts.results import ErrorMapResult
engine_process._run = lambda asked, lines: ErrorMapResult("map.tif", None, 0.5, 1.5, 100.0, 2.0)
code = engine_process.main(["a", "b"])
os.kill(os.getpid(), signal.SIGTERM)
sys.exit(code)
"""


@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM")
def test_a_signal_after_the_result_changes_nothing():
    done = subprocess.run([sys.executable, "-c", LATE], cwd=ROOT, capture_output=True, text=True, check=False)
    answer = json.loads(done.stdout)
    assert done.returncode == 0 and answer["type"] == "result" and answer["result"]["max_error"] == 1.5


EARLY = """
import os, signal, sys
from repm_qgis import engine_process
listen = engine_process.Cancelling.listen
def heard_at_once(self):
    listen(self)
    os.kill(os.getpid(), signal.SIGTERM)
engine_process.Cancelling.listen = heard_at_once
sys.exit(engine_process.main(["epmfit", "none.json"]))
"""


@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM")
def test_a_signal_before_the_stage_is_a_cancel():
    done = subprocess.run([sys.executable, "-c", EARLY], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and json.loads(done.stdout)["kind"] == "Cancelled" and done.stderr == ""


@pytest.mark.slow
def test_results_do_not_depend_on_the_threads_of_linear_algebra(urban, tmp_path):
    """Sums in another order differ in their last bits, and rounding makes pixels of them."""
    found = []
    for threads in ("1", "8"):
        place = tmp_path / threads
        place.mkdir()
        job = {
            "images": urban.images[:2],
            "workspace": str(place / "w"),
            "output": str(place / "dsm.tif"),
            "workers": 1,
        }
        (place / "job.json").write_text(json.dumps(job))
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        done = engine("pipeline", place / "job.json", env={**os.environ, **dict.fromkeys(names, threads)})
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr
        scene = json.loads((place / "w" / "reconstructed.json").read_text())
        cameras = [tile["views"] for tile in scene["tiles"]]
        found.append(([view["pointing"] for view in scene["views"]], cameras))
    assert found[0] == found[1]
    with opened(str(tmp_path / "1" / "dsm.tif")) as one, opened(str(tmp_path / "8" / "dsm.tif")) as other:
        assert np.array_equal(one.ReadAsArray(), other.ReadAsArray())


def test_gdals_question_to_programmers_is_not_in_the_log():
    """GDAL 3.7 and newer asks it once in each process."""
    question = "Neither gdal.UseExceptions() nor gdal.DontUseExceptions() has been explicitly called."
    said = "".join(f"; warnings.warn({text!r}, FutureWarning)" for text in (question, "another"))
    code = f"import repm_qgis, warnings{said}"
    done = subprocess.run([sys.executable, "-W", "default", "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert "another" in done.stderr and "Neither" not in done.stderr
