"""Messages in the words of a dialog: labels for names of parameters, and decimals of the language."""

from __future__ import annotations

import pytest

from repm_qgis.runtime.wording import with_decimals, with_labels

LABELS = {"DSM": "DSM", "GCPS": "Ground control points", "REFERENCE_DATUM": "Heights of the reference", "FILL": "Fill"}


@pytest.mark.parametrize(
    ("text", "read"),
    [
        ("DSM is empty: it must be given.", "‘DSM’ is empty: it must be given."),
        ("REFERENCE_DATUM is 'x': it must be a datum.", "‘Heights of the reference’ is 'x': it must be a datum."),
        (
            "GCPS '/data/a.csv' is not there: check its path.",
            "‘Ground control points’ '/data/a.csv' is not there: check its path.",
        ),
        ("FILL ist leer", "‘Fill’ ist leer"),
        ("Run again with FILL=all or GCPS.", "Run again with ‘Fill’ = all or ‘Ground control points’."),
        ("The DSM is empty.", "The DSM is empty."),
        ("'/data/GCPS.csv' has no points", "'/data/GCPS.csv' has no points"),
    ],
)
def test_labels_stand_for_names(text, read):
    assert with_labels(text, LABELS) == read
    assert with_labels(text, {}) == text


@pytest.mark.parametrize(
    ("text", "german"),
    [
        ("0.5 m and 12.25 %", "0,5 m and 12,25 %"),
        ("dsm_0.5.tif of REPM 1.2.3", "dsm_0.5.tif of REPM 1.2.3"),
    ],
)
def test_decimals(text, german):
    assert with_decimals(text, "de") == german and with_decimals(text, "en") == text
