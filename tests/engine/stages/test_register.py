"""Scenes are laid onto references: every product follows, and what is not known stays as it was."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import EmptyResultError, MissingPackageError, OptionError, OverlapError, SceneError
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.files.vector import read_points
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.imagery.raster import opened, read
from repm_qgis.planning.advice import absolute_height
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage

CELL = 4.0
MOVED = np.array([6.0, -4.0, 9.0])  # of the reference: all of it is wrong by so much


@pytest.fixture(scope="module")
def reference(mountains, tmp_path_factory):
    """The true surface in cells of 4 m, moved: ``reference(name, moved)``."""
    folder = tmp_path_factory.mktemp("reference")

    def make(name, moved=MOVED, shape=None):
        source = gdal.Warp("", mountains.truth, format="MEM", xRes=CELL, yRes=CELL, resampleAlg="average")
        x, cell, _, y, _, step = source.GetGeoTransform()
        path = str(folder / name)
        dataset = gdal.GetDriverByName("GTiff").CreateCopy(path, source)
        dataset.SetGeoTransform((x + moved[0], cell, 0, y + moved[1], 0, step))
        band = dataset.GetRasterBand(1)
        heights = band.ReadAsArray() + moved[2]
        if shape is not None:
            heights = shape(heights)
        band.WriteArray(heights.astype(np.float32))
        dataset = None
        return path

    return make


@pytest.fixture(scope="module")
def matched(mountains_run):
    return str(mountains_run.workspace / "reconstructed.json")


@pytest.fixture(scope="module")
def registered(matched, reference, tmp_path_factory, told):
    """The mountains on the moved reference, with all products, and what was said."""
    folder, said = tmp_path_factory.mktemp("registered"), told()
    files = {
        "output_scene": "registered.json",
        "differences": "differences.tif",
        "offsets": "offsets.gpkg",
        "report": "r.html",
    }
    options = {name: str(folder / file) for name, file in files.items()}
    path = reference("moved.tif")
    made = run_stage("register", {"scene": matched, "reference": [path], "workers": 1, **options, **ELLIPSOID}, said)
    return made, said, path


ELLIPSOID = {"reference_datum": "ellipsoid"}


def fuse(scene, folder, told, **more):
    folder.mkdir(exist_ok=True)
    options = {"scene": scene, "output": str(folder / "dsm.tif"), "workers": 1, "resolution": 1.0, **more}
    return run_stage("dsmfuse", options, told())


@pytest.mark.long
def test_the_dsm_lies_on_the_reference_without_any_alignment(registered, tmp_path, told):
    made, _, reference = registered
    dsm = fuse(made.output_scene, tmp_path / "registered", told).output
    left = score_files(dsm, reference, "3d").alignment
    assert np.hypot(left.dx, left.dy) < 0.1 and abs(left.dz) < 0.06
    assert abs(score_files(dsm, reference).metrics.bias) < 0.06


def test_the_shift_is_told_with_honest_deviations(registered, mountains, matched, tmp_path, told):
    made, said, _ = registered
    figures = Scene.load(made.output_scene).registration
    moved = np.array([made.east, made.north, made.up])
    before = score_files(fuse(matched, tmp_path / "before", told).output, mountains.truth, "3d").alignment
    wanted = MOVED + [before.dx, before.dy, before.dz]
    assert moved == pytest.approx(wanted, abs=0.1)
    assert 0.001 < made.east_deviation < 0.05 and 0.001 < made.up_deviation < 0.05
    assert figures.latest.moved == tuple(moved) and len(figures.determined) == 2 and figures.pointing_px < 0.01
    assert any(text.startswith("The scene was moved by (") for text in said.notes)
    # The run's report and the registration's give one figure for what is to be expected without a reference.
    scene = Scene.load(matched)
    assert f"uncertain by {figures.promised_m[1]:.1f} m (LE90" in absolute_height(scene.views, scene.pointing)[0]


def test_images_see_the_moved_ground_where_they_saw_the_ground(registered, matched):
    """All that uses the pointing follows: orthophotos, exports, corrected RPCs."""
    made, _, _ = registered
    old, new = Scene.load(matched), Scene.load(made.output_scene)
    shift = new.registration.latest
    rng = np.random.default_rng(1)
    box, (low, high) = old.tiles[0].bounds, old.tiles[0].altitudes
    ends = (box[0], box[2]), (box[1], box[3]), (low, high)
    ground = np.column_stack([rng.uniform(*pair, 50) for pair in ends])
    there = shift.applied(ground)
    for before, after in zip(old.views, new.views):
        seen = [
            view.project(np.column_stack([geodetic_from_projected(old.crs, xyz[:, :2]), xyz[:, 2]]))
            for view, xyz in ((before, ground), (after, there))
        ]
        assert np.abs(seen[0] - seen[1]).max() < 0.01
        assert np.abs(before.pointing - after.pointing).max() > 1.0


@pytest.mark.long
def test_every_product_of_the_scene_moves(registered, matched, tmp_path, told):
    """Point by point: heights are the same, and lie elsewhere."""
    made, _, _ = registered
    laspy = pytest.importorskip("laspy")
    shift = np.array(Scene.load(made.output_scene).registration.shift.moved)
    clouds = []
    for name, scene in (("before", matched), ("after", made.output_scene)):
        cloud = str(tmp_path / name / "cloud.laz")
        fuse(scene, tmp_path / name, told, cloud=cloud)
        clouds.append(laspy.read(cloud).xyz.mean(axis=0))
    assert clouds[1] - clouds[0] == pytest.approx(shift, abs=0.15)
    old, new = (read_points(Scene.load(path).tie_points, ("height",)) for path in (matched, made.output_scene))
    np.testing.assert_allclose(new - old, np.tile(shift, (len(old), 1)), atol=1e-6)
    first, second = (Scene.load(path).tiles[0] for path in (matched, made.output_scene))
    assert np.subtract(second.bounds[:2], first.bounds[:2]) == pytest.approx(shift[:2], abs=1e-6)
    assert second.heights[0].file == first.heights[0].file and second.heights[0].ground == first.bounds


def test_products_show_before_and_after(registered):
    made, _, _ = registered
    with opened(made.differences) as dataset:
        before, after = (read(dataset, None, band) for band in (1, 2))
        assert "before" in dataset.GetRasterBand(1).GetDescription()
    spread = [np.nanstd(band) for band in (before, after)]
    assert spread[1] < 0.5 * spread[0] and abs(np.nanmedian(after)) < 0.1 < abs(np.nanmedian(before))
    rows = read_points(made.offsets, ("east", "north", "up"))[:, 2:]
    assert len(rows) >= 4
    assert np.median(rows, axis=0) == pytest.approx([made.east, made.north, made.up], abs=0.3)
    page = Path(made.report).read_text(encoding="utf-8")
    assert f"{made.up:+.3f}" in page and "moved.tif" in page and "standard deviation" in page
    # Six metres to the side and nine up are no more than RPCs without a known promise let expect.
    assert "is more than expected" not in page and "nine of ten scenes have errors below" in page
    assert Path(made.differences).with_suffix(".qml").exists() and Path(made.offsets).with_suffix(".qml").exists()


@pytest.mark.long
def test_a_second_run_reuses_the_first_and_a_changed_reference_does_not(matched, reference, tmp_path, told):
    path = reference("changing.tif")
    options = {"scene": matched, "reference": [path], "output_scene": str(tmp_path / "r.json"), **ELLIPSOID}
    first, said = run_stage("register", options, told()), told()
    assert run_stage("register", options, said).up == first.up
    assert any(text.startswith("Reused the registration") for text in said.notes)
    reference("changing.tif", MOVED + [0, 0, 1.0])
    assert run_stage("register", options, told()).up == pytest.approx(first.up + 1.0, abs=0.01)


@pytest.mark.long
def test_registering_twice_is_the_sum_of_both(registered, reference, tmp_path, told):
    made, _, _ = registered
    path = reference("second.tif", MOVED + [2.0, 1.0, -3.0])
    options = {"scene": made.output_scene, "reference": [path], "workers": 1, **ELLIPSOID}
    again = run_stage("register", {**options, "output_scene": str(tmp_path / "again.json")}, told())
    assert [again.east, again.north, again.up] == pytest.approx([2.0, 1.0, -3.0], abs=0.05)
    scene = Scene.load(again.output_scene)
    first = Scene.load(made.output_scene).registration.shift.moved
    assert np.array(scene.registration.shift.moved) == pytest.approx(np.array(first) + scene.registration.latest.moved)
    dsm = fuse(again.output_scene, tmp_path / "fused", told).output
    assert abs(score_files(dsm, path).metrics.bias) < 0.06


@pytest.mark.long
def test_ground_in_stable_polygons_alone_counts(matched, reference, tmp_path, told):
    """Half of the reference is 3 m too high; the polygon has the other half."""

    def half(heights):
        heights[:, : heights.shape[1] // 2] += 3.0
        return heights

    path, scene = reference("half.tif", MOVED, half), Scene.load(matched)
    x0, y0, x1, y1 = scene.tiles[0].bounds
    middle = 0.5 * (x0 + x1) + 20.0
    ring = [[middle, y0], [x1, y0], [x1, y1], [middle, y1], [middle, y0]]
    polygon = {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:{scene.crs.replace(':', '::')}"}}
    stable = tmp_path / "stable.geojson"
    stable.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": [polygon]}))
    options = {"scene": matched, "reference": [path], "workers": 1, **ELLIPSOID}
    inside = run_stage("register", {**options, "output_scene": str(tmp_path / "a.json"), "stable": str(stable)}, told())
    whole = run_stage("register", {**options, "output_scene": str(tmp_path / "b.json")}, told())
    right = run_stage(
        "register", {**options, "reference": [reference("whole.tif")], "output_scene": str(tmp_path / "c.json")}, told()
    )
    assert inside.up == pytest.approx(right.up, abs=0.1)
    assert whole.up > right.up + 0.3


@pytest.mark.long
def test_references_that_contradict_each_other_are_a_warning(matched, reference, tmp_path, told):
    said = told()
    paths = [reference("one.tif"), reference("other.tif", MOVED + [0, 0, 2.0])]
    options = {"scene": matched, "reference": paths, "workers": 1, **ELLIPSOID}
    made = run_stage("register", {**options, "output_scene": str(tmp_path / "r.json")}, said)
    texts = [text for text in said.warnings if "contradict each other by 2.0" in text]
    assert len(texts) == 1 and "in height" in texts[0]
    single = run_stage(
        "register", {**options, "reference": paths[:1], "output_scene": str(tmp_path / "s.json")}, told()
    )
    assert made.up == pytest.approx(single.up + 1.0, abs=0.2)
    assert made.up_deviation == pytest.approx(1.0, abs=0.1), "half of what they contradict each other by"


def ids(said):
    return [finding.id for finding in said.warnings]


@pytest.mark.long
def test_a_copy_of_a_reference_is_no_second_evidence(matched, reference, tmp_path, told):
    path, copy, said = reference("first.tif"), str(tmp_path / "copy.tif"), told()
    gdal.Translate(copy, path, creationOptions=["COMPRESS=DEFLATE", "TILED=YES"])
    options = {"scene": matched, "workers": 1, **ELLIPSOID}
    single = run_stage("register", {**options, "reference": [path], "output_scene": str(tmp_path / "s.json")}, told())
    both = {**options, "reference": [path, copy], "output_scene": str(tmp_path / "b.json")}
    made = run_stage("register", both, said)
    assert made.up == single.up and made.up_deviation == single.up_deviation
    assert ids(said) == ["reference-copied"] and "copy.tif" in said.warnings[0]


@pytest.mark.parametrize(
    ("name", "change", "found"),
    (
        ("constant", lambda z: np.full_like(z, np.median(z)), "relief-other"),
        ("noise", lambda z: np.median(z) + np.random.default_rng(0).normal(0, 20, z.shape), "relief-other"),
        ("turned", lambda z: z[::-1, ::-1], "relief-other"),
        ("feet", lambda z: z / 0.3048, "relief-other"),
        (
            "corner",
            lambda z: np.where(np.add.outer(*map(np.arange, z.shape)) < 15, z, np.nan),
            "reference-covers-little",
        ),
        ("stripes", lambda z: np.where(np.arange(z.shape[1]) % 2 == 0, z, np.nan), None),
        ("checker", lambda z: np.where(np.add.outer(*map(np.arange, z.shape)) % 2 == 0, z, np.nan), None),
    ),
)
@pytest.mark.long
def test_a_reference_that_is_none_is_named_and_gaps_are_not(
    name, change, found, registered, matched, reference, tmp_path, told
):
    """A move that the heights do not show afterwards is refused."""
    said = told()
    options = {"scene": matched, "reference": [reference(f"{name}.tif", shape=change)], "workers": 1, **ELLIPSOID}
    try:
        made = run_stage("register", {**options, "output_scene": str(tmp_path / "r.json")}, said)
    except EmptyResultError:
        assert found is not None
        return
    assert found in ids(said) if found else not said.warnings
    assert "relief-level" not in ids(said)
    if found is None:
        whole = registered[0]
        assert [made.east, made.north, made.up] == pytest.approx([whole.east, whole.north, whole.up], abs=0.1)
        assert made.up_deviation > 0.001


@pytest.mark.long
def test_a_datum_against_that_of_the_file_is_named(mountains, matched, reference, tmp_path, told):
    try:
        HeightDatum.of("EGM96").undulation(mountains.crs, np.array(mountains.bounds[:2]))
    except MissingPackageError as error:
        pytest.skip(f"PROJ's EGM96 grid is not installed: {error}")
    path, said = reference("stated.tif"), told()
    options = {"scene": matched, "reference": [path], "output_scene": str(tmp_path / "r.json"), "workers": 1}
    run_stage("register", {**options, "reference_datum": "EGM96"}, said)
    texts = [text for text in said.warnings if text.id == "reference-datum-contradicts"]
    assert len(texts) == 1 and "WGS 84 ellipsoid" in texts[0] and "EGM96" in texts[0]


@pytest.mark.long
def test_ground_control_points_count_by_their_noise(matched, reference, tmp_path, told):
    """Points known to a centimetre keep the scene where it is, poor ones let the reference move it."""
    scene = Scene.load(matched)
    found = {}
    for name, metres in (("good", 0.001), ("poor", 10.0)):
        path = str(tmp_path / f"{name}.json")
        information = np.eye(3) / metres**2
        replace(scene, pointing=replace(scene.pointing, control_information=information)).save(path)
        options = {"scene": path, "reference": [reference("gcp.tif")], "workers": 1, **ELLIPSOID}
        found[name] = run_stage("register", {**options, "output_scene": str(tmp_path / f"{name}_r.json")}, told())
    assert abs(found["good"].up) < 0.5 and found["poor"].up > 5.0


def test_a_datum_that_nobody_states_is_found(mountains, registered, matched, reference, tmp_path, told):
    """Heights above EGM96 in a file without a word on that: the geoid fits, the ellipsoid does not."""
    try:
        datum = HeightDatum.of("EGM96")
        below = datum.undulation(mountains.crs, np.array(mountains.bounds[:2]))
    except MissingPackageError as error:
        pytest.skip(f"PROJ's EGM96 grid is not installed: {error}")
    path, said = reference("geoid.tif", (*MOVED[:2], 2.0 - float(below))), told()
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.SetMetadata({})
    dataset = None
    options = {"scene": matched, "reference": [path], "output_scene": str(tmp_path / "r.json"), "workers": 1}
    made = run_stage("register", options, said)
    as_known = [registered[0].east, registered[0].north, registered[0].up] - MOVED + [*MOVED[:2], 2.0]
    assert [made.east, made.north, made.up] == pytest.approx(as_known, abs=0.1)
    text = next(text for text in said.notes + said.warnings if "does not say what its heights refer to" in text)
    assert (text in said.warnings) == ("is not installed" in text)  # then another geoid stands in for EGM2008


@pytest.mark.parametrize(
    "change, kind, words",
    (
        ({"reference": []}, OptionError, "must name a raster, points or a cloud"),
        ({"reference_datum": "nonsense"}, OptionError, "REFERENCE_DATUM"),
        ({"model": "affine"}, OptionError, "MODEL"),
    ),
)
def test_bad_options_are_sentences(matched, reference, tmp_path, told, change, kind, words):
    options = {"scene": matched, "reference": [reference("r.tif")], "output_scene": str(tmp_path / "r.json")}
    with pytest.raises(kind, match=words):
        run_stage("register", {**options, **change}, told())


def test_what_does_not_fit_is_a_sentence(mountains_run, matched, reference, tmp_path, told):
    path = reference("far.tif", (1e5, 0, 0))
    far = {"scene": matched, "reference": [path], "output_scene": str(tmp_path / "r.json")}
    with pytest.raises(OverlapError, match="far.tif"):
        run_stage("register", {**far, **ELLIPSOID}, told())
    empty = {**far, "scene": str(mountains_run.workspace / "refined.json")}
    with pytest.raises(SceneError, match="has no height maps"):
        run_stage("register", empty, told())
    assert not (tmp_path / "r.json").exists()


def test_a_reference_elsewhere_is_told_before_anything_is_matched(mountains, reference, tmp_path, pipeline):
    with pytest.raises(OverlapError, match="elsewhere.tif"):
        pipeline(mountains, tmp_path, reference=[reference("elsewhere.tif", (1e5, 0, 0))], workers=1)
    assert not (tmp_path / "ws" / "reconstructed.json").exists()


@pytest.mark.long
def test_the_pipeline_registers_before_it_fuses(mountains, reference, tmp_path, pipeline):
    none = dict.fromkeys(("confidence", "ortho", "cloud", "ept", "mesh"))
    path = reference("pipeline.tif")
    run = pipeline(mountains, tmp_path, reference=[path], resolution=1.0, workers=1, **none, **ELLIPSOID)
    assert run.result.scene.endswith("registered.json")
    assert abs(score_files(run.result.output, path).metrics.bias) < 0.06
    page = Path(run.result.report).read_text(encoding="utf-8")
    assert "Registration" in page and "pipeline.tif" in page


@pytest.fixture(scope="module")
def apart(matched, reference, tmp_path_factory, told):
    """The scene twice, at two places that are 5.4 m from each other."""
    folder, scenes = tmp_path_factory.mktemp("apart"), []
    for number, moved in enumerate(((3.0, 0.0, 1.0), (0.0, 3.0, -2.0))):
        path = reference(f"apart_{number}.tif", moved)
        scene = str(folder / f"scene_{number}.json")
        run_stage("register", {"scene": matched, "reference": [path], "output_scene": scene, **ELLIPSOID}, told())
        scenes.append(scene)
    return scenes


def place_of(scene):
    return np.array(Scene.load(scene).registration.shift.moved)


@pytest.mark.slow
def test_scenes_that_overlap_meet_in_the_middle_without_a_reference(apart, tmp_path, told):
    first, second = apart
    before = [place_of(scene) for scene in apart]
    said = told()
    made = run_stage("register", {"scene": first, "others": [second], "output_scene": str(tmp_path / "r.json")}, said)
    after = [place_of(path) for path in (made.output_scene, *made.other_scenes)]
    assert np.abs(before[0] - before[1]).max() > 2.0 and after[0] == pytest.approx(after[1], abs=0.05)
    assert np.mean(after, axis=0) == pytest.approx(np.mean(before, axis=0), abs=0.02)
    assert any("where they overlap" in text for text in said.notes)
    heights = []
    for number, scene in enumerate((made.output_scene, *made.other_scenes)):
        dsm = fuse(scene, tmp_path / str(number), told).output
        heights.append(gdal.Warp("", dsm, format="MEM", outputBounds=Scene.load(scene).tiles[0].bounds, xRes=1, yRes=1))
    one, other = (np.where((z := each.ReadAsArray()) < -1000, np.nan, z) for each in heights)
    rows, columns = (min(sizes) for sizes in zip(one.shape, other.shape))
    assert abs(np.nanmedian(one[:rows, :columns] - other[:rows, :columns])) < 0.05


@pytest.mark.long
def test_one_scene_on_a_reference_takes_its_neighbours_along(apart, reference, tmp_path, told):
    """A reference tells the place of all: the overlap hands it on."""
    first, second = apart
    options = {"scene": first, "others": [second], "reference": [reference("both.tif")], **ELLIPSOID}
    made = run_stage("register", {**options, "output_scene": str(tmp_path / "r.json")}, told())
    single = {"scene": first, "reference": [reference("both.tif")], **ELLIPSOID}
    alone = run_stage("register", {**single, "output_scene": str(tmp_path / "s.json")}, told())
    for path in (made.output_scene, *made.other_scenes):
        assert place_of(path) == pytest.approx(place_of(alone.output_scene), abs=0.05)
