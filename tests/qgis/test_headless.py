"""A real qgis_process: exit codes, results, and sentences in place of tracebacks."""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time
import zipfile

import pytest
from osgeo import gdal

ROOT = pathlib.Path(__file__).resolve().parents[2]
IMAGE = ROOT / "docs" / "pictures" / "toolbox.png"  # a raster that is there


def said(done):
    return done.stdout + done.stderr


def cpu_of_children():
    return sum(os.times()[2:4])


@pytest.mark.slow
def test_the_toolbox_lists_us_and_nobody_elses_plugins(headless, tmp_path):
    ours, without = {}, {"config": tmp_path}
    headless("plugins", **without)  # the first start makes the profile
    settings = tmp_path / "profiles" / "default" / "QGIS" / "QGIS3.ini"
    settings.write_text(settings.read_text().replace("repm=true", "repm=false"))
    headless("plugins")
    seconds = []
    for start in (without, ours, without, ours, without, ours):
        before = cpu_of_children()
        done = headless("--json", "list", **start)
        seconds.append(cpu_of_children() - before)
        assert done.returncode == 0, said(done)
        assert ("repm" in json.loads(done.stdout)["providers"]) == (start is ours)
    # 1.1 s each on a machine of 2026; whatever else runs there takes its time, but not our seconds of the processor.
    assert min(seconds[1::2]) < 1.5 * min(seconds[::2]), seconds
    providers = json.loads(done.stdout)["providers"]
    pages = {f"repm:{page.stem}" for page in (ROOT / "docs" / "algorithms").glob("*.md")}
    assert pages < set(providers["repm"]["algorithms"])  # and the models
    assert not {"grass7", "saga", "otb"} & set(providers)


@pytest.mark.long
def test_environment_reports_on_the_engines_interpreter(headless, tmp_path):
    report = tmp_path / "environment.html"
    done = headless("--json", "run", "repm:environment", "--", f"REPORT={report}", REPM_ENGINE_PYTHON=sys.executable)
    assert done.returncode == 0, said(done)
    assert json.loads(done.stdout)["results"] == {"REPORT": str(report)}
    page = report.read_text(encoding="utf-8")
    assert sys.executable in page
    assert "opencv-python-headless" in page
    import numpy

    assert numpy.__version__ in page


def image(path):
    gdal.UseExceptions()
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), 64, 64)
    dataset.GetRasterBand(1).Fill(7)
    del dataset
    return path


@pytest.mark.parametrize("stage", ["epmfit", "pipeline"])  # in QGIS's process, and in one of its own
@pytest.mark.long
def test_an_image_without_rpc_is_one_sentence_and_code_1(headless, tmp_path, stage):
    given = [f"IMAGES={image(tmp_path / name)}" for name in ("a.tif", "b.tif")]
    products = [f"OUTPUT={tmp_path / 'dsm.tif'}"] if stage == "pipeline" else []
    done = headless(
        "run",
        f"repm:{stage}",
        "--",
        *given,
        *products,
        f"WORKSPACE={tmp_path / 'w'}",
        f"TILES={tmp_path / 't.gpkg'}",
        REPM_ENGINE_PYTHON=sys.executable,
    )
    assert done.returncode == 1, said(done)
    assert "No RPC found for" in said(done) and "a.tif'" in said(done)
    assert "Traceback" not in said(done)
    assert not (tmp_path / "dsm.tif").exists()
    assert sorted(path.name for path in tmp_path.glob("[ab].tif*")) == ["a.tif", "b.tif"]  # nothing beside the images


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["repm:pipeline", "--", "IMAGES=a.tif", "WORKSPACE=w", "OUTPUT=d.tif"], "at least two images"),
        (["repm:errormap", "--", "SCENE=gone/scene.json", "OUTPUT=o.tif"], "scene.json"),
        (["repm:dsmfuse", "--", "SCENE=gone/scene.json", "OUTPUT=o.tif"], "scene.json"),
        (["repm:comparedsm", "--", "DSM=gone.tif", "REFERENCE=gone too.tif"], "DSM 'gone.tif' is not there"),
        (["repm:comparedsm", "--", f"DSM={IMAGE}", f"REFERENCE={IMAGE}", "THRESHOLDS=high"], "THRESHOLDS is 'high'"),
    ],
)
@pytest.mark.slow
def test_user_errors_are_one_sentence_and_code_1(headless, tmp_path, words, sentence):
    done = headless("run", *words, REPM_ENGINE_PYTHON=sys.executable)
    assert done.returncode == 1, said(done)
    assert sentence in said(done)
    assert "Traceback" not in said(done)


@pytest.mark.parametrize(
    ("words", "kind", "sentence"),
    [
        (["repm:comparedsm", "--", "DSM=gone.tif", "REFERENCE=too.tif"], "OptionError", "DSM 'gone.tif' is not there"),
        (["repm:epmfit", "--", "IMAGES=a.tif", "IMAGES=b.tif", "WORKSPACE=w"], "RpcMissingError", "No RPC found"),
        (["repm:sampledata", "--", "SIZE=128", "FOLDER=f"], "EngineError", "interpreter '/no/python' is not a program"),
    ],
)
@pytest.mark.long
def test_a_failure_is_one_document_of_json_for_programs(headless, tmp_path, words, kind, sentence):
    words = [word.replace("=a.tif", f"={IMAGE}").replace("=b.tif", f"={IMAGE.parent / 'map.png'}") for word in words]
    words = [word.replace("=w", f"={tmp_path}").replace("=f", f"={tmp_path}") for word in words]
    python = "/no/python" if kind == "EngineError" else sys.executable
    done = headless("--json", "run", *words, REPM_ENGINE_PYTHON=python)
    error = json.loads(done.stdout)
    assert (done.returncode, error["type"], error["kind"]) == (1, "error", kind), said(done)
    assert sentence in error["text"] and error["text"] in done.stderr


@pytest.mark.long
def test_a_wrong_interpreter_is_one_sentence_and_code_1(headless, tmp_path):
    done = headless("run", "repm:sampledata", "--", "SIZE=128", f"FOLDER={tmp_path}", REPM_ENGINE_PYTHON="/no/python")
    assert done.returncode == 1
    assert "The engine interpreter '/no/python' is not a program" in said(done)
    assert "Traceback" not in said(done)


@pytest.mark.long
def test_epmfit_runs_in_qgis_and_its_scene_goes_on_to_errormap(headless, sample, tmp_path):
    images = [f"IMAGES={path}" for path in sample.images]
    done = headless(
        "--json",
        "run",
        "repm:epmfit",
        "--",
        *images,
        f"WORKSPACE={tmp_path / 'w'}",
        f"TILES={tmp_path / 'tiles.gpkg'}",
        f"REPORT={tmp_path / 'fit.html'}",
    )
    assert done.returncode == 0, said(done)
    fitted = json.loads(done.stdout)["results"]
    assert 0 < fitted["RMSE"] <= fitted["MAX_ERROR"] < 5
    assert json.loads(pathlib.Path(fitted["SCENE"]).read_text())["format"] == "repm-scene"
    done = headless("--json", "run", "repm:errormap", "--", f"SCENE={fitted['SCENE']}", f"OUTPUT={tmp_path / 'e.tif'}")
    assert done.returncode == 0, said(done)
    assert json.loads(done.stdout)["results"]["MAX_ERROR"] > 0
    assert (tmp_path / "e.qml").exists()


@pytest.mark.long
def test_cameras_are_the_same_to_the_last_bit_in_qgis_and_in_a_script_with_many_threads(headless, sample, tmp_path):
    """QGIS loads GSL's linear algebra, which numpy then uses in its process: cameras differed in the tenth digit."""
    images = [f"IMAGES={path}" for path in sample.images]
    done = headless("run", "repm:epmfit", "--", *images, f"WORKSPACE={tmp_path / 'in QGIS'}")
    assert done.returncode == 0, said(done)
    job = {"images": sample.images, "workspace": str(tmp_path / "by a script")}
    script = "from repm_qgis.runtime.progress import Silent; from repm_qgis.stages import run_stage; import json, sys; "
    subprocess.run(
        [sys.executable, "-c", script + "run_stage('epmfit', json.loads(sys.argv[1]), Silent())", json.dumps(job)],
        cwd=ROOT,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "4"},
        check=True,
    )
    first, second = (
        [
            {name: view["camera"] for name, view in tile["views"].items()}
            for tile in json.loads((tmp_path / name / "scene.json").read_text())["tiles"]
        ]
        for name in ("in QGIS", "by a script")
    )
    assert first == second and len(first[0]) == 3


@pytest.mark.slow
def test_the_zip_installs_into_an_empty_profile_and_runs(headless, tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "package"), str(tmp_path / "dist")],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    (archive,) = (tmp_path / "dist").iterdir()
    assert archive.name in done.stdout
    plugins = tmp_path / "config" / "profiles" / "default" / "python" / "plugins"
    plugins.mkdir(parents=True)
    with zipfile.ZipFile(archive) as opened:
        names = opened.namelist()
        opened.extractall(plugins)
    assert {name.split("/")[0] for name in names} == {"repm"}
    assert {
        "repm/metadata.txt",
        "repm/LICENSE",
        "repm/__init__.py",
        "repm/repm_qgis/__main__.py",
        "repm/resources/models/repm_stages.model3",
        "repm/scripts/setup",
        "repm/requirements.txt",
    } <= set(names)
    parts = {part for name in names for part in name.split("/")}
    assert not [part for part in parts if part.startswith(".") or part == "tests" or part == "__pycache__"]
    assert not [name for name in names if name.endswith((".pyc", ".so", ".dll", ".exe", ".zip"))]
    assert archive.stat().st_size < 25e6
    shutil.copy(plugins / "repm" / "metadata.txt", tmp_path)  # what runs is the unzipped folder, no link to this one
    assert not (plugins / "repm").is_symlink()

    folder = tmp_path / "sample"
    done = headless(
        "--json",
        "run",
        "repm:sampledata",
        "--",
        "KIND=mountains",
        "SIZE=128",
        f"FOLDER={folder}",
        config=tmp_path / "config",
        REPM_ENGINE_PYTHON="",
    )
    assert done.returncode == 0, said(done)
    assert os.path.exists(json.loads(done.stdout)["results"]["TRUTH"])
    ran = [line for line in json.loads(done.stdout)["log"]["info"] if "-m repm_qgis" in line]
    assert ran and not ran[0].startswith(str(ROOT)), "the unzipped plugin has no .venv: QGIS's own Python is to run"


def family(mark, words=b""):
    """The numbers of the living processes whose environment holds the mark, and whose command the words."""
    found = []
    for path in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            ours = mark in (path / "environ").read_bytes() and words in (path / "cmdline").read_bytes()
            state = (path / "stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            continue
        if ours and state != "Z":
            found.append(int(path.name))
    return found


def wait_for(condition, seconds):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
@pytest.mark.parametrize("processes", [2, 4])  # qgis_process with its engine, and with workers as well
@pytest.mark.slow
def test_ctrl_c_and_sigterm_end_a_run_with_everything_it_started(headless_start, town, tmp_path, number, processes):
    mark = f"REPM_TEST_MARK={tmp_path}"
    running = headless_start(
        "--json",
        "run",
        "repm:pipeline",
        "--",
        *(f"IMAGES={path}" for path in town.images),
        "TILE_SIZE=256",
        f"OUTPUT={tmp_path / 'dsm.tif'}",
        f"WORKSPACE={tmp_path / 'w'}",
        REPM_ENGINE_PYTHON=sys.executable,
        REPM_TEST_MARK=str(tmp_path),
    )
    try:
        # The shell that starts qgis_process has children too, so the engine must be among those that are counted.
        begun = wait_for(lambda: family(mark.encode(), b"-m\0repm_qgis\0pipeline"), 60)
        assert begun and wait_for(lambda: len(family(mark.encode())) >= processes, 60), "the run did not get so far"
        start = time.monotonic()
        running.send_signal(number)
        output, errors = running.communicate(timeout=20)
        seconds = time.monotonic() - start
    finally:
        running.kill()
    assert running.returncode == 1, (running.returncode, output, errors)
    assert seconds < 2
    assert "Cancelled by the user." in errors and "Traceback" not in output + errors
    assert json.loads(output) == {"type": "error", "kind": "Cancelled", "text": "Cancelled by the user."}
    assert wait_for(lambda: not family(mark.encode()), 0.5)
    assert not list(tmp_path.rglob("*.part*")) and not (tmp_path / "dsm.tif").exists()


def test_setup_has_nothing_to_do_a_second_time(tmp_path):
    if not (ROOT / ".venv" / "repm-environment.json").exists():
        pytest.skip("this checkout was not set up by its scripts/setup: run 'make setup'")
    subprocess.run([str(ROOT / "scripts" / "setup")], check=True, stdout=subprocess.PIPE)
    start = time.monotonic()
    done = subprocess.run([str(ROOT / "scripts" / "setup")], check=True, stdout=subprocess.PIPE, text=True)
    assert done.stdout == ""
    assert time.monotonic() - start < 1


def test_make_help_lists_the_targets():
    done = subprocess.run(
        ["make", "-C", str(ROOT), "--no-print-directory"], check=True, stdout=subprocess.PIPE, text=True
    )
    for target in ("help", "setup", "demo", "test", "lint", "package"):
        assert f"make {target} " in done.stdout


@pytest.mark.long
def test_another_python_first_on_path_does_not_end_qgis(headless, tmp_path):
    """As with conda, pyenv or a virtual environment: QGIS took its library's folder from this one."""
    (tmp_path / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}").mkdir(parents=True)
    (tmp_path / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "os.py").touch()
    fake = tmp_path / "bin" / "python3"
    fake.parent.mkdir()
    fake.write_text(f"#!/bin/sh\ntouch '{tmp_path / 'started'}'\nexit 3\n")
    fake.chmod(0o755)
    conda = {"CONDA_PREFIX": str(tmp_path), "PROJ_DATA": str(tmp_path / "share" / "proj"), "PYTHONHOME": str(tmp_path)}
    folder = tmp_path / "sample"
    done = headless(
        "--json",
        "run",
        "repm:sampledata",
        "--",
        "SIZE=128",
        f"FOLDER={folder}",
        PATH=f"{fake.parent}{os.pathsep}{os.environ['PATH']}",
        VIRTUAL_ENV=str(tmp_path),
        **conda,
    )
    assert done.returncode == 0, said(done)
    assert os.path.exists(json.loads(done.stdout)["results"]["TRUTH"])
    assert not (tmp_path / "started").exists()


def test_without_qgis_the_headless_script_says_what_to_do(tmp_path):
    for name in ("bash", "dirname", "readlink"):
        (tmp_path / name).symlink_to(shutil.which(name))
    done = subprocess.run(
        ["bash", str(ROOT / "scripts" / "qgis-headless"), "list"],
        env={"PATH": str(tmp_path), "HOME": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert done.returncode == 1 and "run 'make setup'" in done.stderr and "REPM_QGIS_PROCESS" in done.stderr
