"""Blocks of small frames with an RPC each: which pairs, where their ties are searched, and the adjustment of all."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from osgeo import ogr

from benchmarks.simulated.frames import exposed, frames_of, make_frames
from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.geometry.footprints import box
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.planning.altitude_range import _near, sweep_altitudes
from repm_qgis.planning.pair_selection import choose_pairs
from repm_qgis.planning.parameters import PLANNING
from repm_qgis.pointing.adjustment import adjust
from repm_qgis.pointing.exchanged import exchanges
from repm_qgis.pointing.parameters import POINTING
from repm_qgis.pointing.pointing import point_views, with_base
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene, load_view
from repm_qgis.simulation.parameters import SIMULATION
from repm_qgis.simulation.scene import SceneSpec
from repm_qgis.simulation.sensor import Look
from repm_qgis.stages import run_stage
from repm_qgis.ties.parameters import TIES
from repm_qgis.ties.tie_patches import BlockPatches, common_ground, is_block
from repm_qgis.ties.tie_points import find_ties
from repm_qgis.ties.tracks import Track

LOOKS = (Look(18.0, 0.8), Look(-18.0, 0.8))
SIZE, GRID = (300, 220), (2, 3)
IN_PATCHES = replace(TIES, patches=replace(TIES.patches, whole_px=200, most_px=130))
"""So that this small block is searched as a large one is."""


class Block:
    """Twelve frames of two passes over low mountains, each with a pointing error of its own."""

    def __init__(self, folder):
        self.spec = replace(
            SceneSpec.default("mountains", 300, 7), cell_m=0.8, surface_step=1, relief_m=40.0, heading_deg=180.0
        )
        self.exposures = frames_of(LOOKS, SIZE, GRID)
        quick = replace(SIMULATION, render=replace(SIMULATION.render, oversample=1))
        self.made = make_frames(self.spec, self.exposures, str(folder / "images"), Silent(), quick)
        self.true = exposed(self.spec, self.exposures)
        fitted = {"images": self.made["images"], "workspace": str(folder / "w"), "tile_size": 300}
        run_stage("epmfit", {**fitted, "altitude_min": 880.0, "altitude_max": 960.0}, Silent())
        self.scene = replace(Scene.load(str(folder / "w" / "scene.json")), refinement="polynomial")
        self.pairs = choose_pairs(self.scene)
        self.stretches = {view.name: view_stretch(view.image, view.band) for view in self.scene.views}

    @property
    def names(self):
        return [pair.names for pair in self.pairs]


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    return Block(tmp_path_factory.mktemp("block"))


def passes(pair):
    return {name.split("_frame")[0] for name in pair}


@pytest.mark.long
def test_frames_lie_where_they_were_aimed(block):
    first = [view for view in block.scene.views if view.name.startswith("pass_1")]
    middles = np.array([view.localise((np.array(view.size) - 1) / 2, 920.0)[:2] for view in first])
    north = middles[:, 1].reshape(GRID[1], GRID[0]) * 111e3
    # A flight to the south: rows of frames follow each other by three quarters of 220 px of 0.8 m.
    assert np.diff(north, axis=0) == pytest.approx(-0.75 * SIZE[1] * 0.8, abs=5.0)
    assert np.ptp(north, axis=1).max() < 5.0


def test_pairs_are_of_two_passes_and_connect_all(block):
    assert all(len(passes(pair)) == 2 for pair in block.names)
    assert {name for pair in block.names for name in pair} == {view.name for view in block.scene.views}
    assert all(pair.base_to_height == pytest.approx(0.7, abs=0.15) for pair in block.pairs)


def test_angles_of_frames_are_those_where_both_look(block):
    """At the middle of a large block, the RPCs of its corners say anything."""
    far = replace(block.scene, frame=replace(block.scene.frame, lat=block.scene.frame.lat + 0.2))
    assert [pair.names for pair in choose_pairs(far)] == block.names
    for here, there in zip(block.pairs, choose_pairs(far)):
        assert there.angle_deg == pytest.approx(here.angle_deg, abs=0.3)


def test_only_frames_that_may_overlap_are_compared(block):
    views = block.scene.views
    near = {(first.name, second.name) for first, second in _near(views, (900.0, 901.0))}
    assert set(block.names) <= near
    away = [replace(view, rpc=replace(view.rpc, lon_off=view.rpc.lon_off + 0.1)) for view in views[:2]]
    assert len(_near([*views, *away], (900.0, 901.0))) == len(near) + 1


def test_each_pair_of_a_block_has_patches_of_its_own(block):
    ground = common_ground(block.scene, block.names)
    numbers = IN_PATCHES.patches
    assert is_block(block.scene, ground, numbers)
    whole = ogr.CreateGeometryFromWkt(block.scene.area)
    assert not is_block(block.scene, {pair: whole for pair in ground}, numbers)
    search = BlockPatches(block.scene, ground, lambda place, pair: 1.0, numbers)
    first = search.first(Silent())
    for pair, shared in ground.items():
        own = [place for place in first if box(place).Intersection(shared).GetArea() > 0.6 * box(place).GetArea()]
        most = shared.GetArea() / box(first[0]).GetArea()
        assert len(own) >= min(2, int(most)), pair
        assert all(pair in search.seeing(place) for place in own)
    for one, other in combinations(first, 2):
        assert box(one).Intersection(box(other)).GetArea() <= 0.5 * box(one).GetArea() + 1e-6
    assert len(first) < 3 * len(ground)  # those of one pair serve its neighbours
    more = search.more(block.names[:1])
    assert not set(more) & set(first)


@pytest.mark.slow
def test_a_block_is_adjusted_as_a_whole(block):
    pointing = replace(POINTING, ties=IN_PATCHES)
    found = point_views(
        block.scene,
        block.pairs,
        block.stretches,
        model="auto",
        gcps=[],
        progress=Silent(),
        workers=1,
        route="rpc",
        parameters=pointing,
    )
    assert found.figures.after_px < 0.15 and found.figures.count > 200
    # What the corrections leave of the errors, apart from moves of the whole, which no image shows.
    middle = np.array([block.spec.lon, block.spec.lat, 920.0])
    rng = np.random.default_rng(2)
    ground = middle + rng.uniform(-1, 1, (200, 3)) * [0.0015, 0.001, 15.0]
    left, moves = [], []
    for view, true in zip(found.views, block.true):
        pixels = true.project(ground)
        inside = ((pixels > 0) & (pixels < view.size)).all(axis=1)
        off = (view.project(ground) - pixels)[inside].mean(axis=0)
        steps = [view.project(middle + step) - view.project(middle) for step in np.eye(3) * [1e-5, 1e-5, 1.0]]
        left.append(off)
        moves.append(np.array(steps).T)
    off, design = np.concatenate(left), np.concatenate(moves)
    rest = off - design @ np.linalg.lstsq(design, off, rcond=None)[0]
    assert np.sqrt(np.mean(rest**2)) < 0.2 < np.sqrt(np.mean(block.made["biases"] ** 2))


def test_a_pair_without_ties_is_left_out_where_others_connect_its_frames(block):
    three = [*block.names[:1], *(pair for pair in block.names[1:] if set(pair) & set(block.names[0]))]
    first, second = block.names[0]
    # Two frames of one pass that share a strip: a pair without many ties, whose frames others connect.
    mates = sorted({name for pair in three for name in pair if passes((name,)) == passes((first,))} - {first})
    weak = (first, mates[0])
    least = replace(IN_PATCHES, matches=replace(TIES.matches, least_ties=40))
    matches = find_ties(block.scene, [*three, weak], block.stretches, progress=Silent(), workers=1, parameters=least)
    counts = {(match.first, match.second): len(match.first_px) for match in matches}
    assert min(counts.values()) >= 40 and set(counts) <= {*three, weak}
    strict = replace(IN_PATCHES, matches=replace(TIES.matches, least_ties=10_000))
    with pytest.raises(EmptyResultError, match=f"{first} and {second} have only [0-9]+ consistent tie points"):
        find_ties(block.scene, block.names[:1], block.stretches, progress=Silent(), workers=1, parameters=strict)


def test_ties_of_one_pass_alone_have_no_height(block):
    views = block.scene.views
    one, other = views[0].name, views[1].name
    third = next(view.name for view in views if view.name.startswith("pass_2"))
    pixel = np.array([10.0, 10.0])
    narrow, wide = Track({one: pixel, other: pixel}), Track({one: pixel, other: pixel, third: pixel})
    assert with_base(views, [narrow, wide], 920.0, POINTING.track_base) == [wide]


def test_neighbouring_frames_of_a_pass_are_not_asked_whether_they_are_exchanged(block):
    views = block.scene.views[:2]
    ground = np.array([block.spec.lon, block.spec.lat, 920.0]) + np.random.default_rng(1).normal(0, 1e-4, (60, 3))
    tracks = [Track({view.name: view.project(place) for view in views}) for place in ground]
    assert list(exchanges(views, tracks, 920.0)) == []
    assert np.isfinite(adjust(views, tracks, 920.0, "shift").residual_px).all()


@pytest.mark.long
def test_the_altitudes_of_a_block_come_from_all_its_parts(block):
    views, bounds = block.scene.views, np.array([tile.bounds for tile in block.scene.tiles])
    whole = (*bounds[:, :2].min(axis=0), *bounds[:, 2:].max(axis=0))
    swept = replace(PLANNING.sweep, cells=40, reduction=4)
    found = sweep_altitudes(views, block.scene.crs, whole, search=(850.0, 1000.0), progress=Silent(), parameters=swept)
    assert found is not None and found.cells > 4 * 400
    low, high = found.altitudes
    assert 850.0 < low < 905.0 and 925.0 < high < 1000.0


def test_frames_have_the_names_of_their_files(block):
    assert [load_view(path).name for path in block.made["images"]] == [one.name for one in block.exposures]
