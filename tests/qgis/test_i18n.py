"""Languages: the translator loads, and no translation can break a message."""

from __future__ import annotations

import ast
import dataclasses
import importlib.util
import json
import pathlib
import re
import shutil
from xml.etree import ElementTree

import pytest
from qgis.core import QgsApplication, QgsProcessingException, QgsProcessingOutputLayerDefinition, QgsProject

from repm_qgis.contracts.results import DsmFuseResult
from repm_qgis.contracts.stages import ENVIRONMENT, REFINE
from tests.english import english_in

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def collector():
    spec = importlib.util.spec_from_file_location("i18n_script", ROOT / "scripts" / "i18n.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_german_qgis_shows_german(german, context):
    assert german.translator is not None
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline").create()
    assert algorithm.displayName() == "1.1 DOM aus Satellitenbildern erzeugen"
    assert algorithm.group() == "1 Bilder zu DOM"  # shared by all algorithms
    assert algorithm.parameterDefinition("IMAGES").description() == "Satellitenbilder mit RPC"
    model = QgsApplication.processingRegistry().algorithmById("repm:dsm_by_stages")
    assert (model.group(), model.groupId()) == (algorithm.group(), algorithm.groupId())
    said = algorithm.checkParameterValues({"DEM": "gone.tif"}, context)[1]
    assert said == "DEM „gone.tif“ ist nicht da: den Pfad prüfen."


def test_texts_of_modules_are_german_where_they_are_looked_up(german):
    """A module's own function looks its texts up in a context of its own: the button and the page were English."""
    from repm.desktop import client_page, preview
    from repm.processing_provider import parameters

    from repm_qgis.names import marked
    from repm_qgis.runtime.translation import written_in

    assert preview._tr("Preview") == "Vorschau" and client_page._tr("date unknown") == "Datum unbekannt"
    assert parameters.tr("Footprints") == "Bildflächen"
    with written_in("de"):
        assert marked("hills", False, "preview") == "Vorschau, hills"


def test_without_a_translation_the_source_is_shown(plugin):
    assert QgsApplication.processingRegistry().algorithmById("repm:pipeline").create().displayName() == (
        "1.1 Make a DSM from satellite images"
    )


@pytest.mark.long
def test_everything_is_translated_and_places_for_values_are_kept(collector):
    """'make i18n' names what is missing; nothing that has gone from the source is left."""
    done = collector.translations(ROOT / "i18n" / "repm_de.ts")
    pairs = {text: done.get((context, text)) for context, found in collector.source().items() for text in found}
    engine = collector.engine_catalogue("de")
    written = json.loads((ROOT / "i18n" / "engine_de.json").read_text(encoding="utf-8"))
    assert len(pairs) > 200 and len(engine) > 900
    missing = [text for text, word in [*pairs.items(), *engine.items()] if not word]
    assert not missing, "run 'make i18n' and translate"
    assert written == engine, "run 'make i18n'"
    for text, word in [*pairs.items(), *engine.items()]:
        assert set(re.findall(r"{[^}]*}", word)) == set(re.findall(r"{[^}]*}", text)), word
    assert not english_in(written.values())


def test_a_new_sentence_of_the_engine_is_noticed(collector):
    """Whatever its form is: plain, with values, of parts, with a plural, in two ways."""
    source = """
def f(progress, count, path):
    \"\"\"A docstring that nobody sees.\"\"\"
    progress.info(f"Found {count:.1f} new things in '{path}'.")
    text = "plain words " + f"and {count} more of them"
    progress.warn(f"{counted(count, 'brown fox')} {'is' if count == 1 else 'are'} quick")
    table("file | mean, px", [])
    raise TypeError("a bug that a developer sees")
"""
    found = collector._read_in(ast.parse(source.replace(chr(92), "")))
    assert "Found {0} new things in '{1}'." in found and "plain words and {0} more of them" in found
    assert {"1 brown fox", "{0} brown foxs", "{0} is quick", "{0} are quick", "file", "mean, px"} <= set(found)
    assert not [text for text in found if "docstring" in text or "bug" in text]


def test_what_stays_english_has_a_reason(collector):
    found = json.loads((ROOT / "i18n" / "stays_english.json").read_text(encoding="utf-8"))
    assert found and all(len(reason.split()) >= 5 and texts for reason, texts in found.items())


def algorithms():
    return [each.create() for each in QgsApplication.processingRegistry().providerById("repm").algorithms()]


def test_dialogs_and_help_are_german(german):
    assert len(algorithms()) >= 13
    found = {}
    for algorithm in algorithms():
        texts = [algorithm.displayName(), algorithm.group(), algorithm.shortDescription()]
        texts += re.split(r"(?=<[hplu])", algorithm.shortHelpString())
        for entry in [*algorithm.parameterDefinitions(), *algorithm.outputDefinitions()]:
            texts.append(entry.description())
        texts += [entry.help() for entry in algorithm.parameterDefinitions()]
        found[algorithm.id()] = english_in(texts)
    assert not any(found.values()), {name: texts for name, texts in found.items() if texts}


@pytest.mark.long
def test_logs_errors_and_reports_of_both_kinds_of_runs_are_german(german, feedback, tmp_path):
    from repm.processing_provider import engine

    for run, name in ((engine.run_here, "here"), (engine.run_apart, "apart")):
        report = tmp_path / f"{name}.html"
        run(ENVIRONMENT, {"report": str(report)}, feedback)
        assert '<html lang="de">' in report.read_text(encoding="utf-8")
        with pytest.raises(QgsProcessingException, match="die scene.json wählen") as caught:
            run(REFINE, {"scene": str(tmp_path / "gone.json"), "output_scene": str(tmp_path / "o.json")}, feedback)
        assert not english_in([str(caught.value)])
    heard = [text for texts in ("info", "warning", "text") for text in feedback.heard[texts]]
    assert any("prüfe Pakete und Geräte" in text for text in heard) and not english_in(heard)


def test_the_name_of_a_dsm_says_its_datum_in_german(german, context, feedback, tmp_path, monkeypatch):
    project, path = QgsProject(), str(tmp_path / "dsm.tif")
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:dsmfuse").create()
    algorithm._inputs = {"scene": "/work/stadt/scene.json"}
    monkeypatch.setattr(algorithm, "complete", lambda options: options)
    others = {each.name: None for each in dataclasses.fields(DsmFuseResult)}
    made = DsmFuseResult(**{**others, "output": path, "vertical_datum": "WGS 84 ellipsoid"})
    monkeypatch.setattr(algorithm, "run_stage", lambda *_: made)
    algorithm._processed({"OUTPUT": QgsProcessingOutputLayerDefinition(path, project)}, context, feedback)
    assert context.layerToLoadOnCompletionDetails(path).name == "DOM stadt (Ellipsoid WGS 84)"


def test_the_compiled_file_is_in_the_package_and_has_each_text_once():
    """QGIS reads it whole at each start: it holds the dialogs' texts, and none of the engine's."""
    contexts = ElementTree.parse(ROOT / "i18n" / "repm_de.ts").iter("context")  # noqa: S314 - our own file
    texts = [
        (message.findtext("source").encode(), message.findtext("translation").encode("utf-16-le"))
        for context in contexts
        for message in context.iter("message")
    ]
    overhead = 48  # of a text in Qt's format: its context's name, hash, place and the lengths of its parts
    size = (ROOT / "i18n" / "repm_de.qm").stat().st_size
    assert 0 < size - sum(map(len, (part for text in texts for part in text))) < overhead * len(texts)
    package = (ROOT / "scripts" / "package").read_text(encoding="utf-8")
    assert "i18n" not in package.split("LEFT_OUT_SCRIPTS")[0]


@pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)
@pytest.mark.long
def test_windows_are_german(desktop_start):
    found = desktop_start("drive_german.py", {}, seconds=90, locale="de")["windows"]
    assert len(found) >= 15 and sum(map(len, found.values())) > 300
    left = {name: english_in(texts) for name, texts in found.items()}
    assert not any(left.values()), {name: texts for name, texts in left.items() if texts}
