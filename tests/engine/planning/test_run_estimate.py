"""The estimate of time and memory, and the presets: held to runs of the demo's images."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.options import PRESETS, PipelineOptions, ReconstructOptions
from repm_qgis.planning.run_estimate import RunEstimate, TimeLeft, estimate_run
from repm_qgis.runtime.progress import Part, Silent, Uneven, slow_down
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stages.reconstruct import expected
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
        r"This run will take about \d+ (s|minutes) with 1 worker and \d+\.\d GiB of memory\.",
        said[place],
    )
    assert not any("tie points" in text for text in said[:place])


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
    words = {12: "10 s", 150: "2.5 minutes", 1520: "25 minutes", 9000: "2.5 hours"}
    for seconds, text in words.items():
        assert f"about {text} with" in RunEstimate(seconds, 0.0, 0.0, 0.0, 500.0, 1).sentence()


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


@pytest.mark.slow
def test_a_continued_run_is_expected_to_take_less(runs, tmp_path):
    scene = runs["none"][0]
    options = ReconstructOptions.from_json(scene.record_of("reconstruct").options)
    whole = expected(options)
    assert whole.ties_s == whole.matching_s == 0.0 < whole.fusion_s
    copy = tmp_path / "heights"
    shutil.copytree(options.heights or f"{options.output_scene[:-5]}_heights", copy)
    options = replace(options, heights=str(copy), output_scene=str(tmp_path / "new.json"))
    assert expected(options).matching_s == 0.0
    next(copy.glob("*.tif")).unlink()
    one = expected(options)
    other = expected(replace(options, pointing="affine"))
    assert one.matching_s == pytest.approx(other.matching_s / 3) and other.ties_s > 0


class _Left(Silent):
    """What the texts of a run say of its time left, with the time at which they said it, s."""

    def __init__(self, now):
        self._now, self.said, self.fractions = now, [], []

    def step(self, fraction, text=""):
        self.fractions.append(fraction)
        found = re.search(r", about ([0-9.]+) (s|minutes|hours) left$", text)
        if found:
            self.said.append((self._now(), float(found[1]) * {"s": 1, "minutes": 60, "hours": 3600}[found[2]]))


def _wrong(said, end, begin=0.0):
    """The ratio (at least 1) of the time that was said and the one that was left, from a quarter of the run to its last
    minute."""
    due = [(left, end - at) for at, left in said if at - begin >= 0.25 * (end - begin) and end - at >= 60]
    return [max(left / true, true / left) for left, true in due]


@pytest.mark.parametrize("slower", [0.4, 1.0, 4.0])
@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_the_time_left_follows_the_work(monkeypatch, slower, factor):
    """A machine that is slower than the estimate, and a part that turns out to take longer when it begins."""
    now = [100.0]
    monkeypatch.setattr("repm_qgis.planning.run_estimate.time", SimpleNamespace(monotonic=lambda: now[0]))
    heard = _Left(lambda: now[0])
    clock = TimeLeft(heard)
    clock.step(0.1, "cameras")
    clock.expect(600.0)
    matching, fusion = Part(clock, 0.2, 0.7, "matching"), Part(clock, 0.7, 1.0)
    planned = 600.0 / 0.9
    for tenth in range(10):
        now[0] += 0.01 * planned * slower
        clock.step(0.1 + 0.01 * (tenth + 1), "ties")
    slow_down(matching, factor)
    for percent in range(1, 101):
        now[0] += 0.005 * planned * slower * factor
        matching.step(percent / 100, "a tile")
    for percent in range(1, 101):
        now[0] += 0.003 * planned * slower
        fusion.step(percent / 100, "fusing")
    wrong = _wrong(heard.said, now[0], 100.0)
    assert len(wrong) > 20 and max(wrong) < 1.5
    assert heard.fractions == sorted(heard.fractions) and heard.fractions[0] == 0.1
    assert heard.fractions[-1] == pytest.approx(1.0)


def test_nothing_is_said_of_a_time_that_nobody_waits_for():
    heard = _Left(lambda: 0.0)
    clock = TimeLeft(heard)
    clock.step(0.5, "unknown")
    clock.expect(8.0)
    clock.step(0.6, "short")
    assert not heard.said


def test_tasks_that_an_earlier_run_has_done_take_no_time():
    seen = []
    part = Uneven(SimpleNamespace(step=lambda fraction, text: seen.append(fraction)), 0.5, 1.0, [0.0, 0.0, 1.0, 1.0])
    for ended in range(5):
        part.step(ended / 4, "")
    assert seen == [0.5, 0.5, 0.5, 0.75, 1.0]
    Uneven(SimpleNamespace(step=lambda fraction, text: seen.append(fraction)), 0.5, 1.0, []).step(0.0)
    assert seen[-1] == 0.5
