"""Broken and hostile RPC files: refused with a sentence, or read as what they say, in bounded time and memory."""

from __future__ import annotations

from pathlib import Path

import pytest

from repm_qgis.rpc import Rpc
from repm_qgis.rpc.readers import read_rpc_file
from tests.engine.rpc.fuzz import MAX_MB, MAX_MS, fuzz
from tests.engine.rpc.mutations import MUTATIONS, example
from tests.engine.rpc.naive_reader import naive
from tests.engine.rpc.writers import WRITERS


@pytest.mark.slow
def test_two_thousand_broken_files():
    report = fuzz(2000, seed=20)
    assert report.crashed == [] and report.wrong == [], report.table()
    assert report.inputs == 2000
    assert report.slowest_ms < MAX_MS and report.peak_mb < MAX_MB, report.table()
    # The run says something only if it breaks files in every way, and both refuses and accepts.
    assert {mutation.__name__ for mutation in MUTATIONS} <= set(report.refused + report.identical + report.different)
    assert sum(report.refused.values()) > 1000 and sum(report.identical.values()) > 100
    assert report.different["number_to_number"] > 50 and report.different["truncated"] <= 3


def test_the_second_reader_finds_what_was_written():
    rpc = example()
    for name, write in WRITERS.items():
        numbers = naive(name, write(rpc).encode())
        assert numbers["row_off"] == (rpc.row_off,) and numbers["height_scale"] == (rpc.height_scale,), name
        assert [numbers[k] for k in ("row_num", "row_den", "col_num", "col_den")] == [
            rpc.row_num,
            rpc.row_den,
            rpc.col_num,
            rpc.col_den,
        ], name


def careless(path: str) -> Rpc:
    """A reader that takes a word which is no number for zero."""
    data = Path(path).read_bytes()
    for word in ("12px", "abc", "true", "null", "1_000", "--5", "0x1F", "1.#QNAN", "3.0.1"):
        data = data.replace(word.encode(), b"0")
    Path(path).write_bytes(data)
    return read_rpc_file(path)


@pytest.mark.long
def test_a_reader_that_takes_zeros_for_missing_numbers_would_be_found():
    """The fuzz itself can fail: with a careless reader it does."""
    assert fuzz(400, seed=3, read=careless).wrong
