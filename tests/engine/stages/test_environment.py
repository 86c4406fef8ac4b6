"""The environment stage: its report says what it found."""

from __future__ import annotations

from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.stages import environment, run_stage
from tests.engine.pages import plain


def test_the_report_holds_versions_and_machine(tmp_path):
    import numpy

    report = tmp_path / "environment.html"
    result = run_stage("environment", {"report": str(report)}, Silent())
    page = plain(report.read_text(encoding="utf-8"))
    assert result.report == str(report)
    assert numpy.__version__ in page and result.interpreter in page
    for name in result.versions:
        assert name in page
    assert f"{result.memory['total_bytes'] / 2**30:.1f} GiB" in page


def test_what_is_missing_is_warned_of_with_its_remedy(tmp_path, monkeypatch):
    found = environment.survey()
    found["missing"] = [
        {"package": "pycolmap", "purpose": "tie points", "remedy": "choose this"},
        {"package": "scipy", "purpose": "more", "remedy": "run 'that'"},
        {"package": "laspy", "purpose": "points", "remedy": "choose this"},
    ]
    monkeypatch.setattr(environment, "survey", lambda folder: found)
    heard, report = Recorder(Silent()), tmp_path / "r.html"
    result = run_stage("environment", {"report": str(report)}, heard)
    assert heard.findings == [
        "Not installed: pycolmap: tie points; laspy: points. To install what is missing, choose this.",
        "Not installed: scipy: more. To install what is missing, run 'that'.",
    ]
    page = plain(report.read_text(encoding="utf-8"))
    assert "Not installed: pycolmap: tie points; laspy: points." in page and "choose this." in page
    assert list(result.missing) == found["missing"]


def test_what_cuda_needs_is_told_with_its_command(tmp_path, monkeypatch):
    found = {
        **environment.survey(),
        "cuda": {
            "built": False,
            "devices": ["NVIDIA X, 8 GiB"],
            "usable": False,
            "remedy": "run 'pip install pycolmap-cuda12'",
        },
    }
    monkeypatch.setattr(environment, "survey", lambda folder: found)
    run_stage("environment", {"report": str(tmp_path / "r.html")}, Silent())
    page = plain((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "NVIDIA X, 8 GiB; pycolmap was built without it" in page and "pip install pycolmap-cuda12" in page
    found["cuda"].update(built=True, usable=True, remedy="")
    run_stage("environment", {"report": str(tmp_path / "r.html")}, Silent())
    assert "cannot run" not in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_without_a_report_it_only_tells():
    result = run_stage("environment", {}, Silent())
    assert result.report is None and result.cores >= 1
