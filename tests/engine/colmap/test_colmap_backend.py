"""The backend without a GPU: planes swept through its workspaces in COLMAP's place, and every way a GPU can fail."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from repm_qgis.colmap import tile_matching
from repm_qgis.colmap.depth_heights import depth_geometry
from repm_qgis.colmap.parameters import COLMAP
from repm_qgis.colmap.runner import (
    ROOT,
    PatchMatchOptions,
    bytes_allowed,
    bytes_needed,
    colmap_options,
    failure,
    on_gpus,
    run_patch_match,
)
from repm_qgis.colmap.tile_matching import GpuTask, match_tile
from repm_qgis.colmap.workspace import view_intensity, write_workspace
from repm_qgis.contracts.errors import Cancelled, DeviceError, ImageError, OptionError, SceneError
from repm_qgis.contracts.records import HeightMapRecord, ViewPair
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.gridding import grid_points
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.matching import backends, colmap_backend
from repm_qgis.matching.backends import height_source
from repm_qgis.matching.colmap_backend import ColmapBackend
from repm_qgis.runtime.environment import Gpu, cuda_usable
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.engine.colmap.emulation import Workspace, plane_sweep
from tests.engine.colmap.truth_depths import (
    calm_at,
    depths_of,
    middle,
    surface_at,
    true_frame,
    true_heights,
    true_scene,
)
from tests.engine.versions import needs_pycolmap_4

GPU = Gpu(0, "emulated", 8 << 30, 8 << 30)


@pytest.mark.long
def test_images_of_very_different_pixels_are_refused_with_the_backend_to_take(urban):
    scene = true_scene(urban)
    first, second, third = (view.name for view in scene.views)
    views = [replace(view, gsd_m=3 * view.gsd_m if view.name == third else view.gsd_m) for view in scene.views]
    mixed = replace(scene, views=views)
    pairs = [ViewPair(first, second, 20.0, 0.35, 1), ViewPair(second, third, 20.0, 0.35, 1)]
    said = f"BACKEND is 'colmap': it compares .* {second} and {third} are of 0.[0-9]+ m and 1.[0-9]+ m: choose sgm, "
    with pytest.raises(OptionError, match=said):
        ColmapBackend().match(SimpleNamespace(scene=mixed, pairs=pairs), None)
    with pytest.raises(AttributeError, match="options"):  # alike images go on
        ColmapBackend().match(SimpleNamespace(scene=mixed, pairs=pairs[:1]), None)


def nmad(error):
    error = error[np.isfinite(error)]
    return 1.4826 * np.median(np.abs(error - np.median(error)))


def task_of(truth, folder, half=60.0, **settings):
    scene = true_scene(truth)
    names = [view.name for view in scene.views]
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    return GpuTask(
        scene,
        "t",
        middle(truth, half),
        scene.altitudes,
        {name: tuple(other for other in names if other != name) for name in names},
        stretches,
        PatchMatchOptions(**settings),
        str(folder),
        "key",
    )


@pytest.fixture(scope="module")
def matched(urban, tmp_path_factory):
    """A tile of the town, matched by sweeping planes: task and records."""
    task = task_of(urban, tmp_path_factory.mktemp("matched"))
    return task, match_tile(task, GPU, threading.Event(), plane_sweep)


@needs_pycolmap_4
@pytest.mark.parametrize("kind, half, calm_m, worst_px", (("urban", 45.0, 1.0, 0.15), ("mountains", 90.0, 10.0, 0.4)))
@pytest.mark.long
def test_the_best_correlation_is_at_the_true_depth(request, kind, half, calm_m, worst_px, tmp_path):
    """COLMAP's warp of the written images, in single precision: planes through the true depth agree best.

    Away from walls, as level windows take the height of what is highest in them; on slopes they err too.
    """
    truth = request.getfixturevalue(kind)
    scene, tile = true_frame(truth, half)
    names = [view.view.name for view in tile.views]
    images = [view_intensity(view, view_stretch(view.view.image, view.view.band)) for view in tile.views]
    write_workspace(str(tmp_path), scene, tile, images, {names[0]: [names[2]]})
    workspace = Workspace(str(tmp_path))
    heights = true_heights(scene, tile, tile.views[0], truth)
    depth = depths_of(scene, tile, tile.views[0], heights)
    table = depth_geometry(scene, tile, tile.views[0], sources=[tile.views[2]], crs=scene.crs)
    rows, columns = (np.arange(n, dtype=np.float64) for n in heights.shape)
    calm = calm_at(truth, *(axis.on_grid(columns, rows, heights) for axis in (table.x, table.y)), calm_m)
    low, high = tile.depths(scene)
    inverse = np.linspace(1 / high, 1 / low, 160)
    volume = workspace.correlations("0000.png", "0002.png", 1 / inverse, 5)
    best = inverse[volume.argmax(axis=0)]
    known = (depth > 0) & (volume.max(axis=0) > 0.6) & calm
    px = abs((table.height.on_grid(columns, rows, best) - heights)[known]) / table.metres_per_px
    assert known.sum() > 3000
    assert np.median(px) < worst_px


@needs_pycolmap_4
@pytest.mark.long
def test_every_view_gets_a_height_map_of_the_surface(urban, matched):
    task, records = matched
    assert [record.pair[0] for record in records] == [view.name for view in urban.views]
    for record in records:
        heights = height_source(task.scene, task.bounds, record, task.scene.crs).read()
        assert heights.height.shape == record.size[::-1]
        assert record.valid == int(np.isfinite(heights.height).sum()) > 30000
        assert not heights.filled.any() and record.filled == 0
        known = np.isfinite(heights.height)
        np.testing.assert_array_equal(np.isfinite(heights.score), known)
        assert 0.5 < np.median(heights.score[known]) <= 1
        x, y = heights.x[known], heights.y[known]
        error = heights.height[known] - surface_at(urban, x, y)
        calm = error[calm_at(urban, x, y, 1.0)]
        assert nmad(error) < 1.2 and nmad(calm) < 0.15 and abs(np.nanmedian(calm)) < 0.08
        assert record.metres_per_px < 5 and record.vertical_parallax_px < 0.05 and record.table_error_m < 0.01
        assert record.pair[1] in record.sources
        assert HeightMapRecord.from_mapping(json.loads(json.dumps(record.to_mapping()))) == record


@needs_pycolmap_4
@pytest.mark.long
def test_heights_lie_where_another_crs_puts_them(matched):
    from repm_qgis.geometry.frames import geodetic_from_projected

    task, records = matched
    here = height_source(task.scene, task.bounds, records[0], task.scene.crs).read()
    there = height_source(task.scene, task.bounds, records[0], "EPSG:3857").read()
    some = (slice(None, None, 40), slice(None, None, 40))
    a = geodetic_from_projected(task.scene.crs, np.stack([here.x[some], here.y[some]], axis=-1))
    b = geodetic_from_projected("EPSG:3857", np.stack([there.x[some], there.y[some]], axis=-1))
    known = np.isfinite(here.height[some])
    np.testing.assert_allclose(a[known], b[known], atol=1e-7)


@needs_pycolmap_4
@pytest.mark.long
def test_the_same_again_is_reused_and_anything_else_is_not(matched):
    task, records = matched

    def never(*arguments):
        raise AssertionError("matched again")

    again = match_tile(task, GPU, threading.Event(), never)
    assert again == [replace(record, reused=True) for record in records]
    with pytest.raises(AssertionError):
        match_tile(GpuTask(**{**vars(task), "key": "other"}), GPU, threading.Event(), never)


@needs_pycolmap_4
@pytest.mark.long
def test_a_small_gpu_gets_the_tile_in_parts(urban, matched, tmp_path):
    """Parts fit the memory, meet without overlap in the tile, and say the same as the whole."""
    whole, whole_records = matched
    scene, tile = true_frame(urban, 60.0)
    pixels = max(view.size[0] * view.size[1] for view in tile.views)
    small = Gpu(0, "small", 8 << 30, int(bytes_needed(pixels, 2) / COLMAP.patch_match.memory_share) - (8 << 20))
    task, runs = task_of(urban, tmp_path), []

    def sweep(folder, options, fusion, stop):
        runs.append(max(camera.size[0] * camera.size[1] for camera in Workspace(folder).cameras.values()))
        plane_sweep(folder, options, fusion, stop, 100)

    records = match_tile(task, small, threading.Event(), sweep)
    assert len(runs) == 4 and len(records) == 12
    assert all(bytes_needed(count, 2) <= bytes_allowed(small, task.options) for count in runs)
    x0, y0, x1, y1 = task.bounds
    grid = CellGrid.covering(task.bounds, 1.0)

    def raster(record):
        heights = height_source(task.scene, task.bounds, record, task.scene.crs).read()
        return grid_points(grid, heights.x, heights.y, height=heights.height, score=heights.score)[0]

    first = urban.views[0].name
    parts = [raster(record) for record in records if record.pair[0] == first]
    counts = np.sum([np.isfinite(part) for part in parts], axis=0)
    assert (counts > 1).mean() < 0.05  # cells on the borders between parts only
    together = np.nansum(parts, axis=0) / np.where(counts > 0, counts, np.nan)
    difference = together - raster(whole_records[0])
    assert np.isfinite(difference).mean() > 0.6 and nmad(difference) < 0.3


def test_a_gpu_without_room_says_so(urban, tmp_path):
    tiny = Gpu(0, "tiny", 1 << 30, 64 << 20)
    with pytest.raises(DeviceError, match=r"0.05 GiB, and even a small part"):
        match_tile(task_of(urban, tmp_path), tiny, threading.Event(), plane_sweep)
    assert bytes_allowed(GPU, PatchMatchOptions(memory_gib=2)) == 2 << 30


@needs_pycolmap_4
@pytest.mark.long
def test_colmap_s_fusion_decides_where_it_is_asked_to(urban, matched, tmp_path):
    """Fewer heights, and of those no worse ones, than all that are consistent."""
    task, records = matched
    strict = match_tile(task_of(urban, tmp_path, fusion=True), GPU, threading.Event(), plane_sweep)
    for record, other in zip(strict, records):
        assert 0.5 * other.valid < record.valid < other.valid
        errors = []
        for one in (record, other):
            heights = height_source(task.scene, task.bounds, one, task.scene.crs).read()
            error = np.abs(heights.height - surface_at(urban, heights.x, heights.y))
            errors.append((error > 5).sum() / np.isfinite(error).sum())
        assert errors[0] <= errors[1]


def test_fused_points_that_are_none_are_refused(tmp_path):
    for content in (b"", b"no array", None):
        if content is not None:
            (tmp_path / "fused.npy").write_bytes(content)
        with pytest.raises(ImageError, match="fused points"):
            tile_matching._fused(str(tmp_path))
        (tmp_path / "fused.npy").unlink(missing_ok=True)
    np.save(tmp_path / "fused.npy", np.zeros((3, 2)))
    with pytest.raises(ImageError, match="fused points"):
        tile_matching._fused(str(tmp_path))


@needs_pycolmap_4
def test_options_follow_the_frame_and_the_sources():
    options = colmap_options(PatchMatchOptions(geometric=False, window_radius=7), (1.0, 2.0), 1, 3)
    assert (options["depth_min"], options["depth_max"]) == (0.98, 2.02)
    assert (options["gpu_index"], options["window_radius"], options["geom_consistency"]) == ("3", 7, False)
    assert [colmap_options(PatchMatchOptions(), (1, 2), n, 0)["num_samples"] for n in (1, 2, 3, 9)] == [1, 8, 12, 15]
    pycolmap = pytest.importorskip("pycolmap")
    theirs = pycolmap.PatchMatchOptions()
    for name, value in options.items():
        setattr(theirs, name, value)
        assert getattr(theirs, name) == (pytest.approx(value) if isinstance(value, float) else value)


def test_pixels_beside_nodata_have_no_height():
    image = np.ones((20, 20), dtype=np.float32)
    image[10, 10] = np.nan
    kept = tile_matching._surrounded(image, 2)
    assert (~kept).sum() == 25 and not kept[8:13, 8:13].any()


def test_correlation_is_that_of_the_two_neighbourhoods():
    numbers = np.random.default_rng(0)
    a = numbers.random((30, 30)).astype(np.float32)
    b = (0.5 * a + 0.2 * numbers.random((30, 30))).astype(np.float32)
    found = tile_matching._correlation(a, b, 7)
    expected = np.corrcoef(a[10:17, 8:15].ravel(), b[10:17, 8:15].ravel())[0, 1]
    assert found[13, 11] == pytest.approx(expected, abs=1e-3)
    b[0, 0] = np.nan
    assert np.isnan(tile_matching._correlation(a, b, 7)[0, 0])


# What a GPU may do instead of working


def broken(words, code=1):
    """A runner whose COLMAP ends with these words."""

    def run(folder, options, fusion, stop):
        raise failure(f"Processing view 1 / 2\n{words}\n", options["gpu_index"], code)

    return run


@needs_pycolmap_4
@pytest.mark.parametrize(
    "words, expected",
    [
        ("[patch_match_cuda.cu:1500] CUDA error: out of memory", "ran out of memory"),
        ("std::bad_alloc", "ran out of memory"),
        ("Check failed: CUDA error at cudacc.cc: unspecified launch failure", "was lost or refused"),
        ("", "was lost or refused"),
    ],
)
def test_a_lost_or_full_gpu_ends_the_tile_and_leaves_nothing_behind(urban, tmp_path, words, expected):
    with pytest.raises(DeviceError, match=f"GPU 0 {expected}") as caught:
        match_tile(task_of(urban, tmp_path), GPU, threading.Event(), broken(words))
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == []


@needs_pycolmap_4
def test_stock_pycolmap_without_cuda_is_a_device_error(urban, tmp_path):
    """The real process, with the wheel that is installed here: it must refuse, and be heard."""
    pycolmap = pytest.importorskip("pycolmap")
    if pycolmap.has_cuda:
        pytest.skip("this pycolmap has CUDA")
    with pytest.raises(DeviceError, match="(?i)cuda"):
        match_tile(task_of(urban, tmp_path), GPU, threading.Event(), run_patch_match)


@pytest.fixture
def process(tmp_path):
    """process(code): where the engine is whose process runs this in COLMAP's place."""

    def make(code):
        (tmp_path / "repm_qgis" / "colmap").mkdir(parents=True)
        for name in ("repm_qgis/__init__.py", "repm_qgis/colmap/__init__.py"):
            (tmp_path / name).touch()
        (tmp_path / "repm_qgis" / "colmap" / "process.py").write_text(code)
        return tmp_path

    return make


def test_the_process_gets_its_job(tmp_path, process):
    root = process("import shutil, sys\nshutil.copy(sys.argv[1], 'seen.json')\nprint('done')\n")
    run_patch_match(str(tmp_path), {"gpu_index": "0", "depth_min": 1.0}, {"min_num_pixels": 2}, threading.Event(), root)
    assert json.loads((tmp_path / "seen.json").read_text()) == {
        "workspace": str(tmp_path),
        "options": {"gpu_index": "0", "depth_min": 1.0},
        "fusion": {"min_num_pixels": 2},
    }
    assert (tmp_path / "patch_match.log").read_text() == "done\n"


def test_a_process_that_crashes_is_a_lost_gpu(tmp_path, process):
    root = process("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n")
    code = 11 if os.name == "nt" else -11  # Windows ends the process with the number
    with pytest.raises(DeviceError, match=f"GPU 2 was lost or refused the work \\('exit code {code}'"):
        run_patch_match(str(tmp_path), {"gpu_index": "2"}, None, threading.Event(), root)


def test_a_running_match_is_ended_by_cancel(tmp_path, process):
    root = process("import time\ntime.sleep(60)\n")
    stop = threading.Event()
    threading.Timer(0.5, stop.set).start()
    start = time.monotonic()
    with pytest.raises(Cancelled):
        run_patch_match(str(tmp_path), {"gpu_index": "0"}, None, stop, root)
    assert time.monotonic() - start < 5


def test_one_worker_a_gpu(told):
    busy, most, lock, used = {}, {}, threading.Lock(), []

    def work(task, gpu, stop):
        with lock:
            busy[gpu.index] = busy.get(gpu.index, 0) + 1
            most[gpu.index] = max(most.get(gpu.index, 0), busy[gpu.index])
            used.append(gpu.index)
        time.sleep(0.05)
        with lock:
            busy[gpu.index] -= 1
        if task == 3:
            raise DeviceError("full")
        return task * 10

    gpus = [Gpu(i, "x", 1, 1) for i in range(2)]
    results = on_gpus(work, list(range(6)), gpus, told(), str)
    assert [r for i, r in enumerate(results) if i != 3] == [0, 10, 20, 40, 50] and isinstance(results[3], DeviceError)
    assert most == {0: 1, 1: 1}


def test_cancel_reaches_the_workers(told):
    ended = []

    def work(task, gpu, stop):
        ended.append(stop.wait(10))
        raise Cancelled

    with pytest.raises(Cancelled):
        on_gpus(work, [1, 2], [GPU], told(cancel_at=2), str)
    assert ended == [True]


def test_a_bug_in_a_worker_is_not_a_device_error(told):
    def work(task, gpu, stop):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        on_gpus(work, [1], [GPU], told(), str)


# The stage


@pytest.fixture
def with_gpu(monkeypatch):
    """with_gpu(runner): a machine with one GPU on which this runs in COLMAP's place."""

    def make(run):
        monkeypatch.setattr(colmap_backend, "cuda_usable", lambda: True)
        monkeypatch.setattr(colmap_backend, "cuda", lambda: {"remedy": ""})
        monkeypatch.setattr(colmap_backend, "BACKEND", ColmapBackend(run, lambda: [GPU]))
        monkeypatch.setattr(backends, "_PREFERRED", ("colmap", "sgm"))  # as if it were better

    return make


@pytest.fixture(scope="module")
def refined(urban, tmp_path_factory):
    folder = tmp_path_factory.mktemp("refined")
    from tests.engine.conftest import Told

    run_stage("epmfit", {"images": urban.images[:2], "workspace": str(folder), "tile_size": 256}, Told())
    run_stage(
        "refine",
        {"scene": str(folder / "scene.json"), "output_scene": str(folder / "refined.json"), "write_images": False},
        Told(),
    )
    return str(folder / "refined.json")


def reconstruct(refined, folder, said, **options):
    return run_stage(
        "reconstruct", {"scene": refined, "output_scene": str(folder / "done.json"), "workers": 1, **options}, said
    )


@needs_pycolmap_4
@pytest.mark.long
def test_the_whole_way_to_a_dsm(urban, refined, tmp_path, with_gpu, told):
    with_gpu(functools.partial(plane_sweep, count=120))
    said = told()
    reconstruct(refined, tmp_path, said, backend="auto")
    scene = Scene.load(str(tmp_path / "done.json"))
    assert scene.backend == "colmap"
    assert not any("Tile" in text for text in said.warnings)
    for tile in scene.tiles:
        assert sorted(record.pair[0] for record in tile.heights) == sorted(view.name for view in urban.views[:2])
    run_stage(
        "dsmfuse",
        {"scene": str(tmp_path / "done.json"), "output": str(tmp_path / "dsm.tif"), "resolution": 0.5},
        told(),
    )
    facts = run_stage("comparedsm", {"dsm": str(tmp_path / "dsm.tif"), "reference": urban.truth, "align": "3d"}, told())
    assert facts.nmad < 1.0  # level windows at roofs' edges; what PatchMatchOptions itself gives needs a GPU
    again = told()
    reconstruct(refined, tmp_path, again, backend="auto")
    assert any("Reused" in note for note in again.notes)


@needs_pycolmap_4
@pytest.mark.long
def test_auto_falls_back_to_the_cpu_for_a_tile_and_says_so(refined, tmp_path, with_gpu, told):
    calls = []

    def once(folder, options, fusion, stop):
        calls.append(folder)
        if len(calls) == 1:
            broken("CUDA error: out of memory")(folder, options, fusion, stop)
        plane_sweep(folder, options, fusion, stop, 60)

    with_gpu(once)
    said = told()
    made = reconstruct(refined, tmp_path, said, backend="auto")
    scene = Scene.load(str(tmp_path / "done.json"))
    first, *others = scene.tiles
    assert all(record.backend == "sgm" for record in first.heights) and first.heights
    assert others and all(record.backend == "colmap" for tile in others for record in tile.heights)
    warning = f"Tile {first.id} was matched by sgm instead: GPU 0 ran out of memory"
    assert any(text.startswith(warning) for text in said.warnings)
    with open(made.report, encoding="utf-8") as stream:
        assert "was matched by sgm instead" in stream.read()
    run_stage("dsmfuse", {"scene": str(tmp_path / "done.json"), "output": str(tmp_path / "dsm.tif")}, told())


@needs_pycolmap_4
@pytest.mark.long
def test_colmap_by_name_names_the_tile_without_heights(refined, tmp_path, with_gpu, told):
    calls = []

    def once(folder, options, fusion, stop):
        calls.append(folder)
        if len(calls) == 1:
            broken("CUDA error: device lost")(folder, options, fusion, stop)
        plane_sweep(folder, options, fusion, stop, 60)

    with_gpu(once)
    said = told()
    reconstruct(refined, tmp_path, said, backend="colmap")
    assert any("has no heights: GPU 0 was lost" in text for text in said.warnings)
    with_gpu(broken("CUDA error: device lost"))
    with pytest.raises(DeviceError, match="GPU 0 was lost"):
        reconstruct(refined, tmp_path / "all", told(), backend="colmap")


def test_colmap_without_cuda_refuses_before_any_work(refined, tmp_path, told, urban):
    if cuda_usable():
        pytest.skip("this machine has CUDA")
    for stage, options in (
        ("reconstruct", {"scene": refined, "output_scene": str(tmp_path / "x" / "done.json")}),
        (
            "pipeline",
            {"images": urban.images, "workspace": str(tmp_path / "x"), "output": str(tmp_path / "x" / "dsm.tif")},
        ),
    ):
        with pytest.raises(DeviceError, match="pycolmap") as caught:
            run_stage(stage, {**options, "backend": "colmap"}, told())
        assert str(caught.value).startswith("BACKEND colmap needs CUDA") and "\n" not in str(caught.value)
    assert not (tmp_path / "x").exists()


@needs_pycolmap_4
@pytest.mark.long
def test_a_height_map_of_another_scene_is_refused(matched, tmp_path):
    task, records = matched
    for change in (
        {"views": [records[0].pair[0]]},
        {"bounds": [0.0, 0.0, 10.0, 10.0]},
        {"file": str(tmp_path / "none.tif")},
    ):
        with pytest.raises(SceneError, match="again"):
            height_source(task.scene, task.bounds, replace(records[0], **change), task.scene.crs).read()


def test_auto_is_sgm_where_no_device_answers(monkeypatch):
    def names(option):
        return [backend.name for backend in backends.resolve(option)]

    monkeypatch.setattr(colmap_backend, "cuda_usable", lambda: False)
    assert names("auto") == names("sgm") == ["sgm"]
    monkeypatch.setattr(colmap_backend, "cuda_usable", lambda: True)
    assert names("auto") == ["sgm"], "COLMAP on CUDA was measured nowhere"
    monkeypatch.setattr(backends, "_PREFERRED", ("colmap", "sgm"))
    assert names("auto") == ["colmap", "sgm"]


def test_the_process_says_what_is_wrong(tmp_path):
    job = tmp_path / "job.json"
    job.write_text(json.dumps({"workspace": str(tmp_path), "options": {"no_such_option": 1}}))
    done = subprocess.run(
        [sys.executable, "-m", "repm_qgis.colmap.process", str(job)],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert done.returncode and "no_such_option" in done.stderr
