"""The command ``repm``: its options are those of options.py, and it runs as from a wheel, without the plugin."""

from __future__ import annotations

import json
import os
import re
import select
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from repm_qgis import command_line
from repm_qgis.contracts.options import PRESETS, EpmFitOptions, PipelineOptions
from repm_qgis.stages import STAGES

ROOT = Path(__file__).resolve().parents[2]


def jobs_of(monkeypatch, *arguments):
    """The stage and the job that a command line stands for."""
    found = []
    monkeypatch.setattr(command_line, "serve", lambda lines, begin: found.append(begin(None)()) or 0)
    assert command_line.main(arguments) == 0
    return found[0]


def value_of(stage, name):
    """A value that an option may have, other than its default, and its words on the command line."""
    options = STAGES[stage].options
    kind, check = options.kind_of(name), options.option(name).metadata.get("check")
    default = options.option(name).default
    if kind is bool:
        return not default, [f"--{'no-' if default else ''}{name.replace('_', '-')}"]
    flag = f"--{name.replace('_', '-')}"
    if hasattr(check, "choices"):
        return check.choices[-1], [flag, check.choices[-1]]
    if kind in (int, float):
        value = kind(check.low + 1)
        return value, [flag, str(value)]
    if kind is str:
        return f"{name} ä", [flag, f"{name} ä"]
    items = [1.0, 2.0, 3.0, 4.0] if name in ("extent", "thresholds") else ["a b.tif", "c.tif"]
    return items, [flag, *map(str, items)]


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.long
def test_every_option_of_a_stage_can_be_given_and_is_explained(stage, monkeypatch, capsys):
    given = {name: value_of(stage, name) for name in STAGES[stage].options.names()}
    words = [word for _, more in given.values() for word in more]
    assert jobs_of(monkeypatch, stage, *words) == (stage, {name: value for name, (value, _) in given.items()})
    with pytest.raises(SystemExit):
        command_line.main([stage, "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert "``" not in said and "==SUPPRESS==" not in said
    for name in given:
        assert f"--{name.replace('_', '-')}" in said


def test_what_is_not_given_is_left_to_the_engine_and_its_presets(monkeypatch):
    images = ["--images", "a.tif", "b.tif", "--workspace", "w", "--output", "d.tif"]
    stage, job = jobs_of(monkeypatch, "pipeline", *images, "--preset", "mountains")
    assert set(job) == {"images", "workspace", "output", "preset"}
    assert PipelineOptions.from_json(job).fuse.fill == PRESETS["mountains"]["fill"] == "all"


def test_the_help_has_meaning_bounds_and_default(capsys):
    with pytest.raises(SystemExit):
        command_line.main(["epmfit", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    check = EpmFitOptions.option("tile_size").metadata["check"]
    assert f"the largest that keeps the equivalent error under error_budget px; {check.low} to {check.high} px" in said
    assert said.count("in metres above the ellipsoid; None takes the DEM's range, or the RPCs'; -12000 to 10000 m") == 2


def test_the_help_of_an_option_is_its_own(capsys):
    """A sentence about several options is no help for each of them."""
    for stage, option, told in (
        ("dtm", "largest", "the width of the largest object; 2 to 500 m; default: 150.0"),
        ("dtm", "slope", "the steepest ground; 5 to 300 %; default: 40.0"),
        ("buildings", "min-area", "its least area; 4 to 1000000 m2; default: 50.0"),
        ("register", "workers", "0 means one for each core; 0 to 1024; default: 0"),
        ("change", "cluster", "the address or the scheduler file of a Dask cluster whose workers do the work;"),
        ("dsmfuse", "mesh", "files to write, None = not wanted"),
    ):
        with pytest.raises(SystemExit):
            command_line.main([stage, "--help"])
        said = " ".join(capsys.readouterr().out.split("options:")[1].split())
        own = re.split(r" --[a-z]", said.partition(f"--{option} ")[2])[0]
        assert told in own and len(own) < 200, (stage, own)


def test_a_job_file_has_options_over_which_those_of_the_command_line_go(tmp_path, monkeypatch):
    job = tmp_path / "job.json"
    job.write_text(json.dumps({"dsm": "a.tif", "viewer": "a.html", "cells": 20_000}), encoding="utf-8")
    words = ("viewer", "--job", str(job), "--viewer", "b.html", "--language", "de")
    expected = {"dsm": "a.tif", "viewer": "b.html", "cells": 20_000, "language": "de"}
    assert jobs_of(monkeypatch, *words) == ("viewer", expected)


@pytest.fixture(scope="module")
def as_wheel(tmp_path_factory):
    """The package with its data as pyproject.toml puts them into the wheel, and nothing of the plugin beside it."""
    folder = tmp_path_factory.mktemp("site-packages")
    shutil.copytree(ROOT / "repm_qgis", folder / "repm_qgis", ignore=shutil.ignore_patterns("__pycache__"))
    section = (ROOT / "pyproject.toml").read_text(encoding="utf-8").partition("force-include]\n")[2].partition("\n[")[0]
    for source, target in re.findall(r'(?m)^"(.+)" = "(.+)"$', section):
        place = folder / target
        place.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if (ROOT / source).is_dir() else shutil.copy)(ROOT / source, place)
    return folder


def run(folder, *arguments, **more):
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-m", "repm_qgis.command_line", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, encoding="utf-8", **more)


@pytest.fixture(scope="module")
def images(as_wheel, tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    done = run(as_wheel, "sampledata", "--folder", str(folder), "--size", "200", "--seed", "3", cwd=folder)
    assert done.returncode == 0, done.stderr
    found = [line[8:] for line in done.stdout.splitlines() if line.startswith("images: ")]
    assert len(found) == 3 and all(os.path.exists(path) for path in found)
    assert re.search(r"(?m)^ *\d+% ", done.stderr)
    return found


@pytest.mark.long
def test_reports_and_languages_come_with_the_package(as_wheel, images, tmp_path):
    arguments = ("inspect", "--images", *images, "--report", "page.html", "--language", "de")
    done = run(as_wheel, *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert '<html lang="de">' in page and "Bild" in page
    assert '<abbr class="term"' in page  # of the German glossary


def test_a_failure_is_one_sentence_and_a_mistake_in_a_word_is_the_parsers(as_wheel, tmp_path):
    done = run(as_wheel, "errormap", "--scene", "none.json", "--output", "e.tif", cwd=tmp_path)
    assert done.returncode == 1 and done.stdout == ""
    assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith("repm: ") and "none.json" in done.stderr
    assert run(as_wheel, "errormap", "--altitude", "high", cwd=tmp_path).returncode == 2
    missing = run(as_wheel, "errormap", cwd=tmp_path)
    assert missing.returncode == 1 and "SCENE" in missing.stderr


def test_a_missing_package_of_a_wheel_is_not_for_qgis_to_install(as_wheel, tmp_path):
    (tmp_path / "osgeo.py").write_text("raise ModuleNotFoundError(\"No module named 'osgeo'\", name='osgeo')\n")
    place = f"{tmp_path}{os.pathsep}{as_wheel}"
    done = run(place, "inspect", "--images", "a.tif", cwd=tmp_path)
    assert done.returncode == 1 and "'osgeo' is not installed" in done.stderr
    assert "install it with pip, but GDAL's bindings with the system's packages or with conda" in done.stderr


def test_programs_get_lines_of_json(as_wheel, images, tmp_path):
    done = run(as_wheel, "inspect", "--json", "--images", *images, cwd=tmp_path)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0 and lines[-1]["type"] == "result" and lines[-1]["result"]["PAIR".lower()]


@pytest.mark.parametrize(
    ("words", "kind", "sentence", "code"),
    [
        (["epmfit", "--images", "gone.tif", "--workspace", "w"], "ImageError", "Cannot open the raster 'gone.tif'", 1),
        (["errormap", "--job", "gone.json"], "OptionError", "job is 'gone.json'", 1),
        (["pipeline", "--fill", "everything"], "OptionError", "argument --fill: invalid choice: 'everything'", 2),
        (["inspect", "--tile-size", "3"], "OptionError", "unrecognized arguments: --tile-size 3", 2),
        (["epm"], "OptionError", "invalid choice: 'epm'", 2),
    ],
)
def test_programs_get_errors_as_json_too(as_wheel, tmp_path, words, kind, sentence, code):
    done = run(as_wheel, *words, "--json", cwd=tmp_path)
    error = json.loads(done.stdout)  # one document
    assert (error["type"], error["kind"], done.returncode) == ("error", kind, code)
    assert sentence in error["text"] and (code == 1 or error["text"] in done.stderr)
    assert not run(as_wheel, *words, cwd=tmp_path).stdout


@pytest.mark.skipif(os.name == "nt", reason="Windows has no pseudo-terminals")
@pytest.mark.long
def test_a_terminal_shows_a_bar_that_leaves_nothing_behind(as_wheel, tmp_path):
    import pty

    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "repm_qgis.command_line", "sampledata", "--folder", "made", "--size", "150"]
    environment = {**os.environ, "PYTHONPATH": str(as_wheel)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, env=environment, cwd=tmp_path) as process:
        os.close(theirs)
        shown = b""
        while select.select([ours], [], [], 60)[0]:
            try:
                piece = os.read(ours, 4096)
            except OSError:  # its end on Linux
                break
            if not piece:
                break
            shown += piece
        result = process.stdout.read().decode()
    os.close(ours)
    text = shown.decode()
    assert process.returncode == 0 and "/made\nimages: " in result
    bars = re.findall(r"\r\[(#*)\.*\] +(\d+)%", text)
    assert len(bars) >= 3 and [len(bar) for bar, _ in bars] == sorted(len(bar) for bar, _ in bars)
    assert re.search(r"\r +\r3 images of 150 x 150 px", text) and text.rpartition("\n")[2].strip("\r ") == ""


def test_names_of_files_cannot_move_the_cursor():
    assert command_line.result_lines({"output": "a\x1b[2Jb.tif", "pairs": [1], "images": ["ü.tif"], "no": None}) == [
        "output: a?[2Jb.tif",
        "images: ü.tif",
    ]
