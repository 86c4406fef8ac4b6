"""The estimate of time and memory, and the presets: held to runs of the demo's images."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.options import PRESETS, PipelineOptions
from repm_qgis.planning.run_estimate import estimate_run
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.engine.pages import plain

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
MEASURED = """
import subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=sys.stderr)
try:
    import resource
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
except ImportError:  # Windows counts neither for children
    print("nan nan")
sys.exit(done.returncode)
"""


@pytest.fixture(scope="module")
def demo(tmp_path_factory, told):
    """The images of 'make demo'."""
    folder = tmp_path_factory.mktemp("demo")
    return run_stage("sampledata", {"folder": str(folder), "kind": "urban", "size": 800, "seed": 1}, told())


@pytest.fixture(scope="module")
def runs(demo, tmp_path_factory):
    """The scene, the log, core seconds and peak memory (MiB) of a run with and without the preset fast."""
    found = {}
    for preset in ("none", "fast"):
        folder = tmp_path_factory.mktemp(preset)
        job = {
            "images": demo.images,
            "workspace": str(folder / "w"),
            "output": str(folder / "dsm.tif"),
            "workers": 1,
        }
        (folder / "job.json").write_text(json.dumps({**job, "preset": preset}))
        engine = [sys.executable, "-m", "repm_qgis", "pipeline", str(folder / "job.json")]
        done = subprocess.run(
            [sys.executable, "-c", MEASURED, *engine],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        core_s, mib = map(float, done.stdout.split())
        found[preset] = Scene.load(str(folder / "w" / "reconstructed.json")), done.stderr, core_s, mib
    return found


counted = pytest.mark.skipif(os.name == "nt", reason="measures with getrusage, which Windows does not have")


@counted
@pytest.mark.parametrize("preset", ["none", "fast"])
@pytest.mark.slow
def test_the_estimate_is_right_within_a_factor_of_two(runs, preset):
    scene, _, core_s, mib = runs[preset]
    expected = estimate_run(scene, scene.pairs, workers=1)
    assert core_s / 2 < expected.core_s < 2 * core_s, (expected, core_s)
    assert mib / 2 < expected.mib < 2 * mib, (expected, mib)


@pytest.mark.slow
def test_the_estimate_comes_before_the_work(runs):
    said = [json.loads(line).get("text", "") for line in runs["none"][1].splitlines() if line.startswith("{")]
    place = next(index for index, text in enumerate(said) if text.startswith("This run will take about"))
    assert re.fullmatch(
        r"This run will take about \d+ (s|minutes) with 1 worker and \d+\.\d GiB of memory\. "
        r"A continued run takes less\.",
        said[place],
    )
    assert not any("Refinement" in text or "tie points" in text for text in said[:place])


@pytest.mark.slow
def test_the_inspection_expects_what_the_run_does(demo, runs, told, tmp_path):
    log, report = told(), tmp_path / "page.html"
    run_stage("inspect", {"images": demo.images, "report": str(report)}, log)
    scene = runs["none"][0]
    said = r"A DSM of all this ground will take about (\d+) s with .* and (\d+\.\d) GiB"
    time, gib = re.search(said, " ".join(log.notes)).groups()
    run = estimate_run(scene, scene.pairs)
    assert run.wall_s / 1.5 - 5 < float(time) < 1.5 * run.wall_s + 5
    assert run.mib / 1.5 < 1024 * float(gib) < 1.5 * run.mib
    assert "A DSM of all this ground" in plain(report.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_more_workers_take_less_time_and_more_memory(runs):
    scene = runs["none"][0]
    one, two = (estimate_run(scene, scene.pairs, workers=count) for count in (1, 2))
    assert one.wall_s > 1.4 * two.wall_s and one.mib < two.mib and one.core_s == two.core_s
    assert estimate_run(scene, scene.pairs, workers=1000).workers == len(scene.tiles) * len(scene.pairs)
    assert estimate_run(scene, scene.pairs, own_surface=True).core_s > one.core_s
    best = estimate_run(scene, scene.pairs, workers=1, paths=8)
    assert best.core_s > 1.2 * one.core_s and best.mib > one.mib
    words = {12: "10 s", 150: "2 minutes", 9000: "2.5 hours"}
    assert all(f"about {text} with" in one._replace(wall_s=seconds).sentence() for seconds, text in words.items())


@pytest.mark.slow
def test_a_preset_is_recorded(runs):
    plain, fast = runs["none"][0], runs["fast"][0]
    assert (plain.preset, fast.preset) == ("none", "fast")
    assert (len(plain.pairs), len(fast.pairs)) == (3, 2)
    assert fast.record_of("reconstruct").options["pointing"] == "shift"
    assert "Preset fast: QUALITY fast" in runs["fast"][1] and "Preset" not in runs["none"][1]


@counted
@pytest.mark.slow
def test_the_preset_fast_takes_less_time(runs):
    assert runs["fast"][2] < 0.9 * runs["none"][2]


def test_what_is_given_goes_before_the_preset():
    files = {"images": ["a.tif", "b.tif"], "workspace": "w", "output": "d.tif"}
    made = PipelineOptions.from_json({**files, "preset": "fast", "pointing": "auto"})
    assert (made.preset, made.reconstruct.pointing, made.reconstruct.quality) == ("fast", "auto", "fast")
    assert made.fuse.fill == "none"
    assert PipelineOptions.from_json(files).fuse.fill == "occlusions"
    with pytest.raises(OptionError, match="PRESET is 'slow'"):
        PipelineOptions.from_json({**files, "preset": "slow"})


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_documented_with_their_values(preset):
    for name, value in PRESETS[preset].items():
        assert PipelineOptions.option(name).metadata["check"].problem(value) == ""
    page = (ROOT / "docs" / "algorithms" / "pipeline.md").read_text(encoding="utf-8")
    (row,) = [line for line in page.splitlines() if line.startswith(f"| `{preset}` |")]
    assert all(f"{name.upper()} {value:g}" in row if isinstance(value, float) else f"{name.upper()} {value}" in row
               for name, value in PRESETS[preset].items())  # fmt: skip
