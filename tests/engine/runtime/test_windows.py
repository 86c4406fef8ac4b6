"""The engine as Windows has it, as far as Linux can play that: ``spawn``, no POSIX calls, code page 1252, odd paths.

Under Windows these tests run as well; scripts/windows-trial does that under Wine.
"""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess
import sys

import numpy as np
import pytest

from repm_qgis.imagery.raster import opened

ROOT = pathlib.Path(__file__).resolve().parents[3]
# Workers that begin by spawn run this file too, up to its last line.
START = """
import multiprocessing, os, signal, sys

for name in ("killpg", "getpgrp", "getpgid", "setsid", "getuid", "geteuid", "getgid", "sched_getaffinity", "sysconf",
             "nice", "chown", "getloadavg", "pread", "fork", "forkpty", "mkfifo"):
    if hasattr(os, name):
        delattr(os, name)
for name in ("SIGALRM", "SIGHUP", "SIGUSR1", "SIGQUIT", "alarm", "setitimer"):
    if hasattr(signal, name):
        delattr(signal, name)
def refused(*given, **named):
    raise OSError("A required privilege is not held by the client")

os.symlink = refused  # there, but for those with the right
multiprocessing.get_all_start_methods = lambda: ["spawn"]
sys.path.insert(0, os.getcwd())
if __name__ == "__main__":
    from repm_qgis.engine_process import main

    sys.exit(main(sys.argv[1:]))
"""


def engine(tmp_path, stage, **options):
    """Run a stage with standard streams of code page 1252, as a console of Windows in Western Europe has them."""
    start, job = tmp_path / "start.py", tmp_path / "job.json"
    start.write_text(START, encoding="utf-8")
    job.write_bytes(json.dumps(options, ensure_ascii=False, indent=1).replace("\n", "\r\n").encode())
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [sys.executable, str(start), stage, str(job)],
        cwd=ROOT,
        env={**environment, "LC_ALL": "C.UTF-8"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        check=False,
    )
    said = [json.loads(line) for line in done.stdout.decode("cp1252").splitlines()]
    return done.returncode, said, done.stderr.decode("cp1252")


def heights(path):
    with opened(str(path)) as dataset:
        return dataset.ReadAsArray()


@pytest.mark.slow
def test_a_run_by_spawned_workers_gives_the_same_heights(urban_run, urban, tmp_path):
    place = tmp_path / "Ünïcode 日本 & spaces (1)"
    place.mkdir()
    images = [shutil.copy(path, place) for path in urban.images]
    code, said, errors = engine(
        tmp_path,
        "pipeline",
        images=images,
        workspace=str(place / "work space"),
        output=str(place / "DSM größe.tif"),
        report=str(place / "report 日本.html"),
        resolution=0.5,
        tile_size=256,
        workers=2,
    )
    assert code == 0, (said[-3:], errors)
    assert said[-1]["result"]["output"] == str(place / "DSM größe.tif")
    np.testing.assert_array_equal(heights(place / "DSM größe.tif"), heights(urban_run.result.output))
    assert "日本" in (place / "report 日本.html").read_text(encoding="utf-8")
    assert b"\r" not in (place / "DSM größe.qml").read_bytes()


def test_a_failure_is_a_sentence_with_names_that_the_code_page_lacks(tmp_path):
    missing = str(tmp_path / "日本 Ω.tif")
    output, workspace = str(tmp_path / "d.tif"), str(tmp_path / "w")
    code, said, errors = engine(tmp_path, "pipeline", images=[missing, missing], output=output, workspace=workspace)
    assert code == 1 and said and said[-1]["type"] == "error", (code, said, errors)
    assert missing in said[-1]["text"] and "Traceback" not in errors


@pytest.mark.skipif(os.name == "nt", reason="test_parallel itself has spawned workers there")
@pytest.mark.slow
def test_tasks_pass_all_their_tests_with_spawned_workers(tmp_path):
    """Order, exceptions, deaths and Cancel; the tests about memory start engines of their own."""
    start = tmp_path / "start.py"
    start.write_text(
        "import multiprocessing, sys\nmultiprocessing.get_all_start_methods = lambda: ['spawn']\n"
        "if __name__ == '__main__':\n    import pytest\n    sys.exit(pytest.main(sys.argv[1:]))\n"
    )
    words = [
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:pytest_qgis",
        f"--basetemp={tmp_path / 'base'}",
        "-k",
        "not memory",
    ]
    done = subprocess.run(
        [sys.executable, str(start), *words, str(ROOT / "tests" / "engine" / "runtime" / "test_parallel.py")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout[-4000:]


def test_a_drive_is_no_format_and_no_address():
    """GDAL's descriptions begin with a format's name and a colon: one letter is a drive."""
    from repm_qgis.files import untrusted
    from repm_qgis.files.vector import file_and_layer

    for path in (r"D:\images\a b.tif", "D:/images/a.tif"):
        assert not untrusted._DRIVER.match(path) and not untrusted._REMOTE.match(path)
    assert untrusted._DRIVER.match("GTIFF_DIR:1:a.tif") and untrusted._REMOTE.match("https://example.org/a.tif")
    assert file_and_layer(r"D:\data 1\points.gpkg|layername=a b") == (r"D:\data 1\points.gpkg", "a b")
