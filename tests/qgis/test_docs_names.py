"""Each name in italics in the documents is what the plugin, or QGIS, shows at that moment in that language."""

from __future__ import annotations

import importlib.util
import json
import pathlib
import re

import pytest
from qgis.core import Qgis, QgsApplication
from qgis.PyQt.QtCore import QTranslator

ROOT = pathlib.Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
HELP = ROOT / "resources" / "help"
PAGES = {
    "en": [
        *(DOCS / f"{name}.md" for name in ("guide", "tutorial", "cookbook", "gotchas")),
        *sorted((DOCS / "algorithms").glob("*.md")),
        *sorted(HELP.glob("*.md")),
    ],
    "de": [DOCS / "de" / "guide.md", DOCS / "de" / "tutorial.md", *sorted((HELP / "de").glob("*.md"))],
}

# QGIS's own names, with the places that the translations of its versions have them under.
OF_QGIS = {
    "&Plugins": "MainWindow",
    "&View": "MainWindow",
    "New &3D Map View": "MainWindow",
    "Configure…": "Qgs3DMapCanvasDockWidget Qgs3DMapCanvasWidget",
    "DEM (Raster Layer)": "Qgs3DMapConfigWidget",
    "Select Features by Expression…": "MainWindow",
    "&Settings": "MainWindow",
    "Options": "QgsOptionsBase",
    "Network": "QgsOptionsBase",
    "Processing": "ProcessingPlugin",
    "Providers": "ConfigDialog",
    "Layer CRS": "QgsAppLayerTreeViewMenuProvider",
    "Set &Project CRS from Layer": "QgsAppLayerTreeViewMenuProvider",
    "&Zoom to Group": "QgsLayerTreeViewDefaultActions",
    "Draw on Canvas": "QgsExtentWidget QgsExtentGroupBoxWidget",
    "Styles": "QgsAppLayerTreeViewMenuProvider",
    "Advanced Parameters": "QgsProcessingParametersWidgetBase",
    "Run": "QgsProcessingAlgorithmDialogBase",
    "Cancel": "QgsProcessingDialogBase",
    "Add Directory…": "QgsProcessingMultipleInputPanelWidget",
    "Execute as Batch Process…": "ProcessingToolbox",
    "Fill NoData cells": "QObject",
    "Fill value": "QObject",
    "Processing Toolbox": "ProcessingToolbox",
    "&Results Viewer": "ProcessingPlugin",
    "&Layer": "MainWindow",
    "Add Layer": "MainWindow",
    "Add Point Cloud Layer...": "MainWindow",
    "Add Mesh Layer...": "MainWindow",
}
# As OF_QGIS, of later versions: the first version that has it, the place, and the German word.
LATER = {
    "&3D Map Views": (32400, "MainWindow", "&3D-Kartenansichten"),
    "Draw on Map Canvas": (34000, "QgsExtentWidget", "Auf Karte zeichnen"),
    "Elevation Profile": (32600, "MainWindow", "Geländehöhenprofil"),
    "Capture Curve": (32600, "QgsElevationProfileWidget", "Kurve aufnehmen"),
}
# German words that differ between versions of QGIS: a page may have any of them.
OF_VERSIONS = {"Run": {"Starten", "Starte"}}
# What is stressed or cited, and names nothing: each of them is written somewhere.
CITED = {
    "Core Imagery Products Guide",
    "Refined Equivalent Pinhole Model",
    "Refined Equivalent Pinhole Model for Large-scale 3D Reconstruction from Spaceborne CCD Imagery",
    "Accounting for uncertainty in DEMs from repeat topographic surveys",
    "Estimation of erosion and deposition volumes",
    "Estimates of the regression coefficient based on Kendall's tau",
    "Uncertainty analysis of digital elevation models by spatial inference from stable terrain",
    "Co-registration and bias corrections of satellite elevation data sets",
    "Object modeling by registration of multiple range images",
    "Accuracy assessment of digital elevation models by means of robust statistical methods",
    "Bias compensation in rational functions",
    "Bias compensation in rational functions for Ikonos satellite imagery",
    "A critical analysis of satellite stereo pairs for digital surface model generation",
    "Stereo processing by semi-global matching and mutual information",
    "Pixelwise view selection for unstructured multi-view stereo",
    "Leveraging vision reconstruction pipelines for satellite imagery",
}
STRESSED = {
    "en": {"not", "all", "area", "orthorectified", "projected", "ortho-ready"},
    "de": {"keine", "orthorektifiziertes", "projiziertes", "ortho-ready"},
}


def names_in(page: pathlib.Path) -> list[str]:
    """The texts in italics of a page, outside of code."""
    text = re.sub(r"(?m)^    .*$|```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"))
    text = text.replace("**", "")
    return [re.sub(r"\s+", " ", name) for name in re.findall(r"\*(\S(?:[^*]*\S)?)\*", text)]


def bare(text: str) -> str:
    """A shown text without what a sentence leaves out: mnemonics, its number, its unit in brackets, a colon."""
    text = re.sub(r"^\d+(\.\d+)?\.? ", "", text.replace("&", "")).replace("...", "…")
    return re.sub(r" \((m|px|m²|%|GiB|MiB)\)$", "", text).rstrip(":")


@pytest.fixture(scope="module")
def collector():
    spec = importlib.util.spec_from_file_location("i18n_script", ROOT / "scripts" / "i18n.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def of_algorithms() -> set[str]:
    """What the toolbox and the dialogs of a run show now, in the language that is set."""
    from repm.processing_provider.words import groups, shown

    found = [title for title, _ in groups()]
    for each in QgsApplication.processingRegistry().providerById("repm").algorithms():
        algorithm = each.create()
        found += [algorithm.displayName(), algorithm.group()]
        for entry in [*algorithm.parameterDefinitions(), *algorithm.outputDefinitions()]:
            values = getattr(entry, "options", list)()
            found += [entry.description(), *(shown(entry.name(), value) for value in values)]
    return {bare(text) for text in found}


def of_windows(collector, language: str) -> tuple[set[str], set[str]]:
    """What the entries of the menu, and all windows and messages of the desktop, say in a language."""
    pairs = {
        (context, text): text
        for path in sorted((ROOT / "desktop").glob("*.py"))
        for context, texts in collector.texts_of(path).items()
        for text in texts
    }
    if language != "en":
        done = collector.translations(ROOT / "i18n" / f"repm_{language}.ts")
        pairs = {key: done[key] for key in pairs}
    menu = {bare(text) for (context, _), text in pairs.items() if context == "PluginMenu"}
    return menu, {bare(text) for text in pairs.values()}


def of_results(collector, language: str) -> set[str]:
    """What reports, layers, styles and the page in 3-D say in a language."""
    if language == "en":
        return set(collector.engine_texts())
    return set(json.loads((ROOT / "i18n" / f"engine_{language}.json").read_text(encoding="utf-8")).values())


def of_qgis(language: str) -> set[str]:
    """QGIS's names, each looked up in its own translations."""
    known = {text: places.split() for text, places in OF_QGIS.items()}
    known.update({text: [place] for text, (first, place, _) in LATER.items() if Qgis.versionInt() >= first})
    newer = {text: word for text, (_, _, word) in LATER.items() if text not in known}
    german = QTranslator()
    assert german.load(str(pathlib.Path(QgsApplication.i18nPath()) / "qgis_de.qm")), "QGIS's translations are missing"
    words = {
        text: next(filter(None, (german.translate(place, text.encode()) for place in places)), "")
        for text, places in known.items()
    }
    assert all(words.values()), f"QGIS has no such text: {[text for text, word in words.items() if not word]}"
    words.update(newer)
    assert all(words[text] in forms for text, forms in OF_VERSIONS.items())
    shown = list(words) if language == "en" else [*words.values(), *set().union(*OF_VERSIONS.values())]
    return {bare(text) for text in shown}


def wrong_in(page: pathlib.Path, menu: set[str], shown: set[str], stressed: set[str]) -> list[str]:
    """The names of a page that nothing has: a path's parts are looked up one by one, ours in our menu."""
    wrong = []
    for name in names_in(page):
        parts = name.split(" > ")
        ours = len(parts) == 3 and parts[1] == "REPM"
        known = [part in shown for part in parts[:-1]] + [bare(parts[-1]) in (menu if ours else shown)]
        if not all(known) and name not in stressed:
            wrong.append(name)
    return wrong


@pytest.mark.parametrize("language", ("en", "de"))
@pytest.mark.long
def test_each_name_in_italics_is_shown(language, collector, request):
    if language == "de":
        request.getfixturevalue("german")
    menu, windows = of_windows(collector, language)
    shown = of_algorithms() | windows | of_results(collector, language) | of_qgis(language) | {"REPM"}
    assert len(menu) >= 9 and len(shown) > 1000
    stressed = STRESSED[language] | CITED
    wrong = {str(page.relative_to(ROOT)): wrong_in(page, menu, shown, stressed) for page in PAGES[language]}
    assert not any(wrong.values()), "\n".join(f"{page}: {name}" for page, names in wrong.items() for name in names)


def test_each_exception_is_needed():
    """A name that no page has any more leaves the lists."""
    written = {language: {name for page in pages for name in names_in(page)} for language, pages in PAGES.items()}
    parts = {part for name in written["en"] for part in name.split(" > ")}
    assert not {bare(text) for text in (*OF_QGIS, *LATER)} - parts
    assert not CITED - written["en"]
    assert not any(words - written[language] for language, words in STRESSED.items())


@pytest.mark.parametrize(
    "text, wrong",
    (
        ("Press *Make a DSM*.", ["Make a DSM"]),
        ("*Plugins > REPM > Make a DSM…*, *Plugins > REPM > Undo*", ["Plugins > REPM > Undo"]),
        ("***Undo*** and **bold**, `*code*`, *Tie\npoints*, *DSM resolution*", []),
        ("*Copy to my models*", ["Copy to my models"]),
    ),
)
def test_a_wrong_name_is_noticed(collector, tmp_path, text, wrong):
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    menu, windows = of_windows(collector, "en")
    assert wrong_in(page, menu, of_algorithms() | windows | {"Plugins", "REPM"}, set()) == wrong
