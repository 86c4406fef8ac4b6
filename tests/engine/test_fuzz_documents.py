"""A small share of the campaign with damaged scenes, jobs and tables; ``make bench-faults`` runs all of it."""

from __future__ import annotations

import os
import signal

import pytest

from tests.engine.fuzz_documents import campaign


@pytest.mark.skipif(os.name == "nt" or not hasattr(signal, "alarm"), reason="needs an alarm clock")
@pytest.mark.slow
def test_every_damaged_document_is_refused_in_a_sentence_or_works(tmp_path):
    ended = dict(campaign(tmp_path, 120, 5))
    assert len(ended) == 121 and {name: said for name, said in ended.items() if said} == {}
