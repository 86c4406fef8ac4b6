"""The pictures of the documents: each is used, made by a function that is there, and of data that may be shown."""

from __future__ import annotations

import importlib.util
import pathlib
import re

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "pictures"
TABLE = FOLDER / "README.md"
FILES = sorted(path.name for path in FOLDER.iterdir() if path.suffix != ".md")
PAGES = [page for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")) if page != TABLE]
PAGES += (ROOT / "resources" / "help").rglob("*.md")
FORBIDDEN = re.compile(r"(?i)jax_068|worldview|\bwhu|dfc2019|zy-?3")
NOTICE = "contains Pléiades images of CNES, 2023, Licence Ouverte 2.0"
NOTICES = {"en": NOTICE, "de": "enthält Pléiades-Bilder des CNES, 2023, Licence Ouverte 2.0"}
MOST_BYTES = 7_000_000  # of all together


def rows() -> dict[str, list[str]]:
    """What is shown, by what, and of which data, by the name of the file."""
    lines = [line for line in TABLE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert len({row[0] for row in cells}) == len(cells)
    return {name.strip("`"): rest for name, *rest in cells}


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("pictures_script", ROOT / "scripts" / "pictures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def used_in(page: pathlib.Path) -> set[str]:
    """The pictures that a page shows or links to."""
    return set(re.findall(r"\]\([^)\s]*pictures/([\w.]+)\)", page.read_text(encoding="utf-8")))


def test_each_picture_has_a_row_and_each_row_its_picture():
    assert len(FILES) > 20 and sorted(rows()) == FILES
    assert all(len(row) == 3 and all(row) for row in rows().values())


def test_each_picture_is_used():
    assert sorted({name for page in PAGES for name in used_in(page)} & set(FILES)) == FILES


def test_no_picture_is_of_images_for_measuring_only():
    assert not [name for name, row in rows().items() if FORBIDDEN.search(" ".join(row))]
    assert not FORBIDDEN.search((ROOT / "scripts" / "pictures.py").read_text(encoding="utf-8"))
    # Nothing else writes there.
    programs = [path for folder in ("benchmarks", "scripts") for path in (ROOT / folder).rglob("*.py")]
    assert len(programs) > 50
    writers = [
        path.name for path in programs if re.search(r"\"docs\", \"pictures\"|DOCS / \"pictures", path.read_text())
    ]
    assert writers == ["pictures.py"]


def test_what_makes_a_picture_is_there(script):
    makers = {name: maker.__name__ for maker, names in script.MAKERS.items() for name in names}
    for name, (_, made_by, _) in rows().items():
        first, *others = re.findall(r"`([^`]+)`", made_by)
        if made_by.startswith("by hand: "):
            assert name not in makers, name
        else:
            assert makers.pop(name) == first, name
        for word in (first, *others):
            assert (ROOT / word).is_file() if "/" in word else callable(getattr(script, word, None)), (name, word)
    assert not makers  # each one makes what has a row


def test_screenshots_come_from_tests_that_are_there(script):
    for path, (chosen, _) in script.TESTS.items():
        names = re.findall(r"(?m)^def (test_\w+)", (ROOT / path).read_text(encoding="utf-8"))
        for words in chosen.split(" or "):
            assert len([name for name in names if words in name]) == 1, (path, words)


def test_pages_with_pictures_of_cnes_have_its_notice():
    notice = {name for name, row in rows().items() if "CNES" in row[-1]}
    assert {"viewer.png", "earthquake.png"} <= notice
    assert all(NOTICE in row[-1] for name, row in rows().items() if name in notice)
    shown = [page for page in PAGES if notice & used_in(page)]
    assert len(shown) >= 6
    for page in shown:
        text = " ".join(page.read_text(encoding="utf-8").split())
        assert NOTICES["de" if "de" in page.parts else "en"] in text, page


def test_pictures_have_few_bytes():
    assert sum((FOLDER / name).stat().st_size for name in FILES) < MOST_BYTES


def test_a_name_that_nothing_makes_is_refused(script, capsys):
    assert script.main(["viewer.png", "other.png"]) == 2
    assert "'other.png'" in capsys.readouterr().out


def test_pictures_whose_data_is_absent_are_named_and_left(script, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(script, "SHARED", str(tmp_path))
    monkeypatch.setenv("REPM_BENCH_CACHE", "")  # main sets it
    before = {name: (FOLDER / name).stat().st_mtime_ns for name in FILES}
    assert script.main(["earthquake.png", "viewer.png", "pleiades_dsm.png", "report_triplet.png"]) == 0
    said = capsys.readouterr().out
    for name in ("earthquake.png", "viewer_error.png", "pleiades_dsm.png", "report_triplet.png"):
        assert name in said
    assert said.count("left as they are: no shared/data/pleiades_") == 4
    assert before == {name: (FOLDER / name).stat().st_mtime_ns for name in FILES}
