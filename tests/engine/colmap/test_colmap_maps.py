"""COLMAP's map files, as COLMAP itself reads and writes them, and as they must not be believed."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from repm_qgis.colmap.maps import read_map
from repm_qgis.contracts.errors import ImageError
from tests.engine.colmap.emulation import write_map
from tests.engine.versions import needs_pycolmap_4


def values():
    return np.random.default_rng(0).normal(size=(7, 11)).astype(np.float32)


@needs_pycolmap_4
def test_colmap_reads_what_is_written_and_writes_what_is_read(tmp_path):
    path = str(tmp_path / "depth.bin")
    write_map(path, values())
    theirs = pycolmap.DepthMap()
    theirs.read(path)
    np.testing.assert_array_equal(theirs.to_array(), values())
    theirs.write(str(tmp_path / "again.bin"))
    np.testing.assert_array_equal(read_map(str(tmp_path / "again.bin"), (11, 7)), values())


@pytest.mark.parametrize(
    "content, words",
    [
        (b"", "is not a map of COLMAP"),
        (b"II*\x00" + bytes(50), "is not a map of COLMAP"),
        (b"11&7&" + bytes(400), "is not a map"),
        (b"99999999999&7&1&", "is not a map"),
        (b"12&7&1&" + bytes(4 * 84), "12 x 7 x 1"),
        (b"11&7&3&" + bytes(4 * 77), "11 x 7 x"),
        (b"11&7&1&" + bytes(4 * 77 - 1), "damaged"),
        (b"11&7&1&" + bytes(4 * 77 + 1), "damaged"),
        (b"-1&7&1&" + bytes(8), "is not a map"),
    ],
)
def test_a_file_that_is_no_such_map_is_refused_in_one_sentence(tmp_path, content, words):
    path = tmp_path / "x.bin"
    path.write_bytes(content)
    with pytest.raises(ImageError, match=words) as caught:
        read_map(str(path), (11, 7))
    assert "x.bin" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(ImageError, match="Cannot read the map"):
        read_map(str(tmp_path / "none.bin"), (11, 7))


def test_broken_bytes_never_give_another_image(tmp_path):
    """Whatever 300 damaged files hold, an array of the image's size comes back, or ImageError."""
    path = tmp_path / "x.bin"
    write_map(str(path), values())
    whole, numbers = path.read_bytes(), np.random.default_rng(4)
    for _ in range(300):
        broken = bytearray(whole)
        for place in numbers.integers(0, 12, 2):
            broken[place] = numbers.integers(0, 256)
        path.write_bytes(bytes(broken[: numbers.integers(1, len(whole) + 1)]) if numbers.random() < 0.5 else broken)
        try:
            assert read_map(str(path), (11, 7)).shape == (7, 11)
        except ImageError:
            pass
