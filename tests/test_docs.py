"""The documents: links lead somewhere, pictures are small, and nothing of one machine is in them."""

from __future__ import annotations

import importlib.util
import json
import pathlib
import re
from types import SimpleNamespace

import pytest

import repm_qgis
from tests.english import prose_of, stoppers_in
from tests.every_file import wrong

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
HELP = sorted((ROOT / "resources" / "help").glob("*.md"))


def anchors(page: pathlib.Path) -> set[str]:
    """The anchors that a page's headings have."""
    heads = re.findall(r"(?m)^#+ (.*)$", page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", head).strip().lower().replace(" ", "-") for head in heads}


def dead_links(page: pathlib.Path) -> list[str]:
    """Links to files and headings that are not there."""
    dead = []
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not re.match(r"[a-z]+:", link) and not (target.exists() and (not anchor or anchor in anchors(target))):
            dead.append(link)
    return dead


def test_links_lead_somewhere():
    assert wrong(PAGES, dead_links) == {}


def test_pages_name_no_folder_of_one_machine():
    folder = r"(?<![\w.])/(?:work|root|home|tmp)/"
    assert wrong(PAGES, lambda page: re.findall(folder, page.read_text(encoding="utf-8"))) == {}


def missing_files(page: pathlib.Path) -> list[str]:
    """Files that a page names, and that are not there."""
    names = sorted(set(re.findall(r"`([a-z_]+/[a-z_/]*\.py)`", page.read_text(encoding="utf-8"))))
    return [name for name in names if not any((folder / name).is_file() for folder in (ROOT, ROOT / "repm_qgis"))]


def test_pages_name_files_that_exist():
    assert wrong(PAGES, missing_files) == {}


def test_pages_use_plain_words():
    """See docs/glossary.md for the words to take instead."""
    banned = r"(?i)\b(?:told|forth|wants|wanted|lonely|islands?|rows left)\b"
    pages = [page for page in PAGES + HELP if not {"glossary", "benchmarks"} & {page.stem, *page.parts}]
    assert wrong(pages, lambda page: re.findall(banned, page.read_text(encoding="utf-8"))) == {}


def test_code_and_pages_use_plain_constructions():
    """Comments, docstrings and texts are read in a hurry too, by people whose first language is another one."""
    code = [
        path for folder in ("repm_qgis", "processing_provider", "desktop") for path in (ROOT / folder).rglob("*.py")
    ]
    assert len(code) > 250
    assert wrong(sorted(code), lambda path: stoppers_in(prose_of(path))) == {}
    unread = {"benchmarks", "CHANGELOG", "glossary"}
    pages = [page for page in PAGES + HELP if not unread & {page.stem, *page.parts}]
    assert wrong(pages, lambda page: stoppers_in(page.read_text(encoding="utf-8"))) == {}


@pytest.mark.parametrize("text", ("as much as that lets\n    expect", "all maps are heard", "RPCs that are none, say"))
def test_what_stops_readers_is_found_across_lines(text):
    assert stoppers_in(text)


def structure(page):
    """What each line is, and how many bold words it has; the page's code and pictures."""
    text = page.read_text(encoding="utf-8")
    lines = text.splitlines()
    shape = [re.match(r"#*|- |!", line)[0] + "*" * line.count("**") for line in lines]
    return shape, sorted(re.findall(r"`[^`]+`", text)), re.findall(r"\(([^)\s]+\.png)\)", text)


def test_help_says_the_same_in_every_language():
    languages = {path.stem.split("_", 1)[1] for path in (ROOT / "i18n").glob("repm_*.ts")}
    for page in HELP:
        assert languages == {folder.name for folder in page.parent.iterdir() if folder.is_dir()}
        for language in languages:
            assert structure(page.parent / language / page.name) == structure(page), (page.stem, language)


def test_every_algorithm_has_its_page_and_its_help():
    names = {path.stem for path in (ROOT / "resources" / "help").glob("*.md")}
    assert len(names) >= 9
    assert names == {path.stem for path in (ROOT / "docs" / "algorithms").glob("*.md")}
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert not [name for name in names if f"`repm:{name}`" not in readme]


def row_of(page, name):
    """The cells of the first row of a table that begins with a name."""
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    return next([cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith(f"| {name}"))


@pytest.mark.parametrize(
    "images, name", (("real Pleiades pair", "pleiades_pair"), ("real Pleiades triplet", "pleiades_triplet"))
)
def test_the_readme_has_the_figures_of_the_benchmarks(images, name):
    _, _, nmad, _, _, valid, wall, cpu, peak = row_of("docs/benchmarks.md", name)
    told = row_of("README.md", images)[1]
    nmad, valid, wall, cpu, peak = map(float, (nmad, valid, wall, cpu, peak))
    figures = (f"NMAD {nmad:.2f} m", f"{valid:.1f} %", f"{wall:.0f} s", f"{cpu:.1f} CPU s", f"{peak:.1f} GiB")
    assert not [figure for figure in figures if figure not in told]


def test_glossary_names_files_and_identifiers_that_exist():
    engine = ROOT / "repm_qgis"
    rows = [line.strip("|").split("|") for line in (ROOT / "docs" / "glossary.md").read_text("utf-8").splitlines()]
    rows = [[cell.strip() for cell in row] for row in rows if len(row) == 4]
    words = [row for row in rows if row[2].startswith("`")]
    assert len(words) >= 40
    for word, meaning, where, source in words:
        path, *identifiers = re.findall(r"`([^`]+)`", where)
        assert (engine / path).is_file(), f"{word}: {path}"
        assert meaning.endswith(".") and source, word
        assert not set(identifiers) - set(re.findall(r"\w+", (engine / path).read_text("utf-8"))), word


def test_pictures_are_small():
    pictures = list((ROOT / "docs" / "pictures").glob("*.png"))
    assert len(pictures) >= 6
    for picture in pictures:
        assert picture.read_bytes()[:4] == b"\x89PNG"
        assert picture.stat().st_size < 400_000, picture.name
    for recording in (ROOT / "docs" / "pictures").glob("*.gif"):
        assert recording.read_bytes()[:4] == b"GIF8" and recording.stat().st_size < 900_000, recording.name


def test_the_citation_names_this_version():
    yaml = pytest.importorskip("yaml")
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    (version,) = re.findall(r"(?m)^version=(.*)$", (ROOT / "metadata.txt").read_text(encoding="utf-8"))
    assert str(cited["version"]) == version == repm_qgis.__version__
    authors = [author["family-names"] for author in cited["references"][0]["authors"]]
    assert len(authors) == 7 and authors[0] == "Hong"


def test_the_forms_for_issues_have_what_their_site_asks_for():
    """Of docs.github.com, "Syntax for issue forms" and "Syntax for GitHub's form schema"."""
    yaml = pytest.importorskip("yaml")
    forms = {path.name: yaml.safe_load(path.read_text("utf-8")) for path in (ROOT / ".github/ISSUE_TEMPLATE").iterdir()}
    assert set(forms.pop("config.yml")) <= {"blank_issues_enabled", "contact_links"}
    assert len(forms) >= 2
    for name, form in forms.items():
        assert set(form) == {"name", "description", "labels", "body"}, name
        ids = [field["id"] for field in form["body"] if field["type"] != "markdown"]
        assert len(set(ids)) == len(ids) >= 2
        for field in form["body"]:
            assert set(field) <= {"type", "id", "attributes", "validations"}, name
            assert field["type"] in ("markdown", "textarea", "input"), name
            allowed = {"value"} if field["type"] == "markdown" else {"label", "description", "render"}
            assert {"value", "label"} & set(field["attributes"]) and set(field["attributes"]) <= allowed, name


def test_the_site_lists_every_document_and_german_pages_have_german_titles():
    yaml = pytest.importorskip("yaml")
    path = ROOT / "scripts" / "site_pages.py"
    spec = importlib.util.spec_from_file_location("site_pages", path)
    pages = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pages)
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    config = pages.on_config(SimpleNamespace(nav=yaml.safe_load(f"nav:{text}")["nav"]))

    def listed(entry):
        parts = entry.values() if isinstance(entry, dict) else entry
        return [entry] if isinstance(entry, str) else [page for part in parts for page in listed(part)]

    added = pages.added_pages()
    documents = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")]
    assert sorted(listed(config.nav)) == sorted([*documents, *added])
    assert added["de/algorithms/comparedsm.md"].startswith("# DOM mit einer Referenz vergleichen\n")
    assert "](compatibility.md)" in added["changelog.md"] and "](docs/" not in "".join(added.values())


def parts_of(message: str) -> list[str]:
    """The pieces of a message between what a run fills in: "...", numbers, words in capitals, what is quoted."""
    open_parts = re.sub(
        r"\{\d+\}|\.\.\.|'[^' ]*'|„[^“ ]*“|\b[A-Z_]{3,}\b|\d+(?:\.\d+)?|; (?:or|oder): |[()]|: ", "…", message
    )
    pieces = (re.sub(r"^(?:it|der Wert) ", "", piece.strip()) for piece in open_parts.split("…"))
    return [piece for piece in pieces if len(piece.split()) > 1]


def unknown_messages(page: pathlib.Path, texts: list[str]) -> list[str]:
    """What the last table of a guide calls a message, and no text of the engine has, as a whole or in two parts."""
    known = "\n".join(" … ".join(parts_of(text)) for text in texts)
    table = page.read_text(encoding="utf-8").rpartition("|---|---|\n")[2].partition("\n\n")[0]
    unknown = []
    for row in table.splitlines():
        for piece in parts_of(row.split(" | ")[0].lstrip("| ")):
            words = piece.split()
            cuts = ((" ".join(words[:at]), " ".join(words[at:])) for at in range(1, len(words)))
            if piece not in known and not any(first in known and last in known for first, last in cuts):
                unknown.append(piece)
    return unknown


@pytest.mark.parametrize("language", ("en", "de"))
def test_messages_in_the_guides_are_those_of_the_engine(language):
    """A reader looks for the words of the log."""
    catalogue = json.loads((ROOT / "i18n" / "engine_de.json").read_text(encoding="utf-8"))
    page = ROOT / "docs" / ("de" if language == "de" else "") / "guide.md"
    assert unknown_messages(page, list(catalogue.values() if language == "de" else catalogue)) == []


def test_a_message_that_nothing_says_is_noticed(tmp_path):
    page = tmp_path / "guide.md"
    page.write_text("|---|---|\n| No RPC found for ... | find it |\n| too few tie points | more |\n\nEnd")
    assert unknown_messages(page, ["No RPC found for '{0}'. {1}"]) == ["too few tie points"]
