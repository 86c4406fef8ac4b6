"""Images of another place are left out, whatever their RPCs' heights are; sentences say where all of them look."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import OverlapError, RpcInvalidError
from repm_qgis.contracts.options import EpmFitOptions
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.planning import overlap
from repm_qgis.planning.overlap import foreign_rpc, not_overlapping, of_one_place, places, views_of
from repm_qgis.scene import common_heights


def moved(view, name, **rpc):
    return replace(view, name=name, rpc=replace(view.rpc, **rpc))


def names(groups):
    return [[view.name for view in group] for group in groups]


@pytest.fixture
def abroad(urban):
    """An image of another continent, whose RPC is made for other heights."""
    view = urban.views[2]
    return moved(view, "abroad", lon_off=-47.0, lat_off=-23.0, height_off=view.rpc.height_off + 3000)


def test_the_largest_group_comes_first_and_keeps_the_order_of_the_views(urban, abroad):
    a, b, c = urban.views
    assert names(places([abroad, b, a, c], 64)) == [[b.name, a.name, c.name], ["abroad"]]
    again = replace(abroad, name="again")
    assert names(places([abroad, a, again, b], 64)) == [["abroad", "again"], [a.name, b.name]]
    assert names(places([a, abroad, again, b], 64)) == [[a.name, b.name], ["abroad", "again"]]


def test_a_view_between_two_joins_them(urban):
    view = urban.views[0]
    east = [replace(view, name=f"{k}", rpc=view.rpc.shifted(0.7 * k * view.width, 0.0)) for k in range(3)]
    assert names(places([east[0], east[2]], 64)) == [["0"], ["2"]]
    assert names(places([east[0], east[2], east[1]], 64)) == [["0", "2", "1"]]


def test_a_strip_must_be_as_large_as_the_least_overlap(urban):
    view = urban.views[0]
    side = np.sqrt(0.1 * view.width * view.height)
    strip = replace(view, name="strip", rpc=view.rpc.shifted(0.9 * view.width, 0.0))
    assert len(places([view, strip], 0.9 * side)) == 1 and len(places([view, strip], 1.1 * side)) == 2


def test_small_crops_overlap_at_one_height_of_a_wide_range_only(urban):
    """RPCs for 8 km of heights, between whose ends the footprints move by many times their width."""
    first, second = urban.views[0], urban.views[2]
    wide = {"height_off": 3000.0, "height_scale": 4000.0}
    assert first.rpc.height_off < 500
    here = first.localise(np.array([200.0, 200.0]), 190.0)

    def made(view):
        # The same model in other normalisers: linear terms of the height are what matters here.
        ratio = wide["height_scale"] / view.rpc.height_scale
        part = (wide["height_off"] - view.rpc.height_off) / view.rpc.height_scale

        def rescaled(values):
            flat = list(values[:4]) + [0.0] * 16
            flat[0], flat[3] = flat[0] + part * flat[3], flat[3] * ratio
            return tuple(flat)

        flat = {name: rescaled(getattr(view.rpc, name)) for name in ("row_num", "col_num", "row_den", "col_den")}
        rpc = replace(view.rpc, **wide, **flat)
        return replace(view, rpc=rpc.shifted(*(rpc.project(here) - 200.0)))

    assert len(places([made(first), made(second)], 64)) == 1


def test_both_sides_of_the_date_line_are_one_place(urban):
    first, second = urban.views[:2]
    turn = 180.0 - first.rpc.lon_off
    pair = [moved(first, "a", lon_off=180.0), moved(second, "b", lon_off=second.rpc.lon_off + turn - 360.0)]
    assert len(places(pair, 64)) == 1


def test_others_are_named_with_where_they_look(urban, abroad):
    said = []
    kept = of_one_place([*urban.views[:2], abroad], 64, said.append)
    assert kept == tuple(urban.views[:2])
    lon, lat, _ = abroad.localise(np.array([199.5, 199.5]), abroad.rpc.height_off)
    for words in ("Images of another place are left out: abroad around", f"{lon:.4f}, latitude {lat:.4f}", "img_02"):
        assert words in said[0]
    assert of_one_place(urban.views, 64, said.append) == tuple(urban.views) and len(said) == 1
    with pytest.raises(OverlapError, match="do not overlap on the ground: img_01 .* abroad"):
        of_one_place([urban.views[0], abroad], 64)


def test_an_area_chooses_the_place(urban, abroad):
    a, b, _ = urban.views
    views = [a, b, abroad, replace(abroad, name="again")]
    here, there = (v.localise(np.array([200.0, 200.0]), v.rpc.height_off)[:2] for v in (a, abroad))
    box = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * 1e-3
    for middle, kept in ((there, ["abroad", "again"]), (here, [a.name, b.name]), (here + 30.0, [a.name, b.name])):
        assert [v.name for v in of_one_place(views, 64, wanted=middle + box)] == kept
    # One image alone cannot be worked on, wherever the area lies.
    assert [v.name for v in of_one_place(views[:3], 64, wanted=there + box)] == [a.name, b.name]


def test_a_crop_is_said_to_look_where_it_looks_and_not_where_its_rpc_has_its_middle(urban):
    view = urban.views[0]
    crop = replace(view, rpc=view.rpc.shifted(3000.0, -2000.0))
    lon, lat, _ = crop.localise(np.array([199.5, 199.5]), view.rpc.height_off)
    text = not_overlapping([crop, urban.views[1]])
    assert f"longitude {lon:.4f}, latitude {lat:.4f}" in text and f"{view.rpc.lon_off:.4f}, latitude" not in text[:80]


def test_an_rpc_of_a_larger_image_is_suspected_where_it_was_not_shifted(urban):
    view = urban.views[0]
    whole = replace(view.rpc, col_off=3999.5, col_scale=4000.0, row_off=2999.5, row_scale=3000.0)
    stale, crop = replace(view, rpc=whole), replace(view, rpc=whole.shifted(700.0, 500.0))
    far = replace(
        view, rpc=replace(whole, col_off=19999.5, col_scale=512.0)
    )  # as some tools write crops of real images
    assert foreign_rpc([view, crop, far]) == ""
    assert "400 x 400 px, its RPC was made for 8000 x 6000" in foreign_rpc([crop, stale])
    assert "8000 x 6000" in not_overlapping([view, stale])


def test_heights_that_most_rpcs_have_in_common(urban):
    def with_heights(*ranges):
        return [
            moved(urban.views[0], f"{k}", height_off=(low + high) / 2, height_scale=(high - low) / 2)
            for k, (low, high) in enumerate(ranges)
        ]

    for ranges, wanted in (
        (((100, 500), (200, 600)), (200, 500)),
        (((100, 500),), (100, 500)),
        (((100, 500), (700, 900)), (100, 900)),  # none in common
        (((100, 500), (200, 600), (3000, 4000)), (200, 500)),  # one of three is made for other heights
        (((3000, 4000), (100, 500), (100, 500)), (100, 500)),
        (((0, 10), (0, 10), (20, 30), (20, 30)), (0, 30)),
    ):
        assert common_heights(with_heights(*ranges)) == pytest.approx(wanted)


def link(image, name):
    (os.link if os.name == "nt" else os.symlink)(image, name)  # symbolic ones need rights on Windows


@pytest.mark.parametrize("how", ("copy", "link", "another format"))
def test_a_copy_of_an_image_is_no_further_view(urban, tmp_path, how):
    """Each copy made the expected error smaller, as if another image had said the same."""
    again = tmp_path / f"again{'.tif' if how != 'another format' else '.img'}"
    if how == "link":
        link(urban.images[0], again)
    elif how == "copy":
        again.write_bytes(Path(urban.images[0]).read_bytes())
    else:
        copy = gdal.GetDriverByName("HFA").CreateCopy(str(again), gdal.Open(urban.images[0]))
        copy.SetMetadata(gdal.Open(urban.images[0]).GetMetadata("RPC"), "RPC")
        copy = None
    said = []
    images = [urban.images[0], str(again), urban.images[1]]
    found = views_of(EpmFitOptions(images=tuple(images), workspace=str(tmp_path / "w")), 64, said.append)
    assert [view.image for view in found] == [urban.images[0], urban.images[1]]
    assert said == [f"The image again ('{again}') is a copy of img_01: only img_01 is used."]


@pytest.mark.parametrize(
    ("column", "words"), ((0.3, None), (40.0, "same pixels, but RPCs that place them 40.0 px apart"))
)
def test_a_copy_with_a_rounded_rpc_counts_once(urban, tmp_path, column, words):
    again, image = str(tmp_path / "again.tif"), gdal.Open(urban.images[0])
    copy = gdal.GetDriverByName("GTiff").CreateCopy(again, image)
    rpc = image.GetMetadata("RPC")
    copy.SetMetadata({**rpc, "SAMP_OFF": str(float(rpc["SAMP_OFF"]) + column)}, "RPC")
    copy = None
    said, images = [], (urban.images[0], again, urban.images[1])
    options = EpmFitOptions(images=images, workspace=str(tmp_path / "w"))
    if words:
        with pytest.raises(RpcInvalidError, match=words):
            views_of(options, 64)
        return
    found = views_of(options, 64, said.append)
    assert [view.image for view in found] == [images[0], images[2]]
    assert said == [f"The image again ('{again}') is a copy of img_01: only img_01 is used."]


def test_copies_of_one_image_alone_are_no_pair(urban, tmp_path):
    again = tmp_path / "again.tif"
    link(urban.images[0], again)
    with pytest.raises(OverlapError, match="All images are copies of '.*img_01.tif': choose another"):
        views_of(EpmFitOptions(images=(urban.images[0], str(again)), workspace=str(tmp_path / "w")), 64)


def test_how_far_images_lie_from_each_other_is_that_of_their_middles(urban):
    """Also where one is a crop of the other: the first pixels of both would say something else."""
    view = urban.views[0]
    crop = replace(view, width=100, height=80, rpc=view.rpc.shifted(30.0, 200.0))
    frame = EnuFrame(*map(float, view.localise((np.array(view.size) - 1) / 2, 190.0)))
    east, north, _ = frame.from_geodetic(view.localise(np.array([30.0 + 49.5, 200.0 + 39.5]), 190.0))
    assert overlap._between(view, crop, 190.0) == pytest.approx([east, north], abs=0.5)
    assert overlap._between(crop, view, 190.0) == pytest.approx([-east, -north], abs=0.5)


def test_levels_are_no_farther_apart_than_half_of_the_smaller_footprint(urban, monkeypatch):
    """Between two levels that are, small crops overlap at a height that nobody looks at."""
    first, second = urban.views[0], urban.views[2]
    asked = []
    monkeypatch.setattr(overlap, "_outline", lambda view, height: asked.append(height) or np.empty((0, 2)))
    side = min(min(view.size) * view.gsd_m for view in (first, second))
    for apart, count in ((0.0, 2), (0.6, 3), (1.1, 4), (2.4, 6), (1000.0, overlap._MOST_LEVELS)):
        ends = iter([np.zeros(2), np.array([apart * side, 0.0])])
        monkeypatch.setattr(overlap, "_between", lambda *given, ends=ends: next(ends))
        asked.clear()
        assert not overlap._overlap(first, second, 64)
        assert sorted(set(asked)) == pytest.approx(np.linspace(*common_heights((first, second)), count))
