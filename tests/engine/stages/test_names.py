"""Names of files and folders are data: no character of theirs means anything to a report, a layer or a format."""

from __future__ import annotations

import csv
import json
import os
import shutil
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.options import CAMERA_FORMATS, EpmFitOptions
from repm_qgis.files.vector import file_and_layer, open_vector
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.engine.pages import checked

# Signs of HTML, XML, SQL, shells, templates, QGIS's and GDAL's URIs; a line break, another script, a leading dash.
WORST = ("-a&b<c>\"d'", "one=1 {x}%41{{y}}|layername=b\nä", "*[a]?#$(x);`]]>\\")
PREFIX = "".join(WORST)


@pytest.fixture(scope="module")
def named(urban, told, tmp_path_factory):
    """urban_run again, with the worst names for all that has one: its results, and the function that names a file."""
    folder = tmp_path_factory.mktemp("names") / PREFIX
    folder.mkdir()
    images = [str(folder / f"{name}.tif") for name in WORST]
    for image, copy in zip(urban.images, images):
        shutil.copy(image, copy)

    def name(end):
        return str(folder / f"{PREFIX}{end}")

    files = {
        "output": "dsm.tif",
        "confidence": "confidence.tif",
        "ortho": "ortho.tif",
        "cloud": "cloud.laz",
        "ept": "ept",
        "mesh": "mesh.ply",
        "tiles": "tiles.gpkg",
        "tie_points": "ties.gpkg",
        "report": "report.html",
    }
    made = run_stage(
        "pipeline",
        {
            "images": images,
            "workspace": name("work"),
            "command": f"qgis_process '{PREFIX}",
            "resolution": 0.5,
            "tile_size": 256,
            "workers": 1,
            **{option: name(end) for option, end in files.items()},
        },
        told(),
    )
    return made, name


@pytest.mark.skipif(os.name == "nt", reason="Windows refuses such names itself")
@pytest.mark.slow
def test_the_worst_names_change_nothing(named, urban, urban_run, told):
    made, name = named
    same, wanted = (gdal.Open(path).ReadAsArray() for path in (made.output, urban_run.result.output))
    assert np.array_equal(same, wanted, equal_nan=True)
    with open(urban.made.gcps, encoding="utf-8", newline="") as stream:
        heads, *rows = csv.reader(stream)
    views = {Path(image).stem: view for image, view in zip(urban.images, WORST)}
    column = heads.index("view")
    rows = [[*row[:column], views.get(row[column], ""), *row[column + 1 :]] for row in rows]
    with open(name("gcps.csv"), "w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows([heads, *rows])
    asked = {
        "errormap": {
            "scene": made.scene,
            "view": Scene.load(made.scene).views[0].name,
            "output": name("error.tif"),
        },
        "comparedsm": {
            "dsm": made.output,
            "reference": urban.truth,
            "others": [made.confidence],
            "error": name("difference.tif"),
        },
        "exportrpc": {"scene": made.scene, "rpc_folder": name("rpcs")},
        "checkgcps": {
            "scene": made.scene,
            "dsm": made.output,
            "gcps": name("gcps.csv"),
            "output": name("gcps.gpkg"),
        },
    }
    for stage, options in asked.items():
        run_stage(stage, {**options, "report": name(f"{stage}.html")}, told())
    for format_ in CAMERA_FORMATS:
        run_stage("exportcameras", {"scene": made.scene, "folder": name(format_), "format": format_}, told())

    folder = Path(name("")).parent
    pages = sorted(folder.glob("*.html"))
    assert len(pages) == 5
    for page in pages:
        assert "-a&b" in "".join(checked(page.read_text(encoding="utf-8")).text), page
    layers = sorted(folder.glob("*.gpkg"))
    assert len(layers) == 3
    for layer in layers:
        assert open_vector(str(layer)).GetLayer(0).GetFeatureCount() > 0, layer
    styles = sorted(folder.glob("*.qml"))
    assert len(styles) > 6
    for style in styles:
        ElementTree.parse(style)  # noqa: S314 - our own
    json.loads((Path(made.ept) / "ept.json").read_text(encoding="utf-8"))
    assert not list(folder.rglob("*.part*"))


def test_a_name_in_another_encoding_is_refused_in_a_sentence():
    other = "a\udcff.tif"  # how Python tells of a byte that is no UTF-8
    with pytest.raises(OptionError, match="IMAGES.* must be a text in UTF-8: rename the file") as caught:
        EpmFitOptions(images=("fine.tif", other), workspace="w")
    str(caught.value).encode()


def test_a_bar_belongs_to_a_file_that_has_it(tmp_path):
    points = tmp_path / "a|layername=b.gpkg"  # Windows has no such names, and others that begin like this
    assert file_and_layer(f"{tmp_path}/p.gpkg|layername=b|geometrytype=Point") == (f"{tmp_path}/p.gpkg", "b")
    assert file_and_layer(str(points)) == (str(tmp_path / "a"), "b.gpkg")
    if os.name == "nt":
        return
    points.touch()
    assert file_and_layer(str(points)) == (str(points), "")
    assert file_and_layer(f"{points}|layername=c") == (str(points), "c")
