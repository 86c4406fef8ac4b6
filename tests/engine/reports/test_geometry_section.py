"""The reports' geometry: figures that are in the scene, in sentences and tables."""

from __future__ import annotations

import html
import os
from dataclasses import replace

import numpy as np
import pytest
from osgeo import ogr

from repm_qgis.contracts.records import GcpFigures
from repm_qgis.geometry.jitter import Jitter
from repm_qgis.geometry.sun import sun_position
from repm_qgis.reports.geometry_section import add_geometry, overlap_percent
from repm_qgis.reports.report import Report
from repm_qgis.reports.stage_reports import fit_report
from repm_qgis.scene import Scene
from tests.engine.pages import plain


def page_of(scene):
    report = Report("geometry")
    add_geometry(report, scene)
    return plain(report.html())


@pytest.fixture
def scene(urban_run):
    return Scene.load(urban_run.result.scene)


def test_overlap_is_of_the_smaller_footprint(scene):
    view = scene.views[0]
    half = replace(view, name="half", rpc=view.rpc.shifted(view.width / 2, 0))
    part = replace(view, name="part", width=view.width // 4, height=view.height // 4)
    scene = replace(scene, views=(view, replace(view, name="same"), half, part))
    assert overlap_percent(scene, view.name, "same") == pytest.approx(100, abs=0.01)
    assert overlap_percent(scene, view.name, "half") == pytest.approx(50, abs=0.2)
    assert overlap_percent(scene, view.name, "part") == pytest.approx(100, abs=0.1)


def test_every_pair_and_view_is_told_with_its_figures(scene):
    ties, page = scene.pointing, page_of(scene)
    for pair in scene.pairs:
        metres = np.median(
            [
                record.metres_per_px
                for tile in scene.tiles
                for record in tile.heights
                if record.pair == (pair.first, pair.second)
            ]
        )
        angle, ratio = f"{pair.angle_deg:.1f}°", f"{pair.base_to_height:.2f}"
        for text in (angle, ratio, f"{metres:.2f}", f"{metres / 4:.2f}"):
            assert f"{text}</td>" in page
    for pair in ties.pairs:
        assert f">{pair.candidates}</td>" in page and f">{pair.after_px:.3f}</td>" in page
    for tile, count in ties.ties_by_tile.items():
        assert f">{tile}</td>" in page and f">{count}</td>" in page
    assert ties.reason in html.unescape(page)
    assert f"uncertain by {1.645 / 2 * ties.height_uncertainty_m:.1f} m (LE90" in page
    assert "at most CE90 20.0 m (assumed, because no promise of its vendor is known)" in page


def test_times_and_suns_are_told_where_they_are_known(scene):
    page = page_of(scene)
    assert page.count("<td>unknown</td>") == 2 * len(scene.pairs)
    apart = zip(scene.pairs, (21 / 86400, 0.25, 184.0), (0.12, 40.04, 12.0))
    page = page_of(replace(scene, pairs=tuple(replace(pair, days=days, sun_deg=sun) for pair, days, sun in apart)))
    for text in ("21 s", "0.1°", "6 h", "40.0°", "184 days", "12.0°"):
        assert f"{text}</td>" in page


def test_ties_are_told_by_compass(scene):
    parts, total = scene.pointing.ties_by_part, scene.pointing.count
    assert next(iter(parts)) == "north-west"
    assert 0.9 * total < sum(parts.values()) <= total
    page = page_of(scene)
    assert all(f"{name}</th>" in page and f"{count}</td>" in page for name, count in parts.items())


def test_the_images_table_tells_when_and_under_which_sun(scene):
    first = replace(scene.views[0], acquired="2012-06-21T12:00:00.000Z", sensor="Pleiades 1A")
    scene = replace(scene, views=(first, *scene.views[1:]))
    page = fit_report(scene).html()
    azimuth, elevation = sun_position(scene.views[0].time, scene.frame.lon, scene.frame.lat)
    assert "2012-06-21 12:00:00</td>" in page and f"{azimuth:.1f}°, {elevation:.1f}°</td>" in page
    assert page.count("unknown</td>") == 6 and ">Pleiades 1A</td>" in page


def test_control_points_are_told_and_rejected_ones_named(scene):
    gcps = tuple(
        GcpFigures(id=f"P{k}", role=role, rejected=k == 2, east_m=0.1, north_m=-0.2, up_m=up)
        for k, (role, up) in enumerate((("control", 0.5), ("control", -0.7), ("control", 25.0), ("check", 0.9)))
    )
    ties = replace(scene.pointing, height_uncertainty_m=None, gcps=gcps, rejected_gcps=("P2",))
    page = page_of(replace(scene, pointing=ties))
    assert (
        "1 control point contradicted all others and could not be used in the adjustment: P2." in page
        and "<td>rejected</td>" in page
    )
    assert '<td>control</td><td class="n">2</td><td>height</td><td class="n">0.600</td><td class="n">0.608</td>' in page
    assert '<td>check</td><td class="n">1</td><td>height</td><td class="n">0.900</td>' in page
    assert "uncertain" not in page


def test_ties_show_what_is_left_of_their_rows(scene, urban_run):
    source = ogr.Open(urban_run.result.tie_points)
    rows = np.array([feature["row"] for feature in source.GetLayer(0)])
    source = None
    medians = [pair.after_px for pair in scene.pointing.pairs]
    # A track counts in the worst of its pairs.
    assert 0.5 * min(medians) < np.median(np.abs(rows)) < 3 * max(medians)
    assert page_of(scene).count("<svg") == 2


def test_without_the_ties_layer_there_is_no_drawing(scene, tmp_path):
    scene = replace(scene, tie_points=str(tmp_path / "gone.gpkg"))
    assert not os.path.exists(tmp_path / "gone.gpkg") and "<svg" not in page_of(scene)


def test_waves_of_a_view_are_drawn_with_their_size(scene):
    assert "Jitter" not in page_of(scene)
    view, rows = scene.views[1], np.linspace(0.0, 12.0, 40)
    coefficients = np.stack([0.9 * np.sin(rows), 0.3 * np.cos(rows)], axis=1)
    waves = Jitter(0.0, view.height - 1.0, coefficients)
    moved = view.with_pointing(view.pointing, waves)
    page = page_of(replace(scene, views=(scene.views[0], moved, scene.views[2])))
    section = page[page.rindex(">Jitter<") :]
    columns, lines = waves.rms_px
    assert f"{view.name}</td>" in section and f">{columns:.2f}</td>" in section and f">{lines:.2f}</td>" in section
    assert "line of the image" in section and section.count("<polyline") >= 2
    assert scene.views[0].name not in section[: section.index("</table>")]
