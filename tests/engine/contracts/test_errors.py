"""Why the system refused something, in the words of a message."""

from __future__ import annotations

import errno
import os

import pytest

from repm_qgis.contracts.errors import reason_of


@pytest.mark.parametrize(
    "error, words",
    (
        (OSError(errno.ENOENT, "Das System kann die angegebene Datei nicht finden"), os.strerror(errno.ENOENT)),
        (OSError(errno.EACCES, "in use by another process"), "in use by another process"),
        (OSError("no number"), "no number"),
    ),
)
def test_what_is_absent_is_said_in_the_same_words_on_each_system(error, words):
    """Windows gives its own words, in its own language, to what is absent."""
    assert reason_of(error) == words
