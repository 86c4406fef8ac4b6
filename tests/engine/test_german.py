"""With German as its reader's language, a run says nothing in English, and makes the same results to the byte."""

from __future__ import annotations

import html
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import OptionError, RepmError
from repm_qgis.runtime.translation import Translator, written_in
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.english import english_in

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
PRODUCTS = ("output", "confidence", "ortho")


class Heard:
    """A progress that keeps what a reader sees, in German."""

    def __init__(self):
        self.texts, self.german = [], Translator.of("de")

    def step(self, fraction, text=""):
        self.info(text)

    def info(self, text):
        self.texts.append(self.german.translate(text))

    warn = info

    def check_cancelled(self):
        pass


def engine(stage, folder, **job):
    """The engine's lines for a job, as headless users run it; LANG is German and must not matter."""
    path = folder / "job.json"
    path.write_text(json.dumps(job))
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "LANG": "de_DE.UTF-8", "LANGUAGE": "de"}
    command = [sys.executable, "-m", "repm_qgis", stage, str(path)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder, heard = tmp_path_factory.mktemp("sample"), Heard()
    with written_in("de"):
        made = run_stage("sampledata", {"folder": str(folder), "size": 256}, heard)
    assert not english_in(heard.texts)
    return made


def run(sample, folder, **more):
    paths = {name: str(folder / f"{name}.tif") for name in PRODUCTS}
    job = {"images": sample.images, "workspace": str(folder / "work"), **paths, "command": "repm", **more}
    return engine("pipeline", folder, **job), paths


@pytest.fixture(scope="module")
def german(sample, tmp_path_factory):
    """The engine's lines of a German run, and its folder."""
    folder = tmp_path_factory.mktemp("german")
    return (*run(sample, folder, language="de"), folder)


def pieces(page: Path):
    """The texts that a page shows."""
    body = re.sub(r"<style.*?</style>|<pre>.*?</pre>", "", page.read_text(encoding="utf-8"), flags=re.S)
    return [html.unescape(piece).strip() for piece in re.findall(r">([^<>]+)<", body)]


def test_a_run_is_logged_in_german(german):
    lines, _, _ = german
    assert lines[-1]["type"] == "result", lines[-1]
    texts = [line["text"] for line in lines[:-1]]
    assert len(texts) > 20 and any("Verknüpfungspunkte" in text for text in texts)
    assert not english_in(texts) and "Rekonstruktion: beginnt" in texts


def test_its_report_and_legends_are_german(german):
    _, _, folder = german
    report = folder / "work" / "report.html"
    assert '<html lang="de">' in report.read_text(encoding="utf-8")
    assert not english_in(pieces(report)) and len(pieces(report)) > 100
    styles = list(folder.rglob("*.qml"))
    labels = {html.unescape(label) for style in styles for label in re.findall(r' label="([^"]*)"', style.read_text())}
    assert any("bis 0,1 px" in label for label in labels) and not english_in(labels)
    assert any("<!-- language: de -->" in style.read_text() for style in styles)


@pytest.mark.slow
def test_the_language_changes_no_byte_of_the_results(german, sample, tmp_path):
    lines, made, _ = german
    others, paths = run(sample, tmp_path)
    assert english_in(line.get("text", "") for line in others)  # without a language in the job, whatever LANG says
    for name in PRODUCTS:
        assert Path(paths[name]).read_bytes() == Path(made[name]).read_bytes(), name
    results = [{key: value for key, value in each[-1]["result"].items()} for each in (lines, others)]
    assert results[0].keys() == results[1].keys()
    same = [key for key, value in results[0].items() if isinstance(value, (int, float)) and key != "seconds"]
    assert len(same) > 3 and [results[0][key] for key in same] == [results[1][key] for key in same]


@pytest.mark.slow
def test_a_run_that_reuses_all_writes_pages_and_legends_in_the_language_that_is_asked_for(german, sample):
    _, _, folder = german
    legends = [folder / "work" / name for name in ("tiles.qml", "reconstructed_tie_points.qml")]
    before = [legend.read_text(encoding="utf-8") for legend in legends]
    run(sample, folder)
    assert all("language: de" not in legend.read_text(encoding="utf-8") for legend in legends)
    assert '<html lang="en">' in (folder / "work" / "report.html").read_text(encoding="utf-8")
    run(sample, folder, language="de")
    assert [legend.read_text(encoding="utf-8") for legend in legends] == before


def test_every_stage_says_and_reports_in_german(german, sample, tmp_path):
    work = german[2] / "work"
    scene, refined, matched = (str(work / f"{name}.json") for name in ("scene", "refined", "reconstructed"))
    dsm, report = german[1]["output"], lambda stage: str(tmp_path / f"{stage}.html")
    jobs = {
        "epmfit": {"images": sample.images, "workspace": str(work)},
        "errormap": {"scene": scene, "output": str(tmp_path / "error.tif")},
        "refine": {"scene": scene, "output_scene": refined},
        "comparedsm": {"dsm": dsm, "reference": sample.truth, "error": str(tmp_path / "e.tif")},
        "checkgcps": {"gcps": sample.gcps, "scene": matched, "dsm": dsm, "output": str(tmp_path / "gcps.gpkg")},
        "exportrpc": {"scene": matched, "rpc_folder": str(tmp_path / "rpcs")},
        "environment": {},
        "mosaic": {"dsms": [dsm, sample.truth], "output": str(tmp_path / "mosaic.tif")},
        "inspect": {"images": sample.images},
    }
    for stage, job in jobs.items():
        heard = Heard()
        with written_in("de"):
            run_stage(stage, {**job, "report": report(stage)}, heard)
        assert not english_in(heard.texts), stage
        assert not english_in(pieces(Path(report(stage)))), stage
    heard = Heard()
    run_stage("exportcameras", {"scene": refined, "folder": str(tmp_path / "export"), "format": "mvsnet"}, heard)
    assert not english_in(heard.texts)
    labels = re.findall(r' label="([^"]*)"', (tmp_path / "gcps.qml").read_text(encoding="utf-8"))
    assert labels and not english_in(map(html.unescape, labels))


def moved_truth(sample, path, metres, stated=True):
    """The true surface at another place and height; it may say what its heights refer to."""
    source = gdal.Open(sample.truth)
    x, width, _, y, _, height = source.GetGeoTransform()
    made = gdal.Translate(str(path), source, noData="nan")
    made.SetGeoTransform((x + metres[0], width, 0, y + metres[1], 0, height))
    made.GetRasterBand(1).WriteArray(source.ReadAsArray() + metres[2])
    if not stated:
        made.SetMetadataItem("VERTICAL_DATUM", None)
    return str(path)


@pytest.mark.slow
def test_a_registration_and_what_follows_it_are_german(german, sample, tmp_path):
    """With references that contradict each other and a shift beyond all promises: as much is said as can be."""
    matched = str(german[2] / "work" / "reconstructed.json")
    files = {"output_scene": "registered.json", "differences": "differences.tif", "offsets": "o.gpkg"}
    report, other = tmp_path / "register.html", tmp_path / "other.json"
    Scene.load(matched).save(str(other))
    job = {
        "scene": matched,
        "others": [str(other)],
        "reference": [
            moved_truth(sample, tmp_path / "a.tif", (21, -14, 4), stated=False),
            moved_truth(sample, tmp_path / "b.tif", (21, -14, 9)),
        ],
        "report": str(report),
        **{name: str(tmp_path / file) for name, file in files.items()},
    }
    heard = Heard()
    with written_in("de"):
        run_stage("register", job, heard)
    for said in (
        "nennt keinen Höhenbezug",
        "laut Datei",
        "widersprechen einander",
        "Die Verschiebung um",
        "überlappen",
    ):
        assert any(said in text for text in heard.texts), (said, heard.texts)
    texts = pieces(report)
    assert "bestimmt" in texts and "Messflecke" in " ".join(texts)
    styles = [(tmp_path / name).read_text(encoding="utf-8") for name in ("differences.qml", "o.qml")]
    labels = [html.unescape(label) for style in styles for label in re.findall(r' label="([^"]*)"', style)]
    assert any("Verschiebung in der Lage" in label for label in labels)
    exported = Heard()
    with written_in("de"):
        run_stage("exportrpc", {"scene": job["output_scene"], "rpc_folder": str(tmp_path / "rpcs")}, exported)
        again = {**job, "report": str(tmp_path / "again.html")}
        run_stage("register", again, exported)
    assert any("wiederverwendet" in text for text in exported.texts)
    for found in (heard.texts, texts, labels, exported.texts, pieces(tmp_path / "again.html")):
        assert not english_in(found)


@pytest.mark.parametrize(
    "stage, job",
    [
        ("register", {"scene": "gone.json", "reference": ["gone.tif"], "output_scene": "r.json"}),
        ("register", {"scene": "gone.json", "reference": [], "output_scene": "r.json"}),
        ("register", {"scene": "gone.json", "reference": ["a.tif"], "others": ["gone.json"], "output_scene": "r.json"}),
        ("exportrpc", {"scene": "gone.json", "rpc_folder": "rpcs"}),
        ("epmfit", {"images": ["a.tif", "b.tif"], "workspace": "w"}),
        ("epmfit", {"images": ["a.tif"], "workspace": "w"}),
        ("epmfit", {"images": ["a.tif", "b.tif"], "workspace": "w", "tile_size": 7}),
        ("epmfit", {"images": "a.tif"}),
        ("dsmfuse", {"scene": "gone.json", "output": "dsm.tif"}),
        ("dsmfuse", {"scene": "gone.json", "output": "dsm.tif", "method": "best"}),
        ("dsmfuse", {"scene": "gone.json", "output": "dsm.tif", "colour": "red"}),
        ("comparedsm", {"dsm": "gone.tif", "reference": "gone.tif"}),
        ("nothing", {}),
    ],
)
def test_errors_are_german_and_keep_their_kind(stage, job, told):
    """As the engine's process writes them: see the test that follows."""
    errors = []
    for language in ("de", "en"):
        with written_in(language), pytest.raises(RepmError) as caught:
            run_stage(stage, job, told())
        errors.append(caught.value)
    german, english = errors
    assert type(german) is type(english) and english_in([str(english)])
    assert not english_in([Translator.of("de").translate(str(german))])


def test_points_of_an_image_that_is_not_there_are_said_in_german(sample, tmp_path):
    gcps = tmp_path / "gcps.csv"
    gcps.write_text(Path(sample.gcps).read_text(encoding="utf-8").replace("img_0", "foto_0"), encoding="utf-8")
    job = {"images": sample.images[:2], "gcps": str(gcps), "workspace": str(tmp_path), "output": "dsm.tif"}
    *_, said = engine("pipeline", tmp_path, **job, language="de")
    assert said["type"] == "error" and "wurden in foto_01" in said["text"] and "in keinem der Bilder" in said["text"]
    assert not english_in([said["text"]])


def test_a_language_must_be_a_code():
    with pytest.raises(OptionError, match="language"), written_in("Deutsch, bitte"):
        pass
