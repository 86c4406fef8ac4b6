"""Reads workspaces and pictures of images beside QGIS's thread, for the panel of scenes."""

from __future__ import annotations

import queue
import threading
import time
from typing import Callable, Optional

from qgis.PyQt.QtGui import QImage

THUMBNAIL_PX = 64
_THUMBNAIL_S = 3.0  # until an image without overviews is given up


class Reader(threading.Thread):
    """Reads workspaces and pictures beside QGIS's thread, in the order in which they are asked for."""

    def __init__(self, give: Callable[[object, object], None]) -> None:
        super().__init__(daemon=True, name="REPM scenes")
        self._give, self._asked = give, queue.Queue()  # type: ignore[var-annotated]
        self.waiting = 0
        self.start()

    def ask(self, about: object, read: Callable[[], object]) -> None:
        self.waiting += 1
        self._asked.put((about, read))

    def stop(self) -> None:
        self._asked.put(None)

    def run(self) -> None:
        for about, read in iter(self._asked.get, None):
            try:
                result = read()
            except Exception as error:  # of one workspace; the others are shown
                result = error
            try:
                self._give(about, result)
            except RuntimeError:  # the dock is gone
                return


def picture_of(path: str) -> Optional[QImage]:
    """A small picture of an image; None where it takes too long, or cannot be read. Rows are read one by one: a file
    without overviews is read whole otherwise."""
    import numpy as np

    from ..repm_qgis.contracts.errors import RepmError
    from ..repm_qgis.imagery.raster import opened

    end = time.monotonic() + _THUMBNAIL_S
    try:
        with opened(path) as dataset:
            band, width, height = dataset.GetRasterBand(1), dataset.RasterXSize, dataset.RasterYSize
            share = THUMBNAIL_PX / max(width, height)
            size = max(1, round(width * share)), max(1, round(height * share))
            if band.GetOverviewCount() or width * height <= 4_000_000:
                grey = band.ReadAsArray(buf_xsize=size[0], buf_ysize=size[1])
            else:
                rows = []
                for row in range(size[1]):
                    rows.append(band.ReadAsArray(0, int((row + 0.5) / share), width, 1, buf_xsize=size[0], buf_ysize=1))
                    if time.monotonic() > end:
                        return None
                grey = np.concatenate(rows)
    except (RepmError, RuntimeError):
        return None
    if grey is None:
        return None
    values = grey.astype(float)
    low, high = np.percentile(values, (2, 98))
    shown = np.ascontiguousarray(np.clip((values - low) / max(high - low, 1e-9) * 255, 0, 255).astype(np.uint8))
    return QImage(shown.tobytes(), size[0], size[1], size[0], QImage.Format.Format_Grayscale8).copy()
