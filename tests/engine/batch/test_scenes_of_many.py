"""Which scenes a folder, a table or a STAC file has, and what of it is refused before any work."""

from __future__ import annotations

import json
import os

import pytest

from repm_qgis.batch.scenes import MOST_SCENES, scenes_of
from repm_qgis.contracts.errors import ImageError, InputTableError, OptionError
from repm_qgis.contracts.options import BatchOptions, PipelineOptions


def batch(at, **given):
    return BatchOptions.from_json({"workspace": str(at / "ws"), **given})


def table(folder, text, **given):
    path = folder / "sites.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return scenes_of(batch(folder, table=str(path), **given))


def test_each_subfolder_and_archive_is_a_scene_but_not_the_workspace(tmp_path):
    for name in ("b", "a", ".hidden", "repm"):
        (tmp_path / name).mkdir()
    for name in ("c.zip", "notes.txt", "x.tif"):
        (tmp_path / name).write_text("")
    found = scenes_of(BatchOptions.from_json({"folder": str(tmp_path), "workspace": str(tmp_path / "repm" / "sites")}))
    assert [scene.name for scene in found] == ["a", "b", "c"]
    assert [scene.own["images"] for scene in found] == [[str(tmp_path / name)] for name in ("a", "b", "c.zip")]


def test_a_folder_without_subfolders_leads_to_the_pipeline(tmp_path):
    (tmp_path / "x.tif").write_text("")
    with pytest.raises(OptionError, match="no subfolder and no archive.*use repm:pipeline"):
        scenes_of(batch(tmp_path, folder=str(tmp_path)))
    with pytest.raises(OptionError, match="cannot be read.*choose another folder"):
        scenes_of(batch(tmp_path, folder=str(tmp_path / "gone")))


@pytest.mark.parametrize(
    "given, words",
    (
        ({}, "FOLDER is empty: it must be given, or TABLE"),
        ({"folder": "a", "table": "b"}, "and not both"),
        ({"folder": "a", "products": ["dsm"]}, "PRODUCTS is 'dsm': it must be one of confidence, ortho"),
        ({"folder": "a", "resolution": -1}, "RESOLUTION is -1"),
        ({"folder": "a", "images": ["a", "b"]}, "images is .* not an option of this stage"),
        ({"folder": "ws"}, "WORKSPACE is .* is also FOLDER"),
    ),
)
def test_options_are_refused_by_their_names(tmp_path, given, words):
    given = {name: str(tmp_path / value) if name == "folder" else value for name, value in given.items()}
    with pytest.raises(OptionError, match=words):
        batch(tmp_path, **given)


def test_a_row_has_options_of_its_own_as_the_pipeline_reads_them(tmp_path):
    text = (
        "\ufeffscene;images;resolution;extent;extent_crs;geometric;order;reference;backend\n"
        'north;"n/a.tif;n/b.tif";0,5;1.4 43.5 1.5 43.6;;no;3;"dem.tif;lidar.laz";sgm\n'
        ';south;;"500000,500100,4800000,4800200 [EPSG:32631]";;;;;\n\n'
    )
    first, second = table(tmp_path, text)
    at = str(tmp_path) + os.sep
    assert first.name == "north" and first.own == {
        "images": [f"{at}n/a.tif", f"{at}n/b.tif"],
        "resolution": 0.5,
        "extent": [1.4, 43.5, 1.5, 43.6],
        "geometric": False,
        "order": 3,
        "reference": [f"{at}dem.tif", f"{at}lidar.laz"],
        "backend": "sgm",
    }
    assert second.name == "south" and second.own == {
        "images": [f"{at}south"],
        "extent": [500000, 4800000, 500100, 4800200],
        "extent_crs": "EPSG:32631",
    }
    places = {"workspace": "w", "output": "dsm.tif"}
    made = PipelineOptions.from_json({**first.job({"resolution": 2.0, "fill": "none"}), **places})
    assert (made.fuse.resolution, made.fuse.fill, made.refine.order) == (0.5, "none", 3)


def test_a_preset_of_a_row_goes_before_common_values_and_its_own_values_before_that(tmp_path):
    rows = "images,preset,fill\na,mountains,\nb,none,\nc,,\nd,city,none\n"
    # As a dialog with the preset "fast" gives them.
    common = {"preset": "fast", "quality": "fast", "pointing": "shift", "fill": "none", "method": "median"}
    jobs = [scene.job(common) for scene in table(tmp_path, rows, **common)]
    assert [job["preset"] for job in jobs] == ["mountains", "none", "fast", "city"]
    assert [job.get("fill") for job in jobs] == ["all", None, "none", "none"]
    assert [job.get("quality") for job in jobs] == [None, None, "fast", None]
    assert [job["method"] for job in jobs] == ["mean", "median", "median", "mean"]


@pytest.mark.parametrize(
    "text, words",
    (
        ("scene,images,resolutoin\na,b,1\n", "column 'resolutoin'.*do you mean 'resolution'"),
        ("scene,images,zzz\na,b,1\n", "column 'zzz'.*remove it. Columns are scene, images, rpcs"),
        ("scene,images,workspace\na,b,c\n", "column 'workspace', which is no option of a scene"),
        ("scene,images,cluster\na,b,tcp://x:1\n", "column 'cluster', which is no option of a scene"),
        ("scene,images,output\na,b,/etc/passwd\n", "column 'output', which is no option of a scene"),
        ("scene,images,images\na,b,c\n", "two columns 'images'"),
        ("scene,resolution\na,1\n", "no column 'images'"),
        ("scene,images\n", "no row below its columns"),
        ("scene,images\na,\n", "Row 2 of .* has no images"),
        ("scene,images,resolution\na,b,1\nc,d,x\n", "Row 3 of .*'resolution' is 'x', which is not a number"),
        ("scene,images,resolution\na,b,-5\n", "Row 2 of .*RESOLUTION is -5.0: it must be a number between"),
        ("scene,images,geometric\na,b,maybe\n", "'geometric' is 'maybe': write yes or no"),
        ("scene,images,order\na,b,2.5\n", "'order' is '2.5': write a whole number"),
        ("scene,images,fill\na,b,some\n", "FILL is 'some': it must be one of none"),
        ("scene,images,extent\na,b,1 2 3\n", "'extent' is '1 2 3': write xmin ymin xmax ymax"),
        ("scene,images,extent\na,b,3 2 1 4\n", "EXTENT is .*xmin < xmax"),
        ("scene,images\na,b.tif,c.tif\n", "more values than the first line has columns.*quotation marks"),
        ("scene,images\na,https://example.org/x.tif\n", "leads to the network"),
        ("scene,images\na,b.tif;/vsicurl/https://example.org/x.tif\n", "leads to the network"),
        ("scene,images\na,\\\\host\\share\\x.tif\n", "leads to the network"),
        ('scene,images,extent\na,b,"1,2,3,4 [https://example.org/crs]"\n', "leads to the network"),
        ("scene,images,crs\na,b,https://example.org/crs\n", "leads to the network"),
        ("scene,images\na,b\nA,c\n", "two scenes of the name 'A'"),
        ("scene,images\na/b,b\na:b,c\n", "two scenes of the name 'a_b'"),
        (b"scene,images\n\xff\xfe,b\n", "Cannot read the table"),
        ("scene,images\n" + "a,b\n" * (MOST_SCENES + 1), "more than 1000 rows"),
        ("scene,images\n" + "#" * (5 << 20), "at most 4 MiB"),
        ('scene,images\n"' + "a" * 200_000 + '",b\n', "Cannot read the table"),
    ),
)
def test_what_no_scene_can_have_is_one_sentence_with_the_remedy(tmp_path, text, words):
    with pytest.raises((InputTableError, OptionError), match=words) as caught:
        table(tmp_path, text)
    assert len(str(caught.value)) < 3000


def test_a_scene_s_name_stays_in_the_workspace(tmp_path):
    (scene,) = table(tmp_path, "scene,images\n../../x,b\n")
    assert scene.name == ".._.._x"
    assert os.path.dirname(os.path.join("ws", scene.name)) == "ws"


def test_each_item_of_a_catalogue_is_a_scene_and_a_bad_one_is_bad_alone(urban, tmp_path):
    def item(name, hrefs):
        assets = {str(n): {"href": href, "type": "image/tiff"} for n, href in enumerate(hrefs)}
        return {"type": "Feature", "stac_version": "1.0.0", "id": name, "assets": assets, "properties": {}}

    items = [item("town", urban.images), item("far", ["https://example.org/a.tif"]), item("none", ["gone.tif"])]
    path = tmp_path / "all.json"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": items}))
    town, far, none = scenes_of(batch(tmp_path, table=str(path)))
    assert town.own == {"images": list(urban.images)} and town.error is None
    assert isinstance(far.error, ImageError) and "on the network" in str(far.error)
    assert isinstance(none.error, ImageError) and "holds no image with an RPC" in str(none.error)
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [item(str(n), []) for n in range(1001)]}))
    with pytest.raises(ImageError, match="more than 1000 items"):
        scenes_of(batch(tmp_path, table=str(path)))
