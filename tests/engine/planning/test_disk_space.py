"""Estimates of disk space against measured runs, and what is refused."""

from __future__ import annotations

import os
import shutil
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from repm_qgis.contracts.errors import WorkspaceError
from repm_qgis.contracts.options import DsmFuseOptions
from repm_qgis.contracts.products import PIPELINE, products_of
from repm_qgis.geometry.finer_cells import finer_cell
from repm_qgis.ortho.parameters import ORTHO
from repm_qgis.planning import disk_space
from repm_qgis.planning.disk_space import Need, fusion_needs, heights_need, images_need, require_space
from repm_qgis.runtime.workspace import size_of
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage

pytestmark = pytest.mark.long

MIB = 1 << 20
PRODUCTS = {
    "output": "dsm.tif",
    "confidence": "confidence.tif",
    "ortho": "ortho.tif",
    "cloud": "a.laz",
    "ept": "ept",
    "mesh": "a.ply",
}


class Peak(threading.Thread):
    """The most that a folder has held."""

    def __init__(self, folder):
        super().__init__(daemon=True)
        self.folder, self.most, self.over = folder, 0, threading.Event()

    def run(self):
        while not self.over.wait(0.01):
            try:
                self.most = max(self.most, size_of(str(self.folder)))
            except OSError:  # a file that has just gone
                continue


@pytest.fixture(scope="module")
def measured(urban, tmp_path_factory, told):
    """The scene of a whole run, its options for fusion, and the most that it had on the disk."""
    folder = tmp_path_factory.mktemp("space")
    made = {name: str(folder / file) for name, file in PRODUCTS.items()}
    peak, said = Peak(folder), told()
    peak.start()
    job = {"images": urban.images, "workspace": str(folder / "w"), "workers": 1, **made}
    scene = run_stage("pipeline", job, said).scene
    peak.over.set()
    peak.join()
    return Scene.load(scene), DsmFuseOptions(scene=scene, **made), peak.most, said


def test_the_estimate_is_a_lower_bound_of_what_a_run_writes(measured):
    scene, options, peak, _ = measured
    cell = 2 * scene.gsd_m
    maps = sum(os.path.getsize(record.file) for tile in scene.tiles for record in tile.heights)
    heights = heights_need(scene, scene.pairs, "/nowhere")
    assert heights.least < maps < 3 * heights.least
    folder = Path(scene.path).parent
    assert not (folder / "fusion").exists()
    ortho = finer_cell(cell, min(view.gsd_m for view in scene.views), ORTHO.nested)
    needs = [heights, *fusion_needs(scene, scene.pairs, options, cell, ortho_cell=ortho)]
    least = sum(need.least for need in needs)
    assert least < peak < 3.5 * least
    for need in needs[2:]:
        if need.path != options.ept:  # which takes more while it is built
            assert need.least < size_of(need.path) < 4 * need.least, need


def test_what_an_earlier_run_has_left_is_not_needed_again(measured):
    scene, _, _, _ = measured
    folder = str(Path(scene.tiles[0].heights[0].file).parent)
    assert heights_need(scene, scene.pairs, folder).least == 0


def test_refined_images(measured, tmp_path, told):
    folder = Path(measured[0].path).parent
    result = run_stage(
        "refine", {"scene": str(folder / "scene.json"), "output_scene": str(tmp_path / "refined.json")}, told()
    )
    images = sum(path.stat().st_size for path in tmp_path.rglob("*.tif"))
    least = images_need(Scene.load(result.output_scene), str(tmp_path)).least
    assert least < images < 4 * least


def test_every_product_of_fusion_counts(tmp_path):
    """A product without bytes here would be forgotten."""
    options = {each.option: str(tmp_path / each.option) for each in products_of(PIPELINE[-1])}
    options.update(cloud=str(tmp_path / "cloud.laz"), mesh=str(tmp_path / "mesh.ply"), viewer=str(tmp_path / "v.html"))
    options.update(stac=str(tmp_path / "dsm.json"))
    scene = Scene.__new__(Scene)
    values = {"path": tmp_path / "s.json", "area": "POLYGON((0 0,0 100,100 100,100 0,0 0))", "views": (), "pairs": ()}
    for name, value in values.items():
        object.__setattr__(scene, name, value)

    class Pair:
        share = 1.0

    class View:
        gsd_m = 0.5

    object.__setattr__(scene, "views", (View,))
    needs = fusion_needs(scene, [Pair], DsmFuseOptions(scene="s.json", **options), 1.0)
    assert set(options.values()) <= {need.path for need in needs if need.expected > 0}


def test_a_disk_that_cannot_hold_it_is_refused_with_the_figures(tmp_path, told, monkeypatch):
    needs = [Need(str(tmp_path / "new" / "w"), 3 * MIB, 9 * MIB), Need(str(tmp_path / "a.tif"), MIB, 3 * MIB)]
    monkeypatch.setattr(disk_space, "free_bytes", lambda path: 3.9 * MIB)
    with pytest.raises(WorkspaceError) as caught:
        require_space("fusion", needs, told())
    place = tmp_path / "new" / "w"
    assert str(caught.value) == (
        f"The disk of '{place}' has 3.9 MiB free, and fusion writes at least 4.0 MiB there: free some space, or choose "
        "a place on another disk."
    )
    said = told()
    monkeypatch.setattr(disk_space, "free_bytes", lambda path: 5 * MIB)
    require_space("fusion", needs, said)
    text = f"Fusion will write about 12.0 MiB on the disk of '{place}' (5.0 MiB free)"
    assert said.notes == [f"{text}: if it fills up, free some space and run again, which continues there."]
    monkeypatch.setattr(disk_space, "free_bytes", lambda path: 3 << 30)
    require_space("fusion", needs, said)
    assert said.notes[1:] == ["Fusion will write about 12.0 MiB on the disk of '" + str(place) + "' (3.0 GiB free)."]
    monkeypatch.setattr(disk_space, "free_bytes", lambda path: None)
    require_space("fusion", needs, said)


def test_each_disk_counts_for_itself(tmp_path, told, monkeypatch):
    class Status:
        def __init__(self, place):
            self.st_dev = "other" in place

    (tmp_path / "other").mkdir()
    # Of this module alone: on Windows paths ask os.stat whether something is a folder.
    monkeypatch.setattr(disk_space, "os", SimpleNamespace(**{**vars(os), "stat": Status}))
    monkeypatch.setattr(disk_space, "free_bytes", lambda path: 5 * MIB if "other" in path else 20 * MIB)
    needs = [Need(str(tmp_path / "w"), 9 * MIB, 9 * MIB), Need(str(tmp_path / "other" / "a"), 4 * MIB, 4 * MIB)]
    said = told()
    require_space("this run", needs, said)
    assert len(said.notes) == 2 and "9.0 MiB" in said.notes[0] and "4.0 MiB" in said.notes[1]
    needs.append(Need(str(tmp_path / "other" / "b"), 2 * MIB, 2 * MIB))
    with pytest.raises(WorkspaceError, match=r"other[/\\]a' has 5.0 MiB free, and this run writes at least 6.0 MiB"):
        require_space("this run", needs, said)


def test_the_pipeline_says_it_and_refuses_before_it_matches(urban, measured, tmp_path, told, monkeypatch):
    notes = measured[3].notes
    assert [note.split(" will ")[0] for note in notes if " will write about " in note] == [
        "This run",
        "Matching",
        "Fusion",
    ]
    monkeypatch.setattr(disk_space, "free_bytes", lambda path: MIB // 10)
    job = {"images": urban.images, "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif")}
    with pytest.raises(WorkspaceError, match="has 0.1 MiB free, and this run writes at least"):
        run_stage("pipeline", job, told())
    assert not list(tmp_path.rglob("*heights/*.tif")) and not (tmp_path / "dsm.tif").exists()
    shutil.rmtree(tmp_path / "w")
