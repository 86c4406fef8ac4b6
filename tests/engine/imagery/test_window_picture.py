"""A part of an image on the screen: the right pixels, in the right place, at every scale."""

from __future__ import annotations

import numpy as np

from repm_qgis.imagery.raster import write
from repm_qgis.imagery.window_picture import window_picture


def image(tmp_path):
    values = np.zeros((100, 120), np.float32)
    values[40:60, 70:80] = 1000.0
    return write(str(tmp_path / "a.tif"), [values], (0, 1, 0, 0, 0, 1), "")


def test_the_window_covers_the_screen_and_shows_what_is_there(tmp_path):
    grey, window = window_picture(image(tmp_path), 1, np.array([75.0, 50.0]), 4.0, (80, 80))
    assert grey.shape == (window.height, window.width)
    assert window.col <= 75 - 10 and window.col + window.width > 75 + 10
    assert grey[50 - window.row, 75 - window.col] == 255 and grey[50 - window.row, 66 - window.col] == 0


def test_a_small_scale_reads_a_reduced_image(tmp_path):
    grey, window = window_picture(image(tmp_path), 1, np.array([60.0, 50.0]), 0.25, (200, 200))
    assert tuple(window) == (0, 0, 120, 100) and grey.shape == (25, 30)
    assert grey[12, 18] == 255 and grey[2, 2] == 0


def test_outside_the_image_there_is_nothing(tmp_path):
    assert window_picture(image(tmp_path), 1, np.array([500.0, 500.0]), 4.0, (80, 80)) is None
