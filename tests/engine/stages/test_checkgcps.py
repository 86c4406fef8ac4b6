"""Checking against ground control points: errors that were put in come out, in every column."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pyproj
import pytest
from osgeo import gdal, ogr, osr
from pyproj.transformer import TransformerGroup

from repm_qgis.contracts.errors import EmptyResultError, ImageError, InputTableError, OptionError, SceneError
from repm_qgis.evaluation.gcp_accuracy import ErrorSummary, wrong_control
from repm_qgis.geometry.frames import EnuFrame, geodetic_from_projected
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.engine.gcp_tables import FIELDS, ground_points, write_gcps
from tests.engine.pages import plain


@pytest.fixture(scope="module")
def scene(urban, tmp_path_factory, told):
    """The town's scene as epmfit leaves it: vendors' RPCs, wrong by the biases that truth.json records."""
    folder = tmp_path_factory.mktemp("scene")
    return run_stage("epmfit", {"images": urban.images, "workspace": str(folder)}, told()).scene


@pytest.fixture(scope="module")
def points(urban):
    return ground_points(urban)


@pytest.fixture(scope="module")
def exact(urban, points, tmp_path_factory):
    return write_gcps(tmp_path_factory.mktemp("points") / "gcps.csv", urban, points)


def features(path):
    source = ogr.Open(path)
    layer = source.GetLayer(0)
    found = {feature["id"]: json.loads(feature.ExportToJson()) for feature in layer}
    crs = layer.GetSpatialRef().GetAuthorityCode(None)
    layer = source = None
    return found, crs


def located_by_hand(urban, point):
    """(3,) east, north, up where the biased RPCs' rays of a point's true pixels meet, by a search of its own."""
    from scipy.optimize import least_squares

    frame = EnuFrame(*map(float, point))
    pixels = [view.project(point) for view in urban.true_views]

    def misfit(enu):
        ground = frame.to_geodetic(enu)
        return np.concatenate([pixel - view.project(ground) for pixel, view in zip(pixels, urban.views)])

    # Metres of a step: one of 1e-8 m, as it is chosen near 0, would be lost in the digits of a latitude.
    return least_squares(misfit, np.zeros(3), jac="3-point", diff_step=1e-3, x_scale=1.0, xtol=1e-14, ftol=1e-14).x


def test_known_biases_come_out_and_compensation_takes_them_out(urban, scene, exact, points, tmp_path, told):
    result = run_stage("checkgcps", {"gcps": exact, "scene": scene, "output": str(tmp_path / "p.gpkg")}, told())
    found, crs = features(result.output)
    assert crs == Scene.load(scene).crs.split(":")[1] and len(found) == result.points == 12
    by_hand = np.array([located_by_hand(urban, point) for point in points])
    ours = np.array([[found[f"P{k:02d}"]["properties"][f"rpc_{axis}"] for axis in "enh"] for k in range(12)])
    np.testing.assert_allclose(ours, by_hand, atol=1e-3)
    assert np.abs(by_hand).max() > 0.3  # there is something to find
    for name, column in zip(("east", "north", "height"), by_hand.T):
        of = result.components["rpc"][name]
        assert (of.medae, of.rmse, of.max, of.count) == pytest.approx(
            (np.median(np.abs(column)), np.sqrt(np.mean(column**2)), np.abs(column).max(), 12), abs=1e-3
        )
    assert result.rpc_rmse == result.components["rpc"]["height"].rmse
    # A bias is the same all over such a small scene: shifts take it out.
    assert result.compensated_max < 0.02 and result.components["compensated"]["east"].max < 0.01
    assert result.scene_medae is None and result.dsm_medae is None
    residual = found["P03"]["properties"]["rpc_px"]
    assert residual == pytest.approx(np.sqrt(np.mean((urban.biases**2).sum(axis=1))), abs=0.02)


def test_a_point_has_the_error_that_the_error_map_shows_there(urban, scene, exact, tmp_path, told):
    result = run_stage("checkgcps", {"gcps": exact, "scene": scene, "output": str(tmp_path / "p.gpkg")}, told())
    found, _ = features(result.output)
    point = found["P05"]
    mapped = []
    for view in Scene.load(scene).views:
        given = {"scene": scene, "view": view.name, "altitude": point["properties"]["height"], "report": ""}
        path = run_stage("errormap", {**given, "output": str(tmp_path / f"{view.name}.tif")}, told()).output
        dataset = gdal.Open(path)
        west, width, _, north, _, height = dataset.GetGeoTransform()
        x, y = point["geometry"]["coordinates"][:2]
        mapped.append(dataset.ReadAsArray(int((x - west) / width), int((y - north) / height), 1, 1)[0, 0, 0])
        dataset = None
    assert point["properties"]["camera_px"] == pytest.approx(max(mapped), rel=0.05) and max(mapped) > 0


def test_no_control_point_vouches_for_itself(urban, scene, points, tmp_path, told):
    """One control point off by 1 px in all rows of all views: its own error shows in full, others feel a fifth."""
    path = write_gcps(tmp_path / "g.csv", urban, points, pixel=lambda k, name, p: p + (0.0, 1.0 if k == 0 else 0.0))
    result = run_stage("checkgcps", {"gcps": path, "scene": scene, "output": str(tmp_path / "p.gpkg")}, told())
    assert result.wrong == ()
    found, _ = features(result.output)
    px = [found[f"P{k:02d}"]["properties"]["compensated_px"] for k in range(12)]
    assert px[0] == pytest.approx(1.0, abs=0.01)
    for k in range(1, 12):
        assert px[k] == pytest.approx(1 / 6 if k % 2 else 1 / 5, abs=0.01)


@pytest.mark.parametrize(
    ("pixel", "feet", "said"),
    (
        (lambda k, name, p: p[::-1], 1.0, "if col and row are exchanged: exchange these columns in the table."),
        (lambda k, name, p: p[::-1] if name == "img_01" else p, 1.0, "in img_01 differ by .* if col and row are exch"),
        (lambda k, name, p: p, 0.3048, "if heights are feet and not metres: convert the heights to metres."),
    ),
    ids=("columns", "columns of one image", "feet"),
)
def test_a_table_that_is_read_wrongly_is_refused_by_its_cause(urban, scene, points, tmp_path, told, pixel, feet, said):
    """No single point is blamed, and nobody is told to give the points to the reconstruction."""
    numbers = np.random.default_rng(6)
    path = write_gcps(
        tmp_path / "g.csv", urban, points, pixel=lambda k, name, p: pixel(k, name, p + numbers.normal(0, 0.2, 2))
    )
    with open(path, newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    for row in rows[1:]:
        row[FIELDS.index("height")] = repr(float(row[FIELDS.index("height")]) / feet)
    with open(path, "w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(rows)
    with pytest.raises(InputTableError, match=said):
        run_stage("checkgcps", {"gcps": path, "scene": scene, "output": str(tmp_path / "p.gpkg")}, told())


def test_two_wrong_points_of_twelve_are_named_and_left_out(urban, scene, points, tmp_path, told):
    numbers = np.random.default_rng(4)
    wrong = {2: (5.0, -2.0), 6: (-1.0, 8.0)}
    path = write_gcps(
        tmp_path / "g.csv",
        urban,
        points,
        role=lambda k: "control",
        pixel=lambda k, name, p: p + numbers.normal(0, 0.3, 2) + wrong.get(k, (0.0, 0.0)),
    )
    said = told()
    result = run_stage(
        "checkgcps",
        {"gcps": path, "scene": scene, "output": str(tmp_path / "p.gpkg"), "report": str(tmp_path / "r.html")},
        said,
    )
    assert result.wrong == ("P02", "P06")
    assert [text.split(" contradicts")[0] for text in said.warnings] == [
        "The control point P02",
        "The control point P06",
    ]
    assert result.components["compensated"]["height"].count == 10
    assert result.components["compensated"]["east"].max < 0.5  # 0.3 px of 0.5 m, in three views
    found, _ = features(result.output)
    assert [name for name, feature in found.items() if feature["properties"]["wrong"]] == ["P02", "P06"]
    page = plain((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert page.count("<td>wrong</td>") == 2 and "P02 contradicts the others" in page


def test_the_scenes_own_pointing_is_a_column_once_there_is_one(urban, scene, exact, tmp_path, told):
    corrected = Scene.load(scene)
    views = tuple(
        view.with_pointing(np.column_stack([np.eye(2), -bias])) for view, bias in zip(corrected.views, urban.biases)
    )
    replace(corrected, views=views).save(str(tmp_path / "corrected.json"))
    result = run_stage(
        "checkgcps",
        {"gcps": exact, "scene": str(tmp_path / "corrected.json"), "output": str(tmp_path / "p.gpkg")},
        told(),
    )
    assert result.scene_max < 0.02 < 0.3 < result.rpc_max
    found, _ = features(result.output)
    assert {feature["properties"]["shown"] for feature in found.values()} == {"scene"}


def test_a_point_in_one_image_has_a_place_but_no_height(urban, scene, points, tmp_path, told):
    path = write_gcps(tmp_path / "g.csv", urban, points[:3], role=lambda k: "control", views=1)
    result = run_stage("checkgcps", {"gcps": path, "scene": scene, "output": str(tmp_path / "p.gpkg")}, told())
    assert set(result.components["rpc"]) == {"east", "north"} and result.rpc_rmse is None
    ground = urban.views[0].localise(urban.true_views[0].project(points[1]), points[1, 2])
    found, _ = features(result.output)
    east, north, _ = EnuFrame(*map(float, points[1])).from_geodetic(ground)
    place = found["P01"]["properties"]
    assert (place["rpc_e"], place["rpc_n"]) == pytest.approx((east, north), abs=1e-6)
    assert found["P01"]["properties"]["height_error"] is None


def changed(source, path, change=lambda heights: heights, crs=None, metadata=True):
    """A copy of a DSM with other heights, CRS, or without its words on the vertical datum."""
    original = gdal.Open(source)
    copy = gdal.GetDriverByName("GTiff").CreateCopy(str(path), original)
    band = copy.GetRasterBand(1)
    band.WriteArray(change(original.GetRasterBand(1).ReadAsArray()))
    if crs:
        reference = osr.SpatialReference()
        reference.SetFromUserInput(crs)
        copy.SetSpatialRef(reference)
    if not metadata:
        copy.SetMetadata({})
    band = copy = original = None  # noqa: F841
    return str(path)


def test_the_true_dsm_has_no_error_and_a_raised_one_its_own(urban, exact, tmp_path, told):
    said = told()
    result = run_stage("checkgcps", {"gcps": exact, "dsm": urban.truth}, said)
    assert result.dsm_max < 0.001 and said.warnings == []
    assert set(result.components) == {"dsm"} and set(result.components["dsm"]) == {"height"}
    raised = changed(urban.truth, tmp_path / "raised.tif", lambda heights: heights + 1.25)
    result = run_stage("checkgcps", {"gcps": exact, "dsm": raised}, told())
    assert (result.dsm_medae, result.dsm_rmse, result.dsm_max) == pytest.approx((1.25,) * 3, abs=0.001)


@pytest.mark.parametrize(
    ("changed_points", "named", "by"),
    (
        (lambda p: p + [9.0 / 111320 / np.cos(np.radians(p[:, 1].mean())), 0.0, 0.0], "points-displaced", 9.0),
        (lambda p: p - [0.0, 26.0 / 111320, 0.0], "points-displaced", 26.0),
        (lambda p: np.column_stack([p[:, :2], np.random.default_rng(5).permutation(p[:, 2])]), "points-relief", 0),
        (lambda p: np.column_stack([p[:, :2], np.full(len(p), np.median(p[:, 2]))]), "points-relief", 0),
        (lambda p: p + np.random.default_rng(6).normal(0, 0.5, (len(p), 1)) * [0, 0, 1], "", 0),
        (lambda p: p + 9.0 * (np.arange(len(p)) == 4)[:, None] * [0, 0, 1], "", 0),  # one wrong point of 24
        (lambda p: p + 19.0 * (np.arange(len(p)) == 4)[:, None] * [0, 0, 1], "points-spread", 0),
    ),
    ids=("9 m east", "26 m south", "other order", "one height", "noise", "one wrong", "one very wrong"),
)
def test_points_that_say_nothing_of_the_dsm_are_named(urban, tmp_path, told, changed_points, named, by):
    """Errors of 5 to 20 m were "Good."; hills of a formula below 24 points."""
    x, cell, _, y, _, _ = urban.transform
    rows, cols = np.indices(urban.surface.shape)

    def hills(col, row):
        return 200 + 6 * np.sin(cell * col / 17) * np.cos(cell * row / 23) + 3 * np.sin(cell * (col + row) / 9)

    dsm = changed(urban.truth, tmp_path / "hills.tif", lambda heights: hills(cols, rows))
    col, row = (np.random.default_rng(2).uniform(80, n - 80, 24) for n in urban.surface.shape[::-1])
    lon_lat = geodetic_from_projected(urban.crs, np.column_stack([x + (col + 0.5) * cell, y - (row + 0.5) * cell]))
    points = np.column_stack([lon_lat, hills(col, row)])
    said = told()
    path = write_gcps(tmp_path / "g.csv", urban, changed_points(points), views=0)
    run_stage("checkgcps", {"gcps": path, "dsm": dsm}, said)
    assert [each.id for each in said.warnings][:1] == ([named] if named else [])
    if by:
        assert float(said.warnings[0].split("better ")[1].split(" m")[0]) == pytest.approx(by, abs=2)


@pytest.mark.parametrize("beside, named", ((26.0, ["points-displaced"]), (0.0, [])))
def test_a_few_points_on_gentle_ground_are_found_beside_their_place(urban, tmp_path, told, beside, named):
    """14 points on low hills: their place was not judged. Errors of the DSM fit nowhere else by chance."""
    x, cell, _, y, _, _ = urban.transform
    rows, cols = np.indices(urban.surface.shape)
    rng = np.random.default_rng(4)

    def hills(col, row):
        return 200 + 1.9 * np.sin(cell * col / 17) * np.cos(cell * row / 23) + 1.0 * np.sin(cell * (col + row) / 9)

    def surface(heights):
        return hills(cols, rows) + rng.normal(0.0, 0.05 if beside else 1.0, heights.shape)

    dsm = changed(urban.truth, tmp_path / "hills.tif", surface)
    col, row = (rng.uniform(80, n - 80, 14) for n in urban.surface.shape[::-1])
    lon_lat = geodetic_from_projected(urban.crs, np.column_stack([x + (col + 0.5) * cell, y - (row + 0.5) * cell]))
    points, said = np.column_stack([lon_lat, hills(col, row)]) - [0.0, beside / 111320, 0.0], told()
    run_stage("checkgcps", {"gcps": write_gcps(tmp_path / "g.csv", urban, points, views=0), "dsm": dsm}, said)
    assert [each.id for each in said.warnings] == named


def test_a_constant_dsm_says_nothing_of_points(urban, exact, tmp_path, told):
    said, middle = told(), float(np.median(urban.surface))
    level = changed(urban.truth, tmp_path / "level.tif", lambda heights: 0 * heights + middle)
    run_stage("checkgcps", {"gcps": exact, "dsm": level}, said)
    assert "points-relief" in [each.id for each in said.warnings]


def test_heights_between_cells_are_bilinear(urban, points, tmp_path, told):
    """On a tilted plane, points anywhere in the cells."""
    x, cell, _, y, _, _ = urban.transform
    rows, cols = np.indices(urban.surface.shape)
    plane = changed(urban.truth, tmp_path / "plane.tif", lambda heights: 200 + 0.3 * cols - 0.7 * rows)
    numbers = np.random.default_rng(2)
    col, row = (numbers.uniform(20, n - 20, 12) for n in urban.surface.shape[::-1])
    lon_lat = geodetic_from_projected(urban.crs, np.column_stack([x + (col + 0.5) * cell, y - (row + 0.5) * cell]))
    path = write_gcps(tmp_path / "g.csv", urban, np.column_stack([lon_lat, 200 + 0.3 * col - 0.7 * row]), views=0)
    result = run_stage("checkgcps", {"gcps": path, "dsm": plane}, told())
    assert result.dsm_max < 0.01


@pytest.mark.long
def test_vertical_datums_of_dsm_and_points_are_brought_together(urban, points, tmp_path, told):
    """Both above EGM96, and each alone, against heights that pyproj converted."""
    if not TransformerGroup("EPSG:4326+5773", "EPSG:4979").best_available:
        pytest.skip("PROJ's EGM96 grid is not installed")
    zone = urban.crs.split(":")[1]
    undulation = pyproj.Transformer.from_crs("EPSG:4326+5773", "EPSG:4979", always_xy=True).transform(
        points[0, 0], points[0, 1], 0.0
    )[2]
    assert 40 < undulation < 60
    geoid = changed(urban.truth, tmp_path / "geoid.tif", lambda heights: heights - undulation, f"EPSG:{zone}+5773")
    above = points - [0, 0, undulation]
    tables = {
        "": write_gcps(tmp_path / "e.csv", urban, points, views=0),
        "EGM96": write_gcps(tmp_path / "g.csv", urban, above, views=0),
    }
    for datum, path in tables.items():
        for dsm in (urban.truth, geoid):
            said = told()
            result = run_stage("checkgcps", {"gcps": path, "gcp_datum": datum, "dsm": dsm}, said)
            assert result.dsm_max < 0.05 and said.warnings == []  # the geoid tilts by centimetres over the scene
    said = told()
    result = run_stage("checkgcps", {"gcps": tables["EGM96"], "dsm": urban.truth}, said)
    assert result.dsm_medae == pytest.approx(undulation, abs=0.05)
    assert any("usually a geoid" in text and "GCP_DATUM" in text for text in said.warnings)


def test_a_dsm_that_does_not_say_its_datum_is_taken_as_ellipsoidal_aloud(urban, exact, tmp_path, told):
    silent = changed(urban.truth, tmp_path / "silent.tif", metadata=False)
    said = told()
    assert run_stage("checkgcps", {"gcps": exact, "dsm": silent}, said).dsm_max < 0.001
    assert len(said.warnings) == 1 and "does not state its vertical datum" in said.warnings[0]


def test_holes_and_places_outside_are_not_counted_and_said(urban, points, tmp_path, told):
    x, cell, _, y, _, _ = urban.transform
    away = np.vstack([points, points[0] + [0.5, 0, 0]])
    xy = pyproj.Transformer.from_crs("EPSG:4326", urban.crs, always_xy=True).transform(*points[3, :2])
    col, row = int((xy[0] - x) / cell), int((y - xy[1]) / cell)

    def holed(heights):
        heights[row - 1 : row + 2, col - 1 : col + 2] = -9999.0
        return heights

    dsm = changed(urban.truth, tmp_path / "holed.tif", holed)
    source = gdal.Open(dsm, gdal.GA_Update)
    source.GetRasterBand(1).SetNoDataValue(-9999.0)
    source = None
    said = told()
    result = run_stage(
        "checkgcps",
        {"gcps": write_gcps(tmp_path / "g.csv", urban, away, views=0), "dsm": dsm, "output": str(tmp_path / "p.gpkg")},
        said,
    )
    assert result.components["dsm"]["height"].count == 11 and result.dsm_max < 0.001
    assert any("1 point lies outside the DSM and is not counted: P12" in text for text in said.warnings)
    assert any("1 point lies where the DSM has no height and is not counted: P03" in text for text in said.warnings)
    found, _ = features(result.output)
    assert found["P03"]["properties"]["dsm_error"] is None and found["P12"]["properties"]["dsm_height"] is None


def test_layer_style_and_report_tell_all_columns(urban, scene, exact, tmp_path, told):
    result = run_stage(
        "checkgcps",
        {
            "gcps": exact,
            "scene": scene,
            "dsm": urban.truth,
            "report": str(tmp_path / "r.html"),
            "output": str(tmp_path / "p.gpkg"),
        },
        told(),
    )
    style = (tmp_path / "p.qml").read_text(encoding="utf-8")
    assert "@scale@" not in style and "@length@" not in style and "&quot;height_error&quot;" in style
    length = float(style.split("(10 mm = ")[1].split(" m)")[0])
    east_north = result.components["compensated"]
    assert length >= 0.9 * min(east_north["east"].rmse, east_north["north"].rmse)
    page = plain((tmp_path / "r.html").read_text(encoding="utf-8"))
    for words in (
        "RPC localisation, image-space compensation",
        "The DSM&#39;s height",
        "control",
        "check",
        "Max, m",
        f"{result.rpc_rmse:.3f}",
        f"{result.components['rpc']['east'].max:.3f}",
        "P11",
    ):
        assert words in page
    found, _ = features(result.output)
    assert found["P05"]["properties"]["height_error"] == pytest.approx(0.0, abs=1e-3)
    assert found["P05"]["properties"]["views"] == "img_01, img_02, img_03"
    assert json.dumps(result.to_mapping(), allow_nan=False)


def test_the_page_says_only_what_applies(urban, scene, exact, points, tmp_path, told):
    bare = write_gcps(tmp_path / "bare.csv", urban, points, views=0)
    run_stage("checkgcps", {"gcps": bare, "dsm": urban.truth, "report": str(tmp_path / "dsm.html")}, told())
    page = plain((tmp_path / "dsm.html").read_text(encoding="utf-8"))
    assert "12 points<" in page  # roles mean nothing where no image was measured
    for words in ("compensation", "own few measured pixels", "In the images"):
        assert words not in page
    run_stage(
        "checkgcps", {"gcps": exact, "scene": scene, "dsm": urban.truth, "report": str(tmp_path / "a.html")}, told()
    )
    page = plain((tmp_path / "a.html").read_text(encoding="utf-8"))
    for words in (
        "12 points: 6 for control and 6 for checking",
        "no point confirms itself",
        "own few measured pixels",
        "compensated E",
        "DSM H",
        ">P03</text>",
    ):
        assert words in page, words


def test_the_log_tells_check_points_apart(urban, scene, exact, tmp_path, told):
    said = told()
    run_stage("checkgcps", {"gcps": exact, "scene": scene}, said)
    told_heights = [text for text in said.notes if "heights MedAE" in text]
    assert len(told_heights) == 2 and all("of 12 points (6 check points: MedAE" in text for text in told_heights)


def fails(kind, told, *words, **options):
    with pytest.raises(kind) as caught:
        run_stage("checkgcps", options, told())
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".") and all(word in text for word in words), text


def test_what_cannot_be_checked_is_shortage_as_error(urban, scene, exact, points, tmp_path, told):
    fails(OptionError, told, "SCENE is empty", "or DSM, or both", gcps=exact)
    fails(OptionError, told, "GCPS", gcps="", dsm=urban.truth)
    fails(OptionError, told, "GCP_DATUM is 'sea'", gcps=exact, dsm=urban.truth, gcp_datum="sea")
    fails(SceneError, told, "gone.json", gcps=exact, scene=str(tmp_path / "gone.json"))
    fails(ImageError, told, "gone.tif", gcps=exact, dsm=str(tmp_path / "gone.tif"))
    fails(InputTableError, told, "gone.csv", gcps=str(tmp_path / "gone.csv"), dsm=urban.truth)
    bare = write_gcps(tmp_path / "bare.csv", urban, points, views=0)
    fails(EmptyResultError, told, "No point of", "measured in an image", "give a DSM", gcps=bare, scene=scene)
    far = write_gcps(tmp_path / "far.csv", urban, points + [1.0, 0, 0], views=0)
    fails(
        EmptyResultError,
        told,
        "(points: 12) lies where the DSM",
        "choose points of the same area",
        gcps=far,
        dsm=urban.truth,
        output=str(tmp_path / "p.gpkg"),
    )
    renamed = tmp_path / "renamed.csv"
    renamed.write_text(open(exact, encoding="utf-8").read().replace("img_0", "nadir_0"), encoding="utf-8")
    fails(InputTableError, told, "nadir_02.tif", "img_01, img_02, img_03", gcps=str(renamed), scene=scene)
    assert not (tmp_path / "p.gpkg").exists()


def test_without_control_points_there_is_no_compensation_and_that_is_said(urban, scene, points, tmp_path, told):
    path = write_gcps(tmp_path / "g.csv", urban, points, role=lambda k: "check")
    said = told()
    result = run_stage("checkgcps", {"gcps": path, "scene": scene}, said)
    assert result.rpc_medae is not None and result.compensated_medae is None
    assert len(said.warnings) == 1 and "role control" in said.warnings[0]


def test_errors_are_the_papers():
    errors = ErrorSummary.of(np.array([1.0, -2.0, 2.0, np.nan, -5.0]))
    assert (errors.count, errors.medae, errors.max) == (4, 2.0, 5.0) and errors.rmse == pytest.approx(np.sqrt(34 / 4))
    assert ErrorSummary.of(np.array([np.nan])).count == 0


def test_few_points_accuse_nobody():
    far = {name: {"a": np.array([k * 50.0, 0.0])} for k, name in enumerate("pqr")}
    assert wrong_control(far) == ()
    near = {f"p{k}": {"a": np.array([k * 0.01, 0.0])} for k in range(5)}
    assert wrong_control({**near, "x": {"a": np.array([9.0, 0.0])}}) == ("x",)
