"""Names of files and folders are data: none of their signs means anything to QGIS's layers, or to us."""

from __future__ import annotations

import csv
import html
import os
import pathlib
import shutil

import pytest
from qgis.core import QgsRasterLayer, QgsVectorLayer

from tests.engine.pages import checked

# Signs of HTML, XML, SQL, shells, templates and URIs, and a leading dash.
WORST = "-a&b<c>\"d' one=1 {x}{{y}}% *[a]?#$(x);`]]>\\ä"
# What QGIS cannot load as a vector layer's or a cloud's name, but reads as an image's.
INPUT = WORST + "|layername=b\n%41"

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows refuses such names itself")


@pytest.mark.slow
def test_images_and_products_of_the_worst_names(load, town, tmp_path):
    folder = tmp_path / WORST
    folder.mkdir()
    images = [str(folder / f"{INPUT}{index}.tif") for index in range(len(town.images))]
    for image, copy in zip(town.images, images):
        shutil.copy(image, copy)
    with open(town.gcps, encoding="utf-8", newline="") as stream:
        heads, *rows = csv.reader(stream)
    views = {pathlib.Path(image).stem: pathlib.Path(copy).stem for image, copy in zip(town.images, images)}
    column = heads.index("view")
    points = folder / f"{INPUT}.csv"
    with open(points, "w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows([heads, *([*r[:column], views[r[column]], *r[column + 1 :]] for r in rows)])

    def name(end):
        return str(folder / f"{WORST}{end}")

    results, layers = load(
        "pipeline",
        {
            "IMAGES": [QgsRasterLayer(images[0], "first"), *images[1:]],
            "WORKSPACE": name("work"),
            "GCPS": str(points),
            "RESOLUTION": 2.0,
            "REPORT": name("r.html"),
            "EPT": name("ept"),
            "MESH": name("m.ply"),
            "VIEWER": name("v.html"),
        },
        {
            "OUTPUT": name("d.tif"),
            "CONFIDENCE": name("k.tif"),
            "ORTHO": name("o.tif"),
            "TILES": name("t.gpkg"),
            "TIE_POINTS": name("p.gpkg"),
        },
    )
    loaded = load.project.mapLayers().values()
    assert len(loaded) == len(layers) + 2  # the cloud and the mesh
    assert all(layer.isValid() and WORST in layer.name() for layer in loaded)
    assert all(
        isinstance(layers[key], QgsVectorLayer) and layers[key].featureCount() for key in ("TILES", "TIE_POINTS")
    )
    page = checked(pathlib.Path(results["REPORT"]).read_text(encoding="utf-8"))
    assert WORST in "".join(page.text)
    page = pathlib.Path(results["VIEWER"]).read_text(encoding="utf-8")
    assert WORST not in page and html.unescape(page).count(f">{WORST}work</") == 2  # the title and the heading
    checks, _ = load(
        "checkgcps",
        {"SCENE": results["SCENE"], "GCPS": str(points), "REPORT": name("g.html")},
        {"OUTPUT": name("g.gpkg")},
    )
    checked(pathlib.Path(checks["REPORT"]).read_text(encoding="utf-8"))
