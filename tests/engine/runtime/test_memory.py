"""Estimates against measured peaks, and how many workers a budget leaves."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from repm_qgis.contracts.errors import OptionError
from repm_qgis.fusion.aggregation import HeightLayer, aggregate
from repm_qgis.imagery.raster import RasterFrame, created
from repm_qgis.runtime import memory
from repm_qgis.runtime.memory import (
    colouring_mib,
    fitting_mib,
    free_mib,
    fusing_mib,
    gathering_mib,
    largest_tile,
    matching_mib,
    refining_mib,
    tile_work,
    workers_within,
)

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
BEGIN = """
import json, sys
from repm_qgis.contracts.arrays import Bounds
from repm_qgis.runtime.parallel import begin_worker
begin_worker()
from repm_qgis.scene import Scene
path, side, extra, out = sys.argv[1], float(sys.argv[2]), float(sys.argv[3]), sys.argv[4]
scene = Scene.load(path)
tile = scene.tiles[0]
def end(*facts):
    peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
    print(json.dumps([int(peak.split()[1]) / 1024, *facts]))
"""
MATCHING = (
    BEGIN
    + """
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.matching.pair_backend import PairTask, frame_size, match_to_disk
from repm_qgis.matching.sgm import BACKEND
x, y = (tile.bounds[0] + tile.bounds[2]) / 2, (tile.bounds[1] + tile.bounds[3]) / 2
half = side * scene.gsd_m / 2
first, second = scene.views[:2]
task = PairTask(BACKEND, scene.lean(), "t", Bounds(x - half, y - half, x + half, y + half),
                (tile.altitudes[0] - extra, tile.altitudes[1] + extra), (first.name, second.name),
                tuple(view_stretch(v.image, v.band) for v in (first, second)), f"{out}{side}{extra}.tif", "key")
record = match_to_disk(task)
end(*frame_size(task), (task.altitudes[1] - task.altitudes[0]) / record.metres_per_px)
"""
)
FUSING = (
    BEGIN
    + """
from repm_qgis.fusion.layout import DsmLayout
from repm_qgis.fusion.tile_fusion import FuseTask, fuse_to_disk
from repm_qgis.geometry.vertical import HeightDatum
records = tuple(tile.heights[:1] * int(extra))
layout = DsmLayout.of(scene, [tile], scene.crs, HeightDatum.of(""), side)
grid, windows = layout.grid, layout.windows
task = FuseTask(scene.lean(), tile.bounds, records, grid, windows[0], scene.crs, radius=1.5)
fuse_to_disk((task, f"{out}{side}{extra}.npz"))
end([record.pixels for record in records], grid.shape[0] * grid.shape[1])
"""
)
GATHERING = (
    BEGIN
    + """
from pathlib import Path
from repm_qgis.contracts.arrays import Window
from repm_qgis.fusion.finished import FinishedSurface
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.solids.cloud import CloudTask, gather
dsm = FinishedSurface.of(str(Path(out).parent / "dsm.tif"), scene.crs, HeightDatum.of(""))
records, window = tuple(tile.heights[:1] * int(side)), dsm.grid.window(tile.bounds)
gather(CloudTask(scene.lean(), tile.bounds, records, dsm, window, f"{out}{side}{extra}.npy", bool(extra)))
end([record.pixels for record in records], window.width * window.height)
"""
)
COLOURING = (
    BEGIN
    + """
from dataclasses import replace
from pathlib import Path
from repm_qgis.contracts.arrays import Window
from repm_qgis.fusion.finished import FinishedSurface
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.ortho.colour_blocks import ColourTask, block
from repm_qgis.ortho.colour_sources import ColourPlan, ColourSource
from repm_qgis.ortho.parameters import ORTHO
from repm_qgis.ortho.seen_surface import SeenSurface
views, bands = int(side), int(extra)
dsm = FinishedSurface.of(str(Path(out).parent / "dsm.tif"), scene.crs, HeightDatum.of(""))
own = Window(0, 0, *dsm.grid.size)
sources = tuple(ColourSource(scene.views[i % 2], (1,) * bands) for i in range(views))
plan = ColourPlan(sources, tuple("abcdef"[:bands]), False, "uint16")
every = replace(ORTHO, colour=replace(ORTHO.colour, least_views=views, most_views=views))
seen = replace(SeenSurface.of(dsm, scene.views), level=0.0, reach=200)
block(ColourTask(plan, seen, 1, every, own, (20.0,) * bands, f"{out}{side}{extra}.npy"))
end(own.width * own.height, views, bands)
"""
)
REFINING = (
    BEGIN
    + """
from repm_qgis.stages.refine import RefineTask, _refined
_refined(RefineTask(scene.lean(), (tile,), "bilinear" if side else None))
end(max(view.window.width for view in tile.views.values()) if side else 0)
"""
)
CHOOSING = """
import json, sys
from repm_qgis.runtime.parallel import begin_worker
begin_worker()
from repm_qgis.contracts.arrays import Window
from repm_qgis.fusion.joining import JoinedTiles
from repm_qgis.fusion.surface import Block, SurfaceTask, make_block
from repm_qgis.geometry.cell_grid import CellGrid
folder, side, walls = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
whole = Window(0, 0, side, side)
joined = JoinedTiles(whole, folder + "/joined.tif", 0, folder + "/shaded.tif" if walls else "")
lights = (Block(whole, folder + "/light.npy"),) if walls else ()
grid = CellGrid(0.0, side * 0.5, 0.5, (side, side))
make_block(SurfaceTask(Block(whole, folder + "/made.npy"), whole, joined, grid, lights, True, 20))
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps(int(peak.split()[1]) / 1024))
"""
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux gives the peak")


@pytest.fixture(scope="module")
def measured(shared_data, pipeline, tmp_path_factory):
    """measured(code, side, extra): the peak of a process that does one task on truth_urban, MiB, and facts of it."""
    folder = tmp_path_factory.mktemp("memory")
    images = [str(shared_data / "truth_urban" / f"img_0{i}.tif") for i in (1, 2)]
    scene = pipeline(
        SimpleNamespace(images=images), folder, confidence=None, ortho=None, cloud=None, workers=1
    ).result.scene

    def measure(code, side, extra):
        done = subprocess.run(
            [sys.executable, "-c", code, scene, str(side), str(extra), str(folder / "made")],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        )
        return json.loads(done.stdout)

    return measure


@linux
@pytest.mark.parametrize("side, extra", ((300, 0.0), (1400, 0.0), (1400, 300.0)))
@pytest.mark.slow
def test_the_estimate_of_matching_is_right_within_a_half(measured, side, extra):
    peak, *facts = measured(MATCHING, side, extra)
    assert peak / 1.5 < matching_mib(*facts) < 1.5 * peak


@linux
@pytest.mark.slow
def test_the_estimate_knows_that_eight_directions_keep_all_costs(measured):
    code = MATCHING.replace("task = PairTask(", "task = replace(PairTask(").replace(
        '"key")', '"key"), parameters=BEST)'
    )
    best = "from dataclasses import replace\nfrom repm_qgis.stages.parameters import ENGINE\n"
    best += 'BEST = ENGINE.of_quality("best").matching\n'
    peak, *facts = measured(best + code, 1350, 0.0)  # a side of its own: a map that is there is reused
    assert peak / 1.5 < matching_mib(*facts, paths=8) < 1.5 * peak
    assert peak > 1.2 * matching_mib(*facts)


@linux
@pytest.mark.parametrize("cell, maps", ((1.0, 1), (0.5, 6), (0.25, 3)))
@pytest.mark.slow
def test_the_estimate_of_fusing_is_right_within_a_half(measured, cell, maps):
    peak, *facts = measured(FUSING, cell, maps)
    assert peak / 1.5 < fusing_mib(*facts) < 1.5 * peak


@linux
@pytest.mark.parametrize("views, bands", ((1, 3), (6, 3), (4, 4), (10, 3)))
@pytest.mark.slow
def test_the_estimate_of_colouring_is_right_within_a_fifth(measured, views, bands):
    peak, *facts = measured(COLOURING, views, bands)
    assert peak / 1.2 < colouring_mib(*facts) < 1.2 * peak


@linux
@pytest.mark.parametrize("writes", (False, True))
def test_the_estimate_of_refining_is_right_within_a_tenth(measured, writes):
    peak, width = measured(REFINING, int(writes), 0)
    assert peak / 1.1 < refining_mib(width) < 1.1 * peak


@linux
@pytest.mark.parametrize("maps, normals", ((1, False), (4, False), (2, True)))
@pytest.mark.slow
def test_the_estimate_of_gathering_points_is_right_within_a_half(measured, maps, normals):
    peak, *facts = measured(GATHERING, maps, int(normals))
    assert peak / 1.5 < gathering_mib(*facts) < 1.5 * peak


@linux
@pytest.mark.parametrize("side, walls", ((150, True), (1200, False), (1200, True)))
@pytest.mark.slow
def test_the_estimate_of_choosing_heights_is_right_within_a_half(tmp_path, side, walls):
    """Roofs all over the block, a third of the maps displaced, and ground in shadows."""
    rng = np.random.default_rng(1)
    surface = np.full((side, side), 100.0)
    for row, column in rng.integers(0, side, (side**2 // 900, 2)):
        surface[row : row + 14, column : column + 14] = 110.0
    nothing, score = np.full(surface.shape, np.nan), np.full(surface.shape, 0.9)
    layers = [HeightLayer(np.roll(surface, shift, 1), score, nothing, 1.0, 1.0) for shift in (0, 0, 3)]
    ground = np.where(rng.uniform(size=surface.shape) < 0.1, np.float32(100), np.float32(np.nan))
    for name, parts in (("joined", aggregate(layers, "median", 2).arrays()), ("shaded", (ground,))):
        frame = RasterFrame(surface.shape, np.float32, len(parts))
        with created(str(tmp_path / f"{name}.tif"), frame, compress=False) as raster:
            for band, values in enumerate(parts, start=1):
                raster.write(values, 0, 0, band)
    np.save(tmp_path / "light.npy", (surface > 105).astype(np.float32))
    command = [sys.executable, "-c", CHOOSING, str(tmp_path), str(side), str(int(walls))]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    peak = json.loads(done.stdout)
    assert peak / 1.5 < fitting_mib(side**2) < 1.5 * peak
    assert np.isfinite(np.load(tmp_path / "made.npy")[0]).all()


def test_a_budget_bounds_the_workers_and_says_so(told):
    said = told()
    assert workers_within(8, tile_work(1600, 300.0), 1000, said) == 3
    assert said.notes == ["3 instead of 8 workers: each takes up to 300 MiB, and 1000 MiB are allowed."]
    assert workers_within(2, tile_work(1600, 300.0), 1000, said) == 2
    assert len(said.notes) == 1 and not said.warnings


def test_a_tile_that_is_too_large_names_the_remedy(told):
    with pytest.raises(
        OptionError,
        match="MEMORY is 200: it is less than the 420 MiB that one tile of 1600 px takes; "
        "allow more, or choose a TILE_SIZE of 760 px or less",
    ):
        workers_within(2, tile_work(1600, 420.0), 200, told())
    side = largest_tile(1600, matching_mib(1600, 1600, 0), 200.0)
    assert matching_mib(side, side, 0) < 200.0


@pytest.mark.parametrize("allowed", (100, 126))
def test_no_tile_is_named_where_none_is_small_enough(told, allowed):
    """A worker alone takes as much: TILE_SIZE=256, the smallest, would end with the same error."""
    with pytest.raises(OptionError, match="allow more, or use a machine with more memory, as no tile is small enough"):
        workers_within(2, tile_work(600, 160.0), allowed, told())


def test_without_a_budget_free_memory_decides(told, monkeypatch):
    said = told()
    monkeypatch.setattr(memory, "free_mib", lambda: 1000.0)
    assert workers_within(8, tile_work(1600, 300.0), 0, said) == 2
    assert workers_within(8, tile_work(1600, 800.0), 0, said) == 1
    assert any("only 1000 MiB are free" in text and "TILE_SIZE" in text for text in said.notes)
    monkeypatch.setattr(memory, "free_mib", lambda: None)
    assert workers_within(8, tile_work(1600, 1e9), 0, said) == 8


def test_free_memory_is_what_the_machine_has():
    found = free_mib()
    if found is None:
        pytest.skip("this system does not say")
    assert 16 < found < 1 << 24


@pytest.mark.slow
def test_a_dsm_does_not_depend_on_the_budget(urban, tmp_path, pipeline):
    """Enough for one worker and for many: the same bytes; too little: a sentence."""
    options = {
        "images": urban.images[:2],
        "resolution": 0.5,
        "tile_size": 256,
        "confidence": None,
        "ortho": None,
        "cloud": None,
        "workers": 2,
    }
    runs = [pipeline(urban, tmp_path / str(budget), memory=budget, **options) for budget in (200, 4000)]
    assert any("1 instead of 2 workers" in note for note in runs[0].said.notes)
    assert not any("instead of" in note for note in runs[1].said.notes)
    first, second = (Path(run.result.output).read_bytes() for run in runs)
    assert first == second
    with pytest.raises(OptionError, match="MEMORY is 100"):
        pipeline(urban, tmp_path / "little", memory=100, **options)
