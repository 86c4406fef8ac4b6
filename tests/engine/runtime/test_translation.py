"""The engine's texts in a reader's language: by templates, and nothing but what people read changes."""

from __future__ import annotations

import io
import json
import re

import pytest

from repm_qgis.contracts.data_folder import DATA_FOLDER
from repm_qgis.contracts.errors import OptionError
from repm_qgis.contracts.findings import Finding
from repm_qgis.reports.report import Report
from repm_qgis.runtime.packages import PACKAGES
from repm_qgis.runtime.progress import JsonLines
from repm_qgis.runtime.translation import Translator, reader, said, written_in

WORDS = {
    "{0} tiles of up to {1} px": "{0} Kacheln, bis {1} px groß",
    "The scene '{0}' has {1}: {2}.": "In der Szene „{0}“ ist {1}: {2}.",
    "no view": "keine Ansicht",
    "choose another of {0}": "von {0} eine andere wählen",
    "{0} to {1}": "{0} bis {1}",
    "{0} in {1}": "{1}: {0}",
    ", or 0 for automatic": ", oder 0 für automatisch",
    "Done": "Fertig",
    "It ended.": "Es ist zu Ende.",
}


@pytest.fixture
def german():
    return Translator("de", WORDS)


@pytest.mark.parametrize(
    "english, expected",
    [
        ("12 tiles of up to 900 px", "12 Kacheln, bis 900 px groß"),
        (
            "The scene 'no view' has no view: choose another of a, b.",
            "In der Szene „no view“ ist keine Ansicht: von a, b eine andere wählen.",
        ),
        ("4 in Done", "Fertig: 4"),  # fields in another order
        ("3 to 5 m, or 0 for automatic", "3 bis 5 m, oder 0 für automatisch"),  # a phrase that is added to another
        ("It ended. It ended. 3 to 4.", "Es ist zu Ende. Es ist zu Ende. 3 bis 4."),
        ("Done: no view", "Fertig: keine Ansicht"),  # and not as a sentence that begins with "done"
        ("Step: 2 tiles of up to 5 px", "Step: 2 Kacheln, bis 5 px groß"),
        ("/home/Done/x.tif", "/home/Done/x.tif"),
        ("what nobody wrote to anyone", "what nobody wrote to anyone"),
        ("", ""),
        ("17.5", "17,5"),
    ],
)
def test_texts_are_translated_by_what_fits_most_literally(german, english, expected):
    assert german.translate(english) == expected


def test_what_fits_nothing_is_told_apart(german):
    assert not german.search("what nobody wrote").whole and not german.search("what nobody wrote in Done").whole
    assert german.search("Done").whole and german.search("17 in /home/x.tif").whole


@pytest.mark.parametrize("value", ("1{0}.5", "/data/town_{0}/image-{0}.tif", "IMG_{0}", "Zürich-{0}"))
def test_every_sentence_of_the_catalogue_is_known_again_with_what_is_filled_in(value):
    """No sentence is taken for another one, though they are told apart by their words alone."""
    catalogue = json.loads((DATA_FOLDER / "i18n" / "engine_de.json").read_text(encoding="utf-8"))
    translator = Translator.of("de")
    with_fields = {source: target for source, target in catalogue.items() if "{0}" in source}
    assert len(with_fields) > 800

    def filled(template):
        return re.sub(r"\{(\d+)\}", lambda field: value.format(field[1]), template)

    # A number has a decimal comma, but in quotation marks.
    wrong = {
        source
        for source, target in with_fields.items()
        if translator.translate(filled(source)).replace(",5", ".5") != filled(target).replace(",5", ".5")
    }
    assert wrong == set()


@pytest.mark.parametrize(
    ("text", "expected"),
    (
        ("0.53", "0,53"),
        ("-1.9 %", "-1,9 %"),
        ("0.5 × 0.5", "0,5 × 0,5"),
        ("3.11.2", "3.11.2"),
        ("x 436080.5..436330.5, y 3357495.0..3357752.5", "x 436080.5..436330.5, y 3357495.0..3357752.5"),
        ("52.123456", "52.123456"),
        ("+0.12, -0.30, +1.00", "+0.12, -0.30, +1.00"),
        (
            "'/a 2.5/b 1.5.tif' fits to 'c_0.5.tif' better 2.0 m beside its place",
            "„/a 2.5/b 1.5.tif“ passt 2,0 m neben seiner Lage besser zu „c_0.5.tif“",
        ),
        ("Choose SLOPE=2.5", "Choose SLOPE=2.5"),
    ),
)
def test_numbers_have_a_decimal_comma_where_they_are_no_names(text, expected):
    assert Translator.of("de").translate(text) == expected
    assert Translator.of("en").translate(text) == text


def test_long_hostile_text_takes_no_time(german):
    text = "The scene '" + "' has : " * 20000
    assert german.translate(text) == text


def test_a_language_is_found_by_its_code_and_falls_back_to_english():
    assert Translator.of("de").language == Translator.of("de_AT").language == Translator.of("de-CH").language == "de"
    assert Translator.of("xx").language == Translator.of("C").language == Translator.of("").language == "en"
    assert Translator.of("../de").language == "en"


def test_english_is_the_default_and_comes_back():
    assert said("Done") == "Done"
    with written_in("de"):
        assert reader().language == "de"
    assert reader().language == "en"
    with pytest.raises(OptionError, match="language"), written_in("../../x"):
        pass


def test_a_page_records_its_language():
    with written_in("de"):
        assert '<html lang="de">' in Report("x").html()
    assert '<html lang="en">' in Report("x").html()


def test_the_engines_lines_are_said_in_the_jobs_language(german):
    stream = io.StringIO()
    lines = JsonLines(stream)
    lines.translate = german.translate
    lines.step(0.5, "2 tiles of up to 5 px")
    lines.info("Done")
    lines.warn(Finding("done", "Done"))
    texts = [json.loads(line)["text"] for line in stream.getvalue().splitlines()]
    assert texts == ["2 Kacheln, bis 5 px groß", "Fertig", "Fertig"]


def test_what_is_missing_is_german_with_what_it_is_for():
    """A machine that lacks a package is rare, so no run of the other tests shows these sentences."""
    german = Translator.of("de")
    for package in PACKAGES:
        text = f"Not installed: {package.distribution}: {package.purpose}; {package.distribution}: {package.purpose}."
        said = german.translate(text)
        assert said.startswith(f"Nicht installiert: {package.distribution}: ") and package.purpose not in said
