"""Languages: the translator loads, and no translation can break a message."""

from __future__ import annotations

import importlib.util
import pathlib
import re

import pytest
from qgis.core import QgsApplication

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


def test_without_a_translation_the_source_is_shown(plugin):
    assert QgsApplication.processingRegistry().algorithmById("repm:pipeline").create().displayName() == (
        "1.1 Make a DSM from satellite images"
    )


def test_most_is_translated_and_places_for_values_are_kept(collector):
    done = collector.translations(ROOT / "i18n" / "repm_de.ts")
    texts = [(context, text) for context, found in collector.source().items() for text in found]
    translated = [key for key in texts if done.get(key)]
    assert len(translated) > 0.8 * len(texts) > 80, "run 'make i18n' and translate"
    for context, text in translated:
        word = done[context, text]
        assert sorted(re.findall(r"{[^}]*}", word)) == sorted(re.findall(r"{[^}]*}", text)), word


def test_the_compiled_file_is_in_the_package():
    assert (ROOT / "i18n" / "repm_de.qm").stat().st_size < 100_000
    package = (ROOT / "scripts" / "package").read_text(encoding="utf-8")
    assert "i18n" not in package.split("LEFT_OUT_SCRIPTS")[0]
