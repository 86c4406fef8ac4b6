"""Many scenes in one run, with one that fails: figures against the files themselves, and runs that go on."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.batch.records import KeptScene, scene_key
from repm_qgis.contracts.errors import Cancelled, ClusterError, EmptyResultError, ImageError
from repm_qgis.contracts.stages import MOSAIC
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.stages import batch, run_stage
from tests.engine.pages import plain

pytestmark = pytest.mark.long
ROOT = Path(__file__).resolve().parents[3]


def bytes_of(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def features(path):
    """The fields of each feature by the scene's name, with its shape as WKT."""
    source = ogr.Open(path)
    found = {}
    for feature in source.GetLayer(0):
        shape = feature.GetGeometryRef()
        found[feature["scene"]] = {**feature.items(), "shape": shape.Clone() if shape is not None else None}
    return found


def verdict_in(report):
    """The heading of a scene's own report."""
    return re.search(r'role="note"><strong>([^<]*)</strong>', Path(report).read_text(encoding="utf-8"))[1]


def only(names, error=None):
    """A pipeline that refuses all scenes with one image, and those of ``names`` with ``error``; gives what it was asked
    for beside the first."""
    asked = []

    def stage(stage, job, progress):
        name = os.path.basename(job["workspace"])
        if name == "single":
            return run_stage(stage, job, progress)
        asked.append(name)
        if name not in names:
            pytest.fail(f"{name} was to be reused")
        raise error

    return stage, asked


@pytest.fixture(scope="module")
def sites(hamlet, tmp_path_factory):
    """Three subfolders with images: the town as a pair and as a triplet, and one image alone."""
    folder = tmp_path_factory.mktemp("sites")
    for name, count in (("pair", 2), ("single", 1), ("triplet", 3)):
        (folder / name).mkdir()
        for image in hamlet.images[:count]:
            shutil.copy(image, folder / name)
    return folder


@pytest.fixture(scope="module")
def options(sites, hamlet, tmp_path_factory):
    xmin, ymin, xmax, ymax = hamlet.bounds
    x, y = (xmin + xmax) / 2, (ymin + ymax) / 2
    return {
        "folder": str(sites),
        "workspace": str(tmp_path_factory.mktemp("many")),
        "extent": [x - 35, y - 35, x + 35, y + 35],
        "extent_crs": hamlet.crs,
        "resolution": 1.0,
        "workers": 1,
    }


@pytest.fixture(scope="module")
def first(options, told):
    """The first run, before any other of this module, with what it said and the bytes of its DSMs."""
    said = told()
    result = run_stage("batch", options, said)
    return result, said, {path: bytes_of(path) for path in result.dsms}


def test_a_scene_that_fails_does_not_stop_the_others(first, options):
    result, said, _ = first
    assert [each.scene for each in result.scenes] == ["pair", "single", "triplet"]
    assert (result.n_scenes, result.n_failed, result.n_reused) == (3, 1, 0)
    assert result.dsms == tuple(f"{options['workspace']}/{name}/dsm.tif" for name in ("pair", "triplet"))
    failed = result.scenes[1]
    assert (failed.verdict, failed.dsm, failed.report, failed.images) == ("failed", None, None, 1)
    assert "it must name at least two images: one image has no heights." in failed.error
    assert [warning.id for warning in said.warnings if warning.id.startswith("scenes-failed")] == ["scenes-failed"]
    assert any("'single' has no DSM: IMAGES is" in note for note in said.notes)
    assert said.fractions == sorted(said.fractions) and said.fractions[-1] == 1.0


def test_figures_of_the_layer_are_those_of_the_files(first, hamlet, options):
    result = first[0]
    rows = features(result.output)
    assert list(rows) == ["pair", "single", "triplet"]
    x, y = np.reshape(options["extent"], (2, 2)).mean(axis=0)
    middle = ogr.Geometry(ogr.wkbPoint)
    middle.AddPoint_2D(*geodetic_from_projected(hamlet.crs, np.array([x, y])))
    for name, pairs, images in (("pair", 1, 2), ("triplet", 3, 3)):
        row, folder = rows[name], Path(options["workspace"]) / name
        assert (row["pairs"], row["images"]) == (pairs, images)
        assert (row["dsm"], row["report"]) == (str(folder / "dsm.tif"), str(folder / "report.html"))
        confidence = gdal.Open(str(folder / "confidence.tif"))
        le90 = confidence.GetRasterBand(6).ReadAsArray()
        assert row["le90_m"] == pytest.approx(np.nanmedian(np.where(le90 == -9999, np.nan, le90)), abs=0.002)
        stated = gdal.Open(row["dsm"]).GetMetadataItem("REPM_HEIGHT_DEVIATION")
        assert row["height_deviation_m"] == pytest.approx(float(stated))
        in_report = re.search(r"\(([\d.]+) %\)", plain(Path(row["report"]).read_text(encoding="utf-8")))[1]
        assert row["valid_percent"] == pytest.approx(float(in_report), abs=0.06)
        heading = {"Good.": "good", "Look at:": "look"}.get(verdict_in(row["report"]), "doubt")
        assert row["verdict"] == heading and bool(row["findings"]) == (heading != "good")
        area = row["shape"].Clone()
        assert area.Contains(middle)
        assert area.GetArea() * 111_320**2 * np.cos(np.radians(middle.GetY())) == pytest.approx(4900, rel=0.05)
    assert rows["single"]["verdict"] == "failed" and "one image has no heights" in rows["single"]["error"]
    assert rows["single"]["shape"].Contains(middle)  # as its image says
    style = Path(result.output).with_suffix(".qml").read_text(encoding="utf-8")
    assert all(f'value="{word}"' in style for word in ("good", "look", "doubt", "failed"))


def test_the_page_leads_to_each_report_and_is_not_good(first, options):
    page = Path(first[0].report).read_text(encoding="utf-8")
    assert verdict_in(first[0].report) == "Do not use it before you have looked at:"
    assert "Scenes without a DSM: 1 of 3 (single)" in plain(page)
    links = re.findall(r'href="([^#"]+)"', page)
    assert links == ["pair/report.html", "triplet/report.html"]
    assert all((Path(options["workspace"]) / link).exists() for link in links)
    assert "one image has no heights" in plain(page) and page.count("data:image/png") == 2


def test_a_second_run_makes_only_what_is_not_complete(first, options, told, monkeypatch):
    _, _, before = first
    monkeypatch.setattr(batch, "run_stage", only(())[0])
    again = run_stage("batch", {**options, "workers": 2}, told())
    assert again.n_reused == 2 and again.n_failed == 1
    assert {path: bytes_of(path) for path in again.dsms} == before
    drop = dict(reused=False)
    assert [replace(each, **drop, seconds=0) for each in again.scenes] == [
        replace(each, **drop, seconds=0) for each in first[0].scenes
    ]
    assert features(again.output)["pair"]["verdict"] == features(first[0].output)["pair"]["verdict"]


@pytest.mark.parametrize("change", ("option", "product", "record", "engine"))
def test_what_has_changed_is_made_again(first, options, told, tmp_path, monkeypatch, change):
    given, folder = dict(options), tmp_path / "many"
    shutil.copytree(options["workspace"], folder, copy_function=shutil.copy2)
    given["workspace"] = str(folder)
    expected = {"option": ["pair", "triplet"], "engine": ["pair", "triplet"]}.get(change, ["pair"])
    pipeline, asked = only(expected, ImageError("No time now."))
    monkeypatch.setattr(batch, "run_stage", pipeline)
    if change == "option":
        given["fill"] = "none"
    elif change == "product":
        (folder / "pair" / "dsm.tif").write_bytes(b"")
    elif change == "record":
        record = folder / "pair" / "batch.json"
        values = json.loads(record.read_text())
        record.write_text(json.dumps({**values, "outcome": {**values["outcome"], "pairs": "many"}}))
    elif change == "engine":
        monkeypatch.setattr("repm_qgis.runtime.workspace.__version__", "0.0.0")
    if len(expected) == 2:
        with pytest.raises(EmptyResultError, match="None of 3 scenes has a DSM; the first, 'pair': No time now."):
            run_stage("batch", given, told())
    else:
        result = run_stage("batch", given, told())
        assert [each.error for each in result.scenes if each.scene == "pair"] == ["No time now."]
        assert result.n_reused == 1
        assert result.dsms == (str(folder / "triplet" / "dsm.tif"),)  # where it is now, whatever the record says
    assert asked == expected


def test_a_scene_s_key_changes_with_what_it_is_made_from_alone(sites, tmp_path):
    shutil.copytree(sites / "pair", tmp_path / "pair")
    mask, table = tmp_path / "mask.tif", tmp_path / "gcps.csv"
    for path in (mask, table):
        path.write_text("1")
    job = {
        "images": sorted(map(str, (tmp_path / "pair").iterdir())),
        "masks": [str(mask), ""],
        "gcps": str(table),
        "workspace": "a",
    }
    job["output"] = "a/dsm.tif"
    keys = [scene_key(job)]
    elsewhere = {"workspace": "b", "output": "b/dsm.tif", "workers": 3, "memory": 9, "cluster": "tcp://x:1"}
    for same in (elsewhere, {"fill": "occlusions", "resolution": 0.0, "dem": None, "preset": "none"}):
        assert scene_key({**job, **same}) == keys[0]  # QGIS gives each default, commands none
    for path in (table, mask, next((tmp_path / "pair").iterdir())):
        os.utime(path, ns=(1, 1))
        keys.append(scene_key(job))
    image = sorted((tmp_path / "pair").iterdir())[0]
    image.with_name(f"{image.stem}_RPC.TXT").write_text("LINE_OFF: 1")
    keys.append(scene_key(job))
    keys += [scene_key({**job, **more}) for more in ({"fill": "none"}, {"ortho": "ortho.tif"})]
    assert len(set(keys)) == len(keys) == 7


def test_records_of_others_are_data(first, options, told, tmp_path, monkeypatch):
    """A workspace may come from anybody: what a record names lies in its own folder, and what it claims is checked."""
    path = Path(options["workspace"]) / "pair" / "batch.json"
    values = json.loads(path.read_text())
    place = path.with_name("other.json")
    try:
        for damage in (
            {"files": {}},
            {"files": {"../triplet/dsm.tif": values["files"]["dsm.tif"]}},
            {"files": {**values["files"], "gone.tif": [1, 1]}},
            {"area": "POLYGON EMPTY"},
            {"outcome": 3},
        ):
            place.write_text(json.dumps({**values, **damage}))
            assert KeptScene.read(str(place), values["fingerprint"]) is None, damage
        place.write_text("[" * 100_000)
        assert KeptScene.read(str(place), values["fingerprint"]) is None
        place.write_text(json.dumps(values))
        assert KeptScene.read(str(place), "0" * 24) is None
        assert KeptScene.read(str(place), values["fingerprint"]).outcome.scene == "pair"
        place.write_text(json.dumps(values) + " " * (5 << 20))
        assert KeptScene.read(str(place), values["fingerprint"]) is None
    finally:
        place.unlink()


def test_a_bug_in_one_scene_does_not_stop_the_others(options, told, tmp_path, monkeypatch):
    real, said = run_stage, told()

    def sometimes(stage, job, progress):
        if os.path.basename(job["workspace"]) == "triplet":
            raise ZeroDivisionError("by nobody")
        return real(stage, job, progress)

    monkeypatch.setattr(batch, "run_stage", sometimes)
    result = run_stage("batch", {**options, "workspace": str(tmp_path), "products": []}, said)
    assert result.scenes[2].error == "This is a bug (ZeroDivisionError: by nobody): report it with the log."
    assert result.n_failed == 2 and result.scenes[0].le90_m is None
    assert any(note.startswith("Traceback") and "by nobody" in note for note in said.notes)


def test_a_run_that_is_cancelled_goes_on_and_ends_with_the_same_bytes(first, options, told, tmp_path, monkeypatch):
    given, real, made = {**options, "workspace": str(tmp_path)}, run_stage, []

    def cancelled_after_one(stage, job, progress):
        if made:
            raise Cancelled
        made.append(job)
        return real(stage, job, progress)

    monkeypatch.setattr(batch, "run_stage", cancelled_after_one)
    with pytest.raises(Cancelled):
        run_stage("batch", given, told())
    assert not (tmp_path / "scenes.gpkg").exists()
    assert set(features(str(tmp_path / "scenes_so_far.gpkg"))) == {"pair"}
    page = plain((tmp_path / "scenes_so_far.html").read_text(encoding="utf-8"))
    assert "1 of 3 scenes are here, and not yet single, triplet. If it was cancelled" in page
    assert verdict_in(tmp_path / "scenes_so_far.html") != "Good." and "complete before" in page
    monkeypatch.setattr(batch, "run_stage", real)
    result = run_stage("batch", given, told())
    assert not list(tmp_path.glob("scenes_so_far*")) and set(features(result.output)) == {"pair", "single", "triplet"}
    assert [each.reused for each in result.scenes] == [True, False, False]
    assert [bytes_of(path) for path in result.dsms] == list(first[2].values())


def test_a_lost_cluster_ends_the_run(options, told, tmp_path, monkeypatch):
    jobs = []

    def lost(stage, job, progress):
        jobs.append(job)
        raise ClusterError("The scheduler has ended.")

    monkeypatch.setattr(batch, "run_stage", lost)
    with pytest.raises(ClusterError):
        run_stage("batch", {**options, "workspace": str(tmp_path), "cluster": "tcp://127.0.0.1:1"}, told())
    assert [job["cluster"] for job in jobs] == ["tcp://127.0.0.1:1"]


@pytest.mark.slow
def test_the_workers_of_a_cluster_give_the_same_bytes(first, options, told, tmp_path):
    pytest.importorskip("distributed")
    from tests.engine.local_cluster import Cluster

    cluster = Cluster(tmp_path, 2)
    try:
        given = {**options, "workspace": str(tmp_path / "ws"), "cluster": cluster.address}
        result = run_stage("batch", given, told())
    finally:
        cluster.end()
    assert [bytes_of(path) for path in result.dsms] == list(first[2].values())


def test_a_mosaic_of_what_was_made_is_made_once(hamlet, told, tmp_path, monkeypatch):
    xmin, ymin, xmax, ymax = hamlet.bounds
    x, y = (xmin + xmax) / 2, (ymin + ymax) / 2
    rows = [f"west,{x - 40} {y - 25} {x + 10} {y + 25}", f"east,{x - 10} {y - 25} {x + 40} {y + 25}"]
    images = ";".join(hamlet.images[:2])
    table = tmp_path / "sites.csv"
    table.write_text("\n".join(["scene,extent,images", *(f"{row},{images}" for row in rows), "bad,,gone"]))
    mosaic = str(tmp_path / "all.tif")
    given = {"table": str(table), "workspace": str(tmp_path / "ws"), "mosaic": mosaic, "extent_crs": hamlet.crs}
    result = run_stage("batch", {**given, "workers": 1, "resolution": 1.0}, told())
    assert result.mosaic == mosaic and result.n_failed == 1
    whole = gdal.Open(mosaic)
    assert (whole.RasterXSize, whole.RasterYSize) == pytest.approx((80, 50), abs=2)
    before = bytes_of(mosaic)

    def only_bad(stage, job, progress):
        assert os.path.basename(job.get("workspace", "mosaic")) == "bad"
        raise ImageError("It is gone.")

    monkeypatch.setattr(batch, "run_stage", only_bad)
    assert run_stage("batch", {**given, "workers": 1, "resolution": 1.0}, told()).mosaic == mosaic
    assert bytes_of(mosaic) == before


def test_a_mosaic_that_cannot_be_made_is_a_finding(first, options, told, tmp_path, monkeypatch):
    def no_mosaic(stage, job, progress):
        if stage is MOSAIC:
            raise ImageError("They do not overlap.")
        return run_stage(stage, job, progress)

    monkeypatch.setattr(batch, "run_stage", no_mosaic)
    said = told()
    result = run_stage("batch", {**options, "mosaic": str(tmp_path / "m.tif")}, said)
    assert result.mosaic is None and not (tmp_path / "m.tif").exists()
    assert "There is no mosaic: They do not overlap." in map(str, said.warnings)
    assert "There is no mosaic" in Path(result.report).read_text(encoding="utf-8")


def test_the_command_line_has_it(options):
    given = [f"--{name}={options[name]}" for name in ("folder", "workspace", "resolution")]
    given += ["--extent", *map(str, options["extent"]), "--extent-crs", options["extent_crs"], "--workers", "1"]
    run = "from repm_qgis.command_line import main; raise SystemExit(main())"
    shown = subprocess.run([sys.executable, "-c", run, "batch", *given], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert shown.returncode == 0
    assert "n_failed: 1" in shown.stdout and f"output: {options['workspace']}/scenes.gpkg" in shown.stdout
