"""RPCs that belong to other images: exchanged, the same for two images, or drifting, are not silently accepted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.pointing.exchanged import exchanges, require_own_rpcs
from repm_qgis.pointing.parameters import POINTING
from repm_qgis.scene import load_views
from repm_qgis.stages import run_stage
from repm_qgis.ties.tracks import Track


def ties(views, noise_px, seed=3, count=150):
    """Ties of rugged ground, in pixels as the views' RPCs have them, with noise; and the ground's mean height."""
    rng = np.random.default_rng(seed)
    first = views[0]
    middle = first.rpc.height_off
    pixels = np.column_stack([rng.uniform(0.1, 0.9, count) * n for n in first.size])
    ground = first.localise(pixels, middle + rng.uniform(-60, 60, count))
    seen = [view.project(ground) + rng.normal(0, noise_px, (count, 2)) for view in views]
    return [Track({v.name: part[k] for v, part in zip(views, seen)}) for k in range(count)], middle


@pytest.fixture(scope="module")
def views(urban):
    return load_views(urban.images[:2])


def crossed(views):
    """The same images, each with the other's RPC."""
    return [replace(view, rpc=other.rpc) for view, other in zip(views, views[::-1])]


@pytest.mark.parametrize("seed", range(5))
def test_sound_rpcs_are_never_suspected(views, seed):
    tracks, altitude = ties(views, 0.05, seed)
    (found,) = exchanges(views, tracks, altitude)
    assert found.own_px < 0.1 and found.evidence < 0
    require_own_rpcs(views, tracks, altitude, pytest.fail)


@pytest.mark.parametrize("seed", range(5))
def test_exchanged_rpcs_are_refused(views, seed):
    tracks, altitude = ties(views, 0.03, seed)
    with pytest.raises(RpcInvalidError, match="have each other's RPC: .* upside down: give each image its own"):
        require_own_rpcs(crossed(views), tracks, altitude, pytest.fail)


def test_what_is_likely_and_not_sure_is_said(views):
    """Noisy ties leave a doubt: nothing is refused, and the report cannot say "Good."."""
    tracks, altitude = ties(views, 0.4, count=2000)
    said = []
    eager = replace(POINTING, exchange=replace(POINTING.exchange, most_ties=2000))
    require_own_rpcs(crossed(views), tracks, altitude, said.append, eager)
    assert len(said) == 1 and "may have each other's RPC" in said[0]
    require_own_rpcs(views, tracks, altitude, pytest.fail, eager)


def test_what_ties_cannot_tell_is_said(views):
    """Mirrored lines of sight, as a simulated three-line camera's: no warning, and no silence."""
    tracks, altitude = ties(views, 3.0)
    said = []
    for each in (views, crossed(views)):
        require_own_rpcs(each, tracks, altitude, pytest.fail, info=said.append)
    assert len(said) == 2 and all("do not show whether" in text for text in said)
    tracks, altitude = ties(views, 0.05)
    require_own_rpcs(views, tracks, altitude, pytest.fail, info=pytest.fail)


def test_few_ties_say_nothing(views):
    tracks, altitude = ties(views, 0.03, count=POINTING.exchange.least_ties - 1)
    assert list(exchanges(crossed(views), tracks, altitude)) == []


@pytest.fixture(scope="module")
def three(urban):
    return load_views(urban.images[:3])


def ties_by_pair(views, noise_px, counts, seed=3):
    """Ties that two of the views share, so many of each pair; and the ground's mean height."""
    every, middle = ties(views, noise_px, seed, sum(counts.values()))
    names, found = [view.name for view in views], []
    for (first, second), count in counts.items():
        found += [
            Track({names[k]: every[len(found) + n].pixels[names[k]] for k in (first, second)}) for n in range(count)
        ]
    return found, middle


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.long
def test_a_third_image_decides_where_two_leave_a_doubt(three, seed):
    """Forward and backward images of WHU-TLC fitted as well with each other's RPCs: heights were upside down."""
    tracks, altitude = ties_by_pair(three, 0.12, {(0, 1): 25, (0, 2): 150, (1, 2): 150}, seed)
    own = [track for track in tracks if all(view.name in track.pixels for view in three[:2])]
    wrong = [*crossed(three[:2]), three[2]]
    (alone,) = exchanges(wrong[:2], own, altitude)
    assert alone.evidence < POINTING.exchange.sure_evidence
    found = {each.pair: each.evidence for each in exchanges(wrong, tracks, altitude)}
    assert found[three[0].name, three[1].name] > 2 * POINTING.exchange.sure_evidence
    assert max(found, key=found.get) == (three[0].name, three[1].name)
    require_own_rpcs(three, tracks, altitude, pytest.fail)


def test_two_images_that_share_no_ties_are_compared_by_way_of_the_third(three):
    tracks, altitude = ties_by_pair(three, 0.03, {(0, 2): 100, (1, 2): 100})
    wrong = [*crossed(three[:2]), three[2]]
    with pytest.raises(RpcInvalidError, match=f"{three[0].name} and {three[1].name} have each other's RPC"):
        require_own_rpcs(wrong, tracks, altitude, pytest.fail)
    require_own_rpcs(three, tracks, altitude, pytest.fail)


def with_rpcs(images, order, folder):
    """The images, each with the RPC of that place in the order."""
    made = []
    for number, (image, other) in enumerate(zip(images, order), start=1):
        path = str(folder / f"img_{number:02d}.vrt")
        copy = gdal.GetDriverByName("VRT").CreateCopy(path, gdal.Open(image))
        copy.SetMetadata(gdal.Open(images[other]).GetMetadata("RPC"), "RPC")
        copy = None
        made.append(path)
    return made


@pytest.mark.parametrize("kind", ("urban", "mountains"))
@pytest.mark.parametrize("order", ((1, 0), (1, 0, 2)))
@pytest.mark.slow
def test_a_run_with_exchanged_rpcs_makes_no_dsm(request, tmp_path, told, kind, order):
    """The surface was upside down, its correlation with the truth -0.98, and the report said "Good."."""
    images = with_rpcs(request.getfixturevalue(kind).images[: len(order)], order, tmp_path)
    options = {"images": images, "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif"), "workers": 1}
    with pytest.raises(RpcInvalidError, match="img_01 and img_02 have each other's RPC"):
        run_stage("pipeline", options, told())
    assert not (tmp_path / "dsm.tif").exists()


def test_one_rpc_on_two_images_is_refused(urban, tmp_path, told):
    images = with_rpcs(urban.images[:3], (0, 0, 2), tmp_path)
    with pytest.raises(RpcInvalidError, match="img_01 and img_02 have the same RPC: give each image its own"):
        run_stage("epmfit", {"images": images, "workspace": str(tmp_path / "w")}, told())


def drifting(images, px, folder):
    """The images; the RPC of the first is stretched, so that it is off by so many px in its corners."""
    path = str(folder / "img_01.vrt")
    copy = gdal.GetDriverByName("VRT").CreateCopy(path, gdal.Open(images[0]))
    tags = copy.GetMetadata("RPC")
    half = (copy.RasterYSize - 1) / 2
    for name in ("LINE_SCALE", "LINE_OFF"):
        about = half if name == "LINE_OFF" else 0.0
        tags[name] = repr((float(tags[name].split()[0]) - about) * (1 + px / half) + about)
    copy.SetMetadata(tags, "RPC")
    copy = None
    return [path, *images[1:]]


@pytest.mark.parametrize(("px", "outcome"), ((0.0, ""), (4.0, "warned"), (40.0, "refused")))
@pytest.mark.slow
def test_a_trend_that_no_sound_rpc_has_is_not_taken_away_in_silence(urban, tmp_path, told, px, outcome):
    """An affine correction took away 14 px without a word."""
    images, said = drifting(urban.images[:3], px, tmp_path), told()
    options = {"images": images, "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif"), "workers": 1}
    if outcome == "refused":
        with pytest.raises(RpcInvalidError, match=r"The RPC of img_0. needs a correction that changes by \d+\.\d px"):
            run_stage("pipeline", options, said)
        return
    run_stage("pipeline", options, said)
    trends = [text for text in said.warnings if "changes from the middle of an image to its corners" in text]
    assert bool(trends) == (outcome == "warned")
