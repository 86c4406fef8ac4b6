"""What ``make site`` adds to the documents of docs/: a hook of MkDocs (see mkdocs.yml).

The change log and the page for contributors come from the root. In German each algorithm has the help that its dialog
shows (resources/help/de), under its German title, as the plugin's own *Help* button has it.
"""

from __future__ import annotations

import pathlib
import re
import xml.etree.ElementTree as ElementTree
from typing import Any

ROOT = pathlib.Path(__file__).resolve().parent.parent
FROM_ROOT = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
_OUTSIDE = re.compile(r"\[([^\]]+)\]\((?!docs/|#|[a-z]+:)[^)]+\)")


def on_config(config: Any) -> Any:
    """List the pages of the algorithms in the order of the README, and those of the benchmarks."""
    names = list(_titles())
    single = sorted(path.name for path in (ROOT / "docs" / "benchmarks").glob("*.md"))
    sections = {title: part for entry in config.nav for title, part in entry.items()}
    sections["Algorithms"][:] = [f"algorithms/{name}.md" for name in names]
    _part(sections["Method and figures"], "Pages of single subjects")[:] = [f"benchmarks/{name}" for name in single]
    _part(sections["Deutsch"], "Algorithmen")[:] = [f"de/algorithms/{name}.md" for name in names]
    return config


def _titles() -> dict[str, str]:
    """The titles of the algorithms by the names of their pages, in the order of the README."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    return {name: title for title, name in re.findall(r"\| \[([^\]]+)\]\(docs/algorithms/(\w+)\.md\)", readme)}


def _part(entries: list[Any], title: str) -> list[Any]:
    return next(entry[title] for entry in entries if title in entry)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that lie elsewhere."""
    from mkdocs.structure.files import File

    for name, text in added_pages().items():
        files.append(File.generated(config, name, content=text))
    return files


def added_pages() -> dict[str, str]:
    """The text of each page that does not lie in docs/, by its name there."""
    pages = {}
    for name, page in FROM_ROOT.items():
        pages[page] = _from_root((ROOT / name).read_text(encoding="utf-8"))
    german, titles = _translations(), _titles()
    for path in sorted((ROOT / "resources" / "help" / "de").glob("*.md")):
        more = f"[Die Seite auf Englisch, mit allen Einzelheiten](../../algorithms/{path.name})"
        text = path.read_text(encoding="utf-8").replace("](../../docs/", "](../../")
        pages[f"de/algorithms/{path.name}"] = f"# {german[titles[path.stem]]}\n\n{text}\n\n{more}\n"
    return pages


def _from_root(text: str) -> str:
    """Links of a page of the root as they are from docs/; what is not on the site is a name only."""
    for name, page in FROM_ROOT.items():
        text = text.replace(f"]({name})", f"](docs/{page})")
    return _OUTSIDE.sub(r"`\1`", text).replace("](docs/", "](")


def _translations() -> dict[str, str]:
    """The German of the dialogs' titles, by the English."""
    tree = ElementTree.parse(ROOT / "i18n" / "repm_de.ts")  # noqa: S314 - our own file
    return {
        message.findtext("source", ""): message.findtext("translation") or ""
        for message in tree.iter("message")
        if message.findtext("translation")
    }
