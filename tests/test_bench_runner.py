"""What benchmarks share: programs that are there, absent or broken, process trees, scores, tables and pages."""

from __future__ import annotations

import os
import stat
import subprocess
import sys

import numpy as np
import pytest
from osgeo import gdal

from benchmarks import __main__ as every
from benchmarks import runner
from benchmarks.programs import peer
from benchmarks.runner import ROOT, Failed, alone, few, measured
from benchmarks.scoring import difference, scores, shares
from benchmarks.tables import Details, Section, publish, table

_COPIES = """#!{python}
import json, os, shutil, sys
config = json.load(open(sys.argv[1]))
images = [entry["img"] for entry in config["images"]]
os.makedirs(config["out_dir"])
shutil.copy(images[0], os.path.join(config["out_dir"], "dsm.tif"))
"""


def raster(path, values, west=0.0):
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), values.shape[1], values.shape[0], 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((west, 0.5, 0, 100, 0, -0.5))
    reference = gdal.osr.SpatialReference()
    reference.ImportFromEPSG(32631)
    dataset.SetProjection(reference.ExportToWkt())
    dataset.GetRasterBand(1).WriteArray(values)
    dataset.GetRasterBand(1).SetNoDataValue(-9999)
    dataset = None
    return str(path)


@pytest.fixture
def program(tmp_path, monkeypatch):
    """program(name, text): an executable on a PATH of its own."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))

    def make(name, text):
        path = folder / name
        path.write_text(text.format(python=sys.executable))
        path.chmod(path.stat().st_mode | stat.S_IXUSR)

    return make


def test_a_program_that_is_not_there_is_said_to_be(program, tmp_path):
    with pytest.raises(Failed, match="not on PATH"):
        peer("s2p", ["a.tif"], 0.5, tmp_path / "work")


def test_a_program_that_is_there_is_run_on_the_same_images(program, tmp_path):
    program("s2p", _COPIES)
    image = raster(tmp_path / "a.tif", np.ones((20, 20), np.float32))
    dsm, cost = peer("s2p", [image, image], 0.5, tmp_path / "work")
    assert gdal.Open(dsm).ReadAsArray().mean() == 1.0 and cost.wall_s > 0 and cost.cpu_s > 0


def test_a_program_that_fails_or_leaves_nothing_is_no_end(program, tmp_path):
    program("cars", "#!{python}\nimport sys\nsys.exit('no licence')\n")
    with pytest.raises(Failed, match="ended with code 1: no licence"):
        peer("cars", ["a.tif", "b.tif"], 0.5, tmp_path / "one")
    program("cars", "#!{python}\n")
    with pytest.raises(Failed, match="left no out/dsm/dsm.tif"):
        peer("cars", ["a.tif", "b.tif"], 0.5, tmp_path / "two")


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="no /proc here")
def test_the_whole_process_tree_counts(tmp_path):
    child = "import time; block = bytearray(b'x') * (120 << 20); time.sleep(1.0)"
    script = (
        "import subprocess, sys; "
        f"children = [subprocess.Popen([sys.executable, '-c', {child!r}]) for _ in range(2)]; "
        "[c.wait() for c in children]; print('done')"
    )
    said, cost = measured([sys.executable, "-c", script])
    assert said == "done\n" and 0.23 < cost.peak_gib < 0.4 and cost.wall_s > 1 and cost.cpu_s < cost.wall_s + 5


def test_scores_are_those_of_the_cells(tmp_path):
    rng = np.random.default_rng(0)
    ground = rng.normal(0, 20, (120, 130)).astype(np.float32)
    truth = raster(tmp_path / "truth.tif", ground)
    moved = np.roll(ground, (3, -2), (0, 1)) + np.float32(7.0)
    moved[50:56, 60:70] += 3.0
    moved[80:90, 20:30] = -9999
    dsm = raster(tmp_path / "dsm.tif", moved)
    found = scores(dsm, truth, True)
    cells = (120 - 3) * (130 - 2)
    assert found.valid == pytest.approx(100 * (1 - 100 / cells), abs=1e-6)
    within = shares(found)
    assert within[0] == pytest.approx(100 * (1 - 160 / cells), abs=1e-6)
    assert within[2] == pytest.approx(found.valid, abs=1e-6)
    assert found.rmse == pytest.approx(np.sqrt(60 * 9 / (cells - 100)), abs=1e-4) and found.medae < 1e-4
    raw = scores(raster(tmp_path / "same.tif", ground + np.float32(0.25)), truth, False)
    assert raw.medae == pytest.approx(0.25, abs=1e-4) and raw.nmad < 1e-4 and raw.valid == 100.0
    apart = difference(dsm, raster(tmp_path / "west.tif", moved[:, 10:] + np.float32(1.0), 5.0))
    assert apart.shape == (120, 120) and np.isnan(apart).sum() == 100 and np.nanmax(np.abs(apart + 1)) < 1e-4


def add(a, b):
    return {"sum": a + b, "process": os.getpid()}


def test_a_function_runs_alone_and_says_what_it_used():
    used = alone(add, 2, 3)
    assert used.result["sum"] == 5 and used.result["process"] != os.getpid()
    assert used.cpu_s > 0 and used.mib > 10
    with pytest.raises(Failed, match="TypeError"):
        alone(add, 2)


def test_a_section_is_written_in_the_place_of_the_last_one(tmp_path):
    (tmp_path / "cluster.md").write_text("# Clusters\n\nHow to read this.\n", encoding="utf-8")
    section = Section("speed", "Speed", "make bench-speed", {}, "cluster.md")
    publish(section, ["old", table("a | b", [[1, 2.34567]])], tmp_path)
    publish(Section("other", "Other", "make bench-other", {}, "cluster.md"), ["kept"], tmp_path)
    publish(section, ["new"], tmp_path)
    page = (tmp_path / "cluster.md").read_text(encoding="utf-8")
    assert page.startswith("# Clusters\n\nHow to read this.\n") and page.count("## Speed") == 1
    assert "new" in page and "kept" in page and "old" not in page
    assert page.index("## Speed") < page.index("## Other")


def test_a_section_without_a_page_has_its_own(tmp_path):
    section = Section("speed", "Speed", "make bench-speed", {})
    publish(section, ["old"], tmp_path)
    publish(section, ["new", Details("long"), table(["a", "b"], [["x", 0.5]])], tmp_path)
    page = (tmp_path / "benchmarks" / "speed.md").read_text(encoding="utf-8")
    assert page.startswith("# Speed\n\n") and "`make bench-speed`" in page and "old" not in page
    assert page.endswith("new\n\nlong\n\n| a | b |\n|---|---|\n| x | 0.5 |\n")


_FAKE = """
import os, sys, time
name = sys.argv[1]
if name == "good":
    print("| a | b |\\n|---|---|\\n| x | 0.5 |")
if name == "empty":
    print("Nothing of 12 was measured.\\n\\n| a 1 | b |\\n|---|---|\\n| x | absent |")
if name == "slow":
    print("| a | b |\\n|---|---|\\n| x | 1 |", flush=True)
    time.sleep(60)
if name == "killed":
    os.kill(os.getpid(), 9)
assert name != "broken", "a part raised"
"""


@pytest.fixture
def benchmarks(tmp_path, monkeypatch):
    """The runner of all benchmarks, with others in their place."""
    (tmp_path / "__main__.py").write_text(_FAKE)
    monkeypatch.setattr(every, "FOLDER", tmp_path)
    return every


def test_a_benchmark_is_ok_where_it_ends_well_with_a_figure(benchmarks, capfd):
    assert benchmarks.run_all(["good"], 30.0) == 0
    assert capfd.readouterr().out.splitlines()[-1].startswith("| good | 0.")


@pytest.mark.parametrize(
    ("name", "limit", "why"),
    [
        ("empty", 30.0, "printed no figure"),
        ("broken", 30.0, "ended with code 1"),
        pytest.param("killed", 30.0, "ended with code -9", marks=pytest.mark.skipif(os.name == "nt", reason="kill")),
        pytest.param("slow", 0.5, "stopped after 2 s", marks=pytest.mark.skipif(os.name == "nt", reason="sessions")),
    ],
)
def test_a_benchmark_that_fails_fails_all(benchmarks, capfd, name, limit, why):
    assert benchmarks.run_all([name, "good"], limit) == 1
    said = capfd.readouterr()
    assert f"| {name} | " in said.out and said.out.splitlines()[-2].endswith(f" | {why} |")
    assert f"{name}: {why}" in said.err and ("a part raised" in said.err) == (name == "broken")


def test_quick_makes_none_of_the_other_cases(monkeypatch):
    made = []
    monkeypatch.setenv(runner._QUICK, "1")
    assert few(made.append(case) or case for case in (1, 2, 3)) == [1] and made == [1]
    monkeypatch.setenv(runner._QUICK, "")
    assert few((1, 2, 3)) == [1, 2, 3]


def run(*words):
    command = [sys.executable, str(ROOT / "benchmarks"), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.long
def test_the_command_line_names_what_there_is():
    assert "dsm, earthquake, epm, files, frames" in run("--help").stdout
    assert "NAME" in run("nonsense").stderr and "--quick to run all" in run().stderr
    assert "the parts of pointing are: urban, known" in run("pointing", "nonsense").stderr
    assert "quick figures are not written" in run("cuda", "--quick", "--write").stderr
    assert "| what | px | bar |" in run("epm", "accuracy", "--quick").stdout
