"""The pixels of exported images and their masks, written in strips, so that memory does not grow with the image."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Iterator, Optional, Tuple

import numpy as np
from numpy.typing import NDArray
from osgeo import gdal

from ..contracts.arrays import FloatImage, Window
from ..contracts.errors import ImageError
from ..imagery.enhancement import Stretch
from ..imagery.raster import RasterFrame, RasterWriter, created, opened, quiet, read
from ..imagery.warping import warp_strips
from ..runtime.progress import Progress
from ..runtime.workspace import not_written, whole_file
from .model import ExportView

_STRIP = 512  # rows
_ENCODERS = {".png": ("PNG", ()), ".jpg": ("JPEG", ("QUALITY=95",))}  # 95: without visible loss


def write_image(
    view: ExportView, path: Path, mask: Optional[Path], stretch: Optional[Stretch], kernel: str, progress: Progress
) -> None:
    """Write a view's image and, where ``mask`` is given, its mask (255 where the image has data).

    With ``stretch`` it is an 8-bit PNG or JPEG, by the extension of ``path``, with values 1..255; without, a 16-bit
    TIFF with the image's own values, 1..65535. 0 is nodata.

    Raises ImageError where a source cannot be read, WorkspaceError where a file cannot be written.
    """
    plain = str(path) if stretch is None else f"{path}.tif"
    with ExitStack() as files:

        def band(name: str, dtype: "np.dtype[np.generic]", compress: bool) -> RasterWriter:
            frame = RasterFrame(view.size[::-1], dtype)
            return files.enter_context(created(name, frame, nodata=None, compress=compress))

        pixels = band(plain, np.dtype(np.uint16 if stretch is None else np.uint8), stretch is None)
        known = band(f"{mask}.tif", np.dtype(np.uint8), False) if mask else None
        for row, values in _strips(view, kernel):
            progress.check_cancelled()
            pixels.write(_integers(values, stretch), 0, row)
            if known is not None:
                known.write(np.where(np.isfinite(values), 255, 0).astype(np.uint8), 0, row)
    if stretch is not None:
        encode(plain, path)
    if mask:
        encode(f"{mask}.tif", mask)


def _integers(values: FloatImage, stretch: Optional[Stretch]) -> NDArray[np.unsignedinteger[Any]]:
    """Intensity as integers, 0 only for NaN."""
    whole = np.clip(values, 1, 65535) if stretch is None else 1 + 254 * stretch.apply(values)
    rounded = np.where(np.isfinite(values), np.rint(np.nan_to_num(whole)), 0)
    return rounded.astype(np.uint16 if stretch is None else np.uint8)


def _strips(view: ExportView, kernel: str) -> Iterator[Tuple[int, FloatImage]]:
    """First row and pixels of each strip: from the refined image if it exists, else resampled from the original."""
    if _is_refined_image(view):
        with opened(view.source) as dataset:
            for row in range(0, view.size[1], _STRIP):
                yield row, read(dataset, Window(0, row, view.size[0], min(_STRIP, view.size[1] - row)))
        return
    with opened(view.view.image) as dataset:
        yield from warp_strips(dataset, view.view.band, view.to_original, view.size, kernel)


def _is_refined_image(view: ExportView) -> bool:
    if not view.source or not os.path.exists(view.source):
        return False
    try:
        with opened(view.source) as dataset:
            return (dataset.RasterXSize, dataset.RasterYSize) == tuple(view.size)
    except ImageError:
        return False


def encode(plain: str, path: Path) -> None:
    """Convert ``plain`` (a raster, which is removed) to PNG or JPEG by ``path``'s extension; raises WorkspaceError."""
    try:
        _convert(plain, path)
    finally:  # its own function has ended, and with it the last name of the open file: Windows removes no open one
        if os.path.exists(plain):
            os.unlink(plain)


def _convert(plain: str, path: Path) -> None:
    driver, options = _ENCODERS[path.suffix]
    with whole_file(str(path)) as temporary, opened(plain) as source, quiet():
        try:
            made = gdal.GetDriverByName(driver).CreateCopy(temporary, source, 0, list(options))
            made = None  # noqa: F841 - closes, and so completes, the file
            reason = gdal.GetLastErrorMsg() if gdal.GetLastErrorType() >= gdal.CE_Failure else ""
        except (RuntimeError, AttributeError) as error:  # AttributeError: a GDAL without the driver
            reason = str(error)
        if reason or not os.path.exists(temporary):
            raise not_written(str(path), reason or f"GDAL lacks its {driver} driver", temporary)
