"""STAC items as images: which assets are taken, where their RPCs and times come from, and what is refused."""

import json

import numpy as np
import pytest

from repm_qgis.contracts.errors import ImageError
from repm_qgis.imagery.deliveries import delivered
from repm_qgis.imagery.stac import items_of
from repm_qgis.rpc.writers import rpc_txt
from repm_qgis.scene import Scene, load_view
from repm_qgis.stages import run_stage
from tests.engine.imagery.test_deliveries import without_rpc


def item(number, assets, **properties):
    facts = {"datetime": f"2021-05-0{number}T10:20:30Z", "platform": "worldview-3", **properties}
    return {"type": "Feature", "stac_version": "1.0.0", "id": f"i{number}", "properties": facts, "assets": assets}


@pytest.fixture
def catalogue(urban, tmp_path, write_image):
    """Two items with panchromatic images whose RPC files have names of their own, and a collection of both."""
    for number, view in enumerate(urban.views[:2], start=1):
        folder = tmp_path / f"item {number}"
        without_rpc(view, folder / f"pan{number}.tif")
        (folder / f"model_{number}.txt").write_text(rpc_txt(view.rpc))
        write_image(folder / "thumb.tif", np.zeros((70, 70), np.uint8))
        write_image(folder / f"ms{number}.tif", np.ones((4, 90, 100), np.uint16), view.rpc)
        assets = {
            "panchromatic": {
                "href": f"./pan{number}.tif",
                "type": "image/tiff; application=geotiff",
                "roles": ["data"],
            },
            "multispectral": {"href": f"ms{number}.tif", "type": "image/tiff"},
            "thumbnail": {"href": "thumb.tif", "type": "image/tiff", "roles": ["thumbnail"]},
            "rpc": {"href": f"model_{number}.txt", "type": "text/plain"},
            "page": {"href": "a.html", "type": "text/html"},
        }
        (folder / f"item{number}.json").write_text(json.dumps(item(number, assets)))
    links = [{"rel": "item", "href": f"./item%20{number}/item{number}.json"} for number in (1, 2)]
    collection = {
        "type": "Collection",
        "stac_version": "1.0.0",
        "id": "c",
        "links": [{"rel": "self", "href": "x"}, *links],
    }
    (tmp_path / "collection.json").write_text(json.dumps(collection))
    return tmp_path


def test_an_item_gives_its_image_with_its_rpc_time_and_satellite(urban, catalogue):
    found = delivered([str(catalogue / "item 1" / "item1.json")])
    assert found.images == (str(catalogue / "item 1" / "pan1.tif"),)
    assert found.rpcs == (str(catalogue / "item 1" / "model_1.txt"),)
    assert found.xs == (str(catalogue / "item 1" / "ms1.tif"),)
    view = load_view(*found.images, *found.rpcs)
    assert (view.acquired, view.sensor) == ("2021-05-01T10:20:30.000Z", "WorldView-3")
    assert view.rpc == urban.views[0].rpc


def test_a_collection_is_enough_for_the_stages(urban, catalogue, tmp_path, told):
    run_stage("epmfit", {"images": [str(catalogue / "collection.json")], "workspace": str(tmp_path / "ws")}, told())
    views = Scene.load(str(tmp_path / "ws" / "scene.json")).views
    assert [view.rpc for view in views] == [view.rpc for view in urban.views[:2]]
    assert [view.acquired[:10] for view in views] == ["2021-05-01", "2021-05-02"]


def test_items_in_one_file(catalogue):
    features = [json.loads((catalogue / f"item {n}" / f"item{n}.json").read_text()) for n in (1, 2)]
    for number, feature in enumerate(features, start=1):
        for asset in feature["assets"].values():
            asset["href"] = f"item {number}/{asset['href']}"
    (catalogue / "items.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    found = delivered([str(catalogue / "items.geojson")])
    assert [path[-8:] for path in found.images] == ["pan1.tif", "pan2.tif"] and all(found.rpcs)


@pytest.mark.parametrize(
    "href", ["https://example.com/a.tif", "s3://bucket/a.tif", "/vsicurl/http://x/a.tif", "\\\\a\\b.tif"]
)
def test_the_network_is_not_reached_for_data(tmp_path, href):
    (tmp_path / "item.json").write_text(json.dumps(item(1, {"data": {"href": href, "type": "image/tiff"}})))
    with pytest.raises(ImageError, match="names files on the network .* give their network paths"):
        delivered([str(tmp_path / "item.json")])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", "is no STAC item"),
        ('{"type": "Feature", "geometry": null}', "is no STAC item"),
        ("[1, 2]", "is no STAC item"),
        ('{"type": ', "Cannot read the STAC item"),
        ("[" * 60 + "]" * 60, "nested deeper"),
    ],
)
def test_what_is_no_item_is_a_sentence(tmp_path, text, words):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ImageError, match=words):
        delivered([str(tmp_path / "a.json")])


def test_an_item_without_usable_images_says_why(tmp_path, write_image):
    write_image(tmp_path / "map.tif")
    (tmp_path / "item.json").write_text(json.dumps(item(1, {"data": {"href": "map.tif", "type": "image/tiff"}})))
    with pytest.raises(ImageError, match="holds no image with an RPC: No RPC found for"):
        delivered([str(tmp_path / "item.json")])


def test_catalogues_that_link_to_each_other_end(tmp_path):
    for one, other in (("a", "b"), ("b", "a")):
        links = [{"rel": "child", "href": f"{other}.json"}] * 3
        (tmp_path / f"{one}.json").write_text(json.dumps({"type": "Catalog", "stac_version": "1.0.0", "links": links}))
    with pytest.raises(ImageError, match="links to none"):
        items_of(str(tmp_path / "a.json"))
