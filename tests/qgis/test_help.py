"""The Help button's pages: HTML with what the dialog shows, without a network. test_commands.py tries the examples."""

from __future__ import annotations

import html
import pathlib
import re
import urllib.parse
from html.parser import HTMLParser

import pytest
from qgis.core import QgsApplication

ROOT = pathlib.Path(__file__).resolve().parents[2]
NAMES = sorted(path.stem for path in (ROOT / "docs" / "algorithms").glob("*.md"))


def help_page(name):
    url = QgsApplication.processingRegistry().algorithmById(f"repm:{name}").create().helpUrl()
    assert url.startswith("file:") and url.endswith(f"/{name}.html")
    return pathlib.Path(urllib.parse.unquote(urllib.parse.urlparse(url).path))


@pytest.fixture
def pages(plugin):
    """The pages of all algorithms, because they lead to each other."""
    return {name: help_page(name) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_help_is_a_page_with_every_parameter_by_label_and_id(plugin, name):
    page = help_page(name).read_text(encoding="utf-8")
    words = html.unescape(re.sub(r"<[^>]+>", "", page))
    algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}")
    for entry in algorithm.parameterDefinitions():
        assert re.search(rf"<strong>[^<]+</strong><br><code>{entry.name()}</code>", page), entry.name()
        assert entry.description() in words, entry.name()
    assert not re.search(r"\*\*|\]\(|\n\|", page), "Markdown is left"
    assert not re.search(r"(src|href)=.https?://[^>]*\.(css|js|png)", page), "it would need a network"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.long
def test_what_help_links_to_is_there(pages, name):
    seen, ahead = set(), [pages[name]]
    while ahead:
        page = ahead.pop()
        seen.add(page)
        text = page.read_text(encoding="utf-8")
        for link in re.findall(r'(?:href|src)="([^"]+)"', text):
            if re.match(r"(https?|mailto):", link):
                continue
            path, _, anchor = link.partition("#")
            place = urllib.parse.unquote(path[7:] if path.startswith("file://") else path)
            target = (page.parent / place).resolve() if path else page
            assert target.exists(), f"{page.name} links to {link}"
            if target.suffix == ".html" and target not in seen:
                ahead.append(target)
            if anchor and target.suffix == ".html":
                assert f'id="{anchor}"' in target.read_text(encoding="utf-8"), f"{page.name} links to {link}"
    assert len(seen) > 1 or not re.search(
        r"\]\([^)]*\.md", (ROOT / "docs" / "algorithms" / f"{name}.md").read_text("utf-8")
    )


def test_a_page_is_written_again_only_where_it_differs(plugin):
    page = help_page("refine")
    before = page.stat().st_mtime_ns
    assert help_page("refine").stat().st_mtime_ns == before
    whole = page.read_text(encoding="utf-8")
    page.write_text("half", encoding="utf-8")
    assert help_page("refine").read_text(encoding="utf-8") == whole


def test_a_profile_that_cannot_be_written_gives_the_document_itself(plugin, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(QgsApplication, "qgisSettingsDirPath", staticmethod(lambda: str(tmp_path / "file")))
    url = QgsApplication.processingRegistry().algorithmById("repm:refine").create().helpUrl()
    assert url.endswith("/docs/algorithms/refine.md")


def test_small_things_of_markdown_become_html(plugin):
    from repm.processing_provider.helppages import PLUGIN_FOLDER, to_page

    lists, table = "1. a *b*\n2. `c*d` and `e*f`", "| input | |\n|---|---|\n| A, B | x \\ y |"
    text = f"# T\n\n{lists}\n\n{table}\n\n```\nq <b>\n\nr\n```\n[k](z.md#t)\n<!-- made -->\n**l `m*` *n*** [`o`](p.md)"
    page = to_page(text, f"{PLUGIN_FOLDER}/docs", {"A": "Label <a>"}, {"A": "", "C": "More."})
    assert '<h1 id="t">T</h1>' in page and "<li>a <i>b</i></li>" in page
    assert "<code>c*d</code> and <code>e*f</code>" in page
    assert "<strong>Label &lt;a&gt;</strong><br><code>A</code><br>B" in page
    assert "<pre>q &lt;b&gt;\n\nr</pre>" in page and '<a href="z.html#t">k</a>' in page and "made" not in page
    assert '<strong>l <code>m*</code> <i>n</i></strong> <a href="p.html"><code>o</code></a>' in page
    assert "Further parameters" in page and "More." in page


class Structure(HTMLParser):
    """Elements and words in their order, without attributes, and without what changes nothing that is seen."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.found, self.open = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        if tag not in ("img", "br"):
            self.open.append(tag)
        self._add(tag, "<")

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)

    def handle_endtag(self, tag):
        self._add(tag, "</")
        self.open.remove(tag)

    def _add(self, tag, mark):
        unseen = tag == "div" or (tag == "p" and "li" in self.open) or (tag == "code" and "pre" in self.open)
        if not unseen:
            self.found.append(mark + {"em": "i"}.get(tag, tag))
        if self.found[-2:] == ["</strong", "</i"]:
            self.found[-2:] = ["</i", "</strong"]

    def handle_data(self, data):
        code = "pre" in self.open
        # Bold italic is italic bold.
        if self.found[-2:] == ["<strong", "<i"]:
            self.found[-2:] = ["<i", "<strong"]
        self.found += [line for line in data.split("\n") if line.strip()] if code else data.split()


DOCUMENTS = [*(ROOT / "docs").rglob("*.md"), *(ROOT / "resources" / "help").rglob("*.md")]


@pytest.mark.long
def test_documents_have_the_structure_that_a_renderer_of_markdown_gives_them(plugin):
    """markdown-it-py (CommonMark, with tables) is the judge; it is a package of ours for tests alone."""
    from repm.processing_provider.helppages import PLUGIN_FOLDER, to_page

    markdown_it = pytest.importorskip("markdown_it", reason="needs markdown-it-py, which make setup installs")
    judge = markdown_it.MarkdownIt("commonmark", {"html": False}).enable("table")
    assert len(DOCUMENTS) > 70
    for path in DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        page = re.search(r"(?s)<main>(.*)</main>", to_page(text, f"{PLUGIN_FOLDER}/docs"))[1]
        visible = re.sub(r"(?ms)^<!--.*?-->$", "", text)
        assert Structure(page).found == Structure(judge.render(visible)).found, path.name


@pytest.fixture
def german(plugin, monkeypatch):
    """QGIS in German: its locale, and the plugin's own texts."""
    from qgis.PyQt.QtCore import QCoreApplication, QTranslator

    translator = QTranslator()
    assert translator.load(str(ROOT / "i18n" / "repm_de.qm"))
    QCoreApplication.installTranslator(translator)
    monkeypatch.setattr(QgsApplication, "locale", staticmethod(lambda: "de"))
    yield
    QCoreApplication.removeTranslator(translator)


@pytest.mark.parametrize("name", ("inspect", "pipeline", "dsmfuse", "comparedsm"))
def test_help_is_german_in_a_german_qgis(german, name):
    page = help_page(name)
    text = page.read_text(encoding="utf-8")
    words = html.unescape(re.sub(r"<[^>]+>", "", text))
    algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}").create()
    assert '<html lang="de">' in text and f"<title>{algorithm.title()}</title>" in text and "Ergebnisse" in words
    for entry in algorithm.parameterDefinitions():
        assert re.search(rf"<strong>[^<]+</strong><br><code>{entry.name()}</code>", text), entry.name()
        assert entry.description() in words, entry.name()
    assert (page.parent / f"{name}_en.html").exists()


def test_german_documents_take_the_place_of_the_english_ones(german):
    from repm.processing_provider import helppages

    for algorithm in QgsApplication.processingRegistry().providerById("repm").algorithms():
        algorithm.helpUrl()
    address = helppages.document("guide", "de")
    guide = pathlib.Path(urllib.parse.unquote(urllib.parse.urlparse(address).path))
    text = guide.read_text(encoding="utf-8")
    assert "<h1" in text and "Anleitung" in text and '<html lang="de">' in text
    assert '<a id="install-the-engines-packages"></a>' in text  # English documents lead there, too
    tutorial = guide.with_name("tutorial.html").read_text(encoding="utf-8")
    assert "von der Bestellung" in tutorial and "guide.html#was-man-braucht" in tutorial
    for page, shown in ((guide, text), (guide.with_name("tutorial.html"), tutorial)):
        for link in re.findall(r'(?:href|src)="([^"#]+)', shown):
            if not link.startswith(("http", "mailto:")):
                place = urllib.parse.unquote(link[7:] if link.startswith("file://") else link)
                assert (page.parent / place).resolve().exists(), link
    assert "tutorial_en.html#1-order" in tutorial  # what only the English one has
    assert "Six steps" in guide.with_name("tutorial_en.html").read_text(encoding="utf-8")
    assert '<html lang="en">' in guide.with_name("method.html").read_text(encoding="utf-8")
