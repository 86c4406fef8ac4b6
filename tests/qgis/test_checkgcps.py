"""Ground control in QGIS: tables and layers of all kinds, repm:checkgcps, and a pipeline with control points."""

from __future__ import annotations

import csv
import json
import sys

import pytest
from osgeo import gdal, ogr
from qgis.core import (
    QgsApplication,
    QgsFeature,
    QgsGeometry,
    QgsPointXY,
    QgsProcessingContext,
    QgsProject,
    QgsVectorLayer,
)


def said(done):
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def fitted(sample, tmp_path_factory):
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    folder = tmp_path_factory.mktemp("fitted")
    return run_stage("epmfit", {"images": sample.images, "workspace": str(folder)}, Silent()).scene


@pytest.mark.long
def test_checkgcps_from_the_command_line(headless, sample, fitted, tmp_path):
    done = headless(
        "--json",
        "run",
        "repm:checkgcps",
        "--",
        f"GCPS={sample.gcps}",
        f"SCENE={fitted}",
        f"DSM={sample.truth}",
        f"OUTPUT={tmp_path / 'points.gpkg'}",
        f"REPORT={tmp_path / 'r.html'}",
    )
    assert done.returncode == 0, said(done)
    results = json.loads(done.stdout)["results"]
    assert results["DSM_RMSE"] < 0.05 < results["COMPENSATED_RMSE"] < 3
    assert 0 < results["RPC_MEDAE"] <= results["RPC_MAX"] and "SCENE_MEDAE" not in results
    assert (tmp_path / "points.qml").exists() and "ISPRS" not in (tmp_path / "r.html").read_text(encoding="utf-8")
    # What a script computes from the layer is what the numbers say.
    source = ogr.Open(results["OUTPUT"])
    heights = [feature["rpc_h"] for feature in source.GetLayer(0)]
    source = None  # noqa: F841
    assert max(abs(height) for height in heights if height is not None) == pytest.approx(results["RPC_MAX"])
    assert len(heights) == len({row["id"] for row in rows_of(sample)})


@pytest.mark.long
def test_checkgcps_needs_only_a_dsm(headless, sample, tmp_path):
    done = headless(
        "--json",
        "run",
        "repm:checkgcps",
        "--",
        f"GCPS={sample.gcps}",
        f"DSM={sample.truth}",
        f"OUTPUT={tmp_path / 'points.gpkg'}",
    )
    assert done.returncode == 0, said(done)
    results = json.loads(done.stdout)["results"]
    assert results["DSM_MAX"] < 0.2 and not [name for name in results if name.startswith(("RPC", "SCENE", "COMP"))]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["DSM=", "SCENE="], "SCENE is empty: it must be given, or DSM, or both"),
        (["GCPS=gone.csv", "DSM=truth"], "GCPS 'gone.csv' is not there"),
        (["DSM=truth", "GCP_DATUM=sea level"], "GCP_DATUM is 'sea level'"),
    ],
)
@pytest.mark.long
def test_user_errors_are_one_sentence(headless, sample, tmp_path, words, sentence):
    given = [word.replace("truth", sample.truth) for word in words if not word.endswith("=")]
    table = [] if any(word.startswith("GCPS") for word in given) else [f"GCPS={sample.gcps}"]
    done = headless("run", "repm:checkgcps", "--", *table, *given, f"OUTPUT={tmp_path / 'points.gpkg'}")
    assert done.returncode == 1, said(done)
    assert sentence in said(done) and "Traceback" not in said(done)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_pipeline_with_control_points_is_where_the_truth_is(headless, town, tmp_path):
    done = headless(
        "--json",
        "run",
        "repm:pipeline",
        "--",
        *(f"IMAGES={path}" for path in town.images),
        f"GCPS={town.gcps}",
        "POINTING=shift",
        "RESOLUTION=0.5",
        f"WORKSPACE={tmp_path / 'w'}",
        f"OUTPUT={tmp_path / 'dsm.tif'}",
        f"TIE_POINTS={tmp_path / 'ties.gpkg'}",
        REPM_ENGINE_PYTHON=sys.executable,
    )
    assert done.returncode == 0, said(done)
    page = (tmp_path / "w" / "report.html").read_text(encoding="utf-8")
    assert "Absolute position" in page and f"GCPS={town.gcps}" in page and "POINTING=shift" in page
    ties = ogr.Open(str(tmp_path / "ties.gpkg"))
    names = {field.GetName() for field in ties.GetLayer(0).schema}
    ties = None  # noqa: F841
    assert {"track", "views", "height", "residual", "before", "row", "direction"} <= names
    checked = headless(
        "--json",
        "run",
        "repm:checkgcps",
        "--",
        f"GCPS={town.gcps}",
        f"DSM={tmp_path / 'dsm.tif'}",
        f"SCENE={tmp_path / 'w' / 'reconstructed.json'}",
        f"OUTPUT={tmp_path / 'points.gpkg'}",
    )
    assert checked.returncode == 0, said(checked)
    results = json.loads(checked.stdout)["results"]
    assert results["SCENE_RMSE"] < 1.0 and results["DSM_MEDAE"] < 0.6
    compared = headless(
        "--json", "run", "repm:comparedsm", "--", f"DSM={tmp_path / 'dsm.tif'}", f"REFERENCE={town.truth}"
    )
    assert compared.returncode == 0, said(compared)
    assert json.loads(compared.stdout)["results"]["MEDAE"] < 0.5  # not aligned


def rows_of(sample):
    with open(sample.gcps, encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture
def memory_layer(sample):
    """The table's rows as a layer that is no file, in its own field order."""
    layer = QgsVectorLayer(
        "Point?crs=EPSG:4326&field=fid:integer&field=id:string&field=height:double&field=view:string"
        "&field=col:double&field=row:double&field=role:string",
        "drawn points",
        "memory",
    )
    features = []
    for number, row in enumerate(rows_of(sample)):
        feature = QgsFeature(layer.fields())
        feature.setGeometry(QgsGeometry.fromPointXY(QgsPointXY(float(row["lon"]), float(row["lat"]))))
        feature.setAttributes(
            [
                number % 3,
                row["id"],
                float(row["height"]),
                row["view"],
                float(row["col"]),
                float(row["row"]),
                row["role"],
            ]
        )
        features.append(feature)
    layer.dataProvider().addFeatures(features)
    return layer


def run_with(value, fitted, folder, feedback, context=None):
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:checkgcps").create()
    context = context or QgsProcessingContext()
    values = {"GCPS": value, "SCENE": fitted, "OUTPUT": str(folder / "points.gpkg")}
    fine, text = algorithm.checkParameterValues(values, context)
    assert fine, text
    results, fine = algorithm.run(values, context, feedback, catchExceptions=False)
    assert fine
    return results


def same(one, other):
    return all(one[name] == pytest.approx(other[name], abs=1e-6) for name in one if name.startswith(("RPC", "COMP")))


def test_a_layer_that_is_no_file_gives_what_the_table_gives(plugin, sample, fitted, memory_layer, tmp_path, feedback):
    table = run_with(sample.gcps, fitted, tmp_path, feedback)
    drawn = run_with(memory_layer, fitted, tmp_path, feedback)
    assert table["RPC_RMSE"] > 0 and same(table, drawn)


def test_a_projects_layer_goes_by_its_id_and_a_filter_counts(plugin, sample, fitted, tmp_path, feedback):
    from repm.processing_provider.values import points_path

    path = str(tmp_path / "gcps.gpkg")
    gdal.UseExceptions()
    dataset = gdal.VectorTranslate(path, sample.gcps, layerName="surveyed", format="GPKG")
    gdal.VectorTranslate(path, sample.gcps, layerName="others", format="GPKG", accessMode="append")
    dataset = None  # noqa: F841
    layer = QgsVectorLayer(f"{path}|layername=surveyed", "surveyed", "ogr")
    assert layer.isValid()
    project = QgsProject()
    project.addMapLayer(layer)
    context = QgsProcessingContext()
    context.setProject(project)
    assert points_path(layer.id(), context) == f"{path}|layername=surveyed"
    assert points_path(f"{path}|layername=surveyed", context) == f"{path}|layername=surveyed"
    layer.setSubsetString("role = 'check'")
    copy = points_path(layer.id(), context)
    assert copy != path and copy.endswith("points.gpkg")
    result = QgsVectorLayer(copy, "copy", "ogr")
    assert result.featureCount() == sum(row["role"] == "check" for row in rows_of(sample))
    project.clear()


@pytest.mark.parametrize(
    ("query", "plain"), (("", True), ("?type=csv&xField=lon&yField=lat&crs=EPSG:4326", False), ("?delimiter=;", False))
)
def test_a_text_layer_is_its_file_or_a_copy(plugin, sample, fitted, tmp_path, feedback, query, plain):
    from repm.processing_provider.values import points_path

    path = tmp_path / "gcps.csv"
    text = open(sample.gcps, encoding="utf-8").read()
    path.write_text(text.replace(",", ";") if ";" in query else text, encoding="utf-8")
    layer = QgsVectorLayer(f"file://{path}{query}", "table", "delimitedtext")
    assert layer.isValid()
    found = points_path(layer, QgsProcessingContext())
    assert (found == str(path)) == plain
    assert same(run_with(sample.gcps, fitted, tmp_path, feedback), run_with(layer, fitted, tmp_path, feedback))


@pytest.mark.long
def test_rpc_files_are_named_in_the_images_order(plugin, sample, tmp_path, feedback):
    """Copies of the images without tags, and their RPCs in files that no convention finds."""
    gdal.UseExceptions()
    images, files = [], []
    for number, path in enumerate(sample.images[:2]):
        source = gdal.Open(path)
        pixels, tags = source.ReadAsArray(), source.GetMetadata("RPC")
        source = None
        images.append(str(tmp_path / f"bare{number}.tif"))
        bare = gdal.GetDriverByName("GTiff").Create(images[-1], *pixels.shape[::-1], 1, gdal.GDT_UInt16)
        bare.GetRasterBand(1).WriteArray(pixels)
        bare = None  # noqa: F841
        lines = []
        for key, value in tags.items():
            if key.endswith("COEFF"):
                lines += [f"{key}_{k}: {word}" for k, word in enumerate(value.split(), start=1)]
            elif key.endswith(("OFF", "SCALE")):
                lines.append(f"{key}: {value}")
        (tmp_path / f"rpcs_{number}.txt").write_text("\n".join(lines) + "\n")
        files.append(str(tmp_path / f"rpcs_{number}.txt"))
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:epmfit").create()
    context = QgsProcessingContext()
    values = {"IMAGES": images, "RPCS": files, "WORKSPACE": str(tmp_path / "w"), "TILES": str(tmp_path / "t.gpkg")}
    results, fine = algorithm.run(values, context, feedback, catchExceptions=False)
    assert fine and results["RMSE"] > 0
    views = json.loads((tmp_path / "w" / "scene.json").read_text())["views"]
    original = gdal.Open(sample.images[1]).GetMetadata("RPC")
    assert views[1]["rpc"]["col_off"] == pytest.approx(float(original["SAMP_OFF"]))
    fine, text = algorithm.checkParameterValues({**values, "RPCS": [files[0], "gone.rpb"]}, context)
    assert not fine and "RPCS 'gone.rpb' is not there" in text
