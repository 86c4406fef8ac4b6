"""Opening, reading and writing rasters by window, with GDAL.

Nothing here changes GDAL's global state: the engine may run inside QGIS.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterator, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import DTypeLike
from osgeo import gdal

from ..contracts.arrays import AnyArray, FloatImage, IntArray, Mask, Size, Window
from ..contracts.errors import ImageError
from ..contracts.formats import GEOTIFF, Format, raster_format
from ..files.untrusted import RASTERS, claimed, drivers_for, refusal_of, refusal_of_empty, unlike_an_image
from ..runtime.shortage import speaks_of_memory
from ..runtime.workspace import (
    file_identity,
    file_sample,
    not_written,
    take_name,
    temporary_folder,
    temporary_name,
)

NODATA = -9999.0

_STRIP_PX = 1 << 22  # of a mask that are read at once
_NO_OVERVIEWS = ["OVERVIEW_LEVEL=NONE"] if int(gdal.VersionInfo()) >= 3030000 else []  # older: the first overview alone

COLOURS = (gdal.GCI_RedBand, gdal.GCI_GreenBand, gdal.GCI_BlueBand)
_RED, _BLUE = np.float32(0.299), np.float32(0.114)  # of the grey; green has the rest


@contextmanager
def quiet() -> Iterator[None]:
    """GDAL's messages go into our exceptions and not to the console."""
    gdal.ErrorReset()
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        yield
    finally:
        gdal.PopErrorHandler()


def _attempt(work: Callable[[], object]) -> Tuple[Any, str]:
    """The result of work with GDAL, None if it failed, and GDAL's reason, "" if all went well.

    GDAL writes late, and libtiff only warns of a truncated file: return values do not show all that fails.
    """
    result, reason = None, ""
    with quiet():
        try:
            result = work()
        except RuntimeError as error:
            reason = str(error) or "no reason given"
            if speaks_of_memory(reason):  # not the file's fault
                raise MemoryError(reason) from error
        if not reason and (result is None or gdal.GetLastErrorType() >= gdal.CE_Failure):
            reason = gdal.GetLastErrorMsg() or "no reason given"
    return result, reason.strip().rstrip(".").replace("\n", " ")[:300]


def _require_written(path: str, reason: str) -> None:
    if reason:
        raise not_written(path, reason)


class MaskedImage:
    """An image and a mask of its size: :func:`read` gives NaN where the mask is neither zero nor nodata."""

    def __init__(self, image: gdal.Dataset, mask: gdal.Dataset) -> None:
        self.image, self.mask = image, mask
        self.RasterXSize, self.RasterYSize = image.RasterXSize, image.RasterYSize

    def GetDescription(self) -> str:  # noqa: N802 - GDAL's name
        return str(self.image.GetDescription())

    def excluded(self, window: Optional[Window] = None, size: Optional[Size] = None) -> Mask:
        """(height, width) what the mask excludes of a window, as :func:`read` takes it; reduced, what it touches."""
        if size is None:
            return np.asarray(np.nan_to_num(read(self.mask, window), nan=0.0) != 0)
        # GDAL's means of whole numbers are rounded: a tenth of an excluded pixel would count as none.
        col, row, width, height = window or (0, 0, self.RasterXSize, self.RasterYSize)
        found = np.zeros(size[::-1], dtype=bool)
        first, last = _parts(width, size[0])
        top, bottom = _parts(height, size[1])
        step = max(1, int(_STRIP_PX * size[1] / max(width * height, 1)))
        for begin in range(0, size[1], step):
            end = min(begin + step, size[1])
            strip = Window(col, row + int(top[begin]), width, int(bottom[end - 1] - top[begin]))
            rows = _any_of(self.excluded(strip), top[begin:end] - top[begin], bottom[begin:end] - top[begin])
            found[begin:end] = _any_of(rows.T, first, last).T
        return found


def _any_of(excluded: Mask, first: IntArray, last: IntArray) -> Mask:
    """(parts, columns) whether any row is excluded from the first of each part to before its last."""
    more = np.vstack([excluded, np.zeros((1, excluded.shape[1]), dtype=bool)])
    return np.asarray(np.logical_or.reduceat(more, np.column_stack([first, last]).ravel(), axis=0)[::2])


def _parts(pixels: int, size: int) -> Tuple[IntArray, IntArray]:
    """(size,) the first pixel of each of so many equal parts of a side, and the one after its last."""
    edges = np.arange(size + 1) * (pixels / size)
    return np.floor(edges[:-1] + 1e-9).astype(np.int64), np.ceil(edges[1:] - 1e-9).astype(np.int64)


Image = Union[gdal.Dataset, MaskedImage]


@contextmanager
def opened_masked(path: str, mask: str = "", overviews: bool = True) -> Iterator[Image]:
    """An image opened with its mask, if it has one; raises ImageError also for a mask of another size."""
    with opened(path, overviews) as image:
        if not mask:
            yield image
            return
        with opened(mask, overviews) as excluded:
            sizes = [(dataset.RasterXSize, dataset.RasterYSize) for dataset in (image, excluded)]
            if sizes[0] != sizes[1]:
                image_size, mask_size = (f"{width} x {height} px" for width, height in sizes)
                raise ImageError(
                    f"The mask '{mask}' has {mask_size}, its image '{path}' {image_size}: give a mask in the image's "
                    "own geometry, pixel for pixel."
                )
            yield MaskedImage(image, excluded)


@contextmanager
def opened(path: str, overviews: bool = True) -> Iterator[gdal.Dataset]:
    """A raster opened for reading, and closed in any case; raises ImageError with GDAL's reason, or with ours.

    Without its ``overviews``, a reduced reading is the mean of the pixels: overviews may be single pixels of them
    (gdaladdo's default), or what JPEG 2000 keeps, and files of other kinds would give other results.
    """
    path = str(path)
    _require(path, refusal_of(path))
    flags, drivers = gdal.OF_RASTER | gdal.OF_READONLY | gdal.OF_VERBOSE_ERROR, drivers_for(path, RASTERS)
    options = [] if overviews else _NO_OVERVIEWS
    dataset, reason = _attempt(lambda: gdal.OpenEx(path, flags, allowed_drivers=drivers, open_options=options))
    if dataset is None:
        hint = "it does not exist" if not os.path.exists(path) and "/vsi" not in path else reason
        raise ImageError(f"Cannot open the raster '{path}': {hint}. Check the path, or get the file again.")
    try:
        if dataset.RasterCount < 1:
            raise ImageError(f"'{path}' has no raster band: choose the image itself, not a container.")
        kind = dataset.GetRasterBand(1).DataType
        if gdal.DataTypeIsComplex(kind):
            raise ImageError(
                f"'{path}' has complex pixels ({gdal.GetDataTypeName(kind)}), as radar images have, and no intensities "
                "or heights: choose an optical image, or convert it to real numbers first."
            )
        _attempt(dataset.GetProjection)  # GDAL reads what lies beside it; GDAL 3.13 raises an error of damaged XML
        with quiet():
            _require(path, claimed(dataset))
        yield dataset
    finally:
        dataset = None


def _require(path: str, distrusted: str) -> None:
    if distrusted:
        raise ImageError(f"'{path}' {distrusted}")


@contextmanager
def opened_image(path: str, whole: bool = True) -> Iterator[gdal.Dataset]:
    """A satellite image opened as :func:`opened` does; raises ImageError too for what is none, by its size and, where
    the ``whole`` of it will be read, by its content."""
    with opened(path) as dataset:
        with quiet():
            _require(path, unlike_an_image(dataset) or (refusal_of_empty(dataset) if whole else ""))
        yield dataset


def require_content(path: str, part: Optional[Window] = None) -> None:
    """Raise ImageError where the file holds almost nothing of a part of its image (None: of the whole)."""
    with opened(path) as dataset, quiet():
        _require(path, refusal_of_empty(dataset, part))


def read(
    dataset: Image,
    window: Optional[Window] = None,
    band: int = 1,
    size: Optional[Size] = None,
    nearest: bool = False,
) -> FloatImage:
    """A window of one band as (height, width) float32; nodata and values that are not finite become NaN.

    So do pixels that the file's own mask or alpha band hides, or a :class:`MaskedImage` excludes. ``band`` 0 reads
    the grey of a colour image (ITU-R BT.601 luma), NaN where any colour is. ``size`` (width, height) reads it reduced,
    by averaging, from overviews unless it was opened without; ``nearest`` takes single pixels, for values that are
    names of classes. Raises ImageError for a truncated or damaged file.
    """
    if isinstance(dataset, MaskedImage):
        return np.where(dataset.excluded(window, size), np.float32(np.nan), read(dataset.image, window, band, size))
    if band == 0:
        meanings = colour_interpretations(dataset)
        red, green, blue = (read(dataset, window, meanings.index(colour) + 1, size) for colour in COLOURS)
        grey: FloatImage = green + _RED * (red - green) + _BLUE * (blue - green)  # equal colours are that grey exactly
        return grey
    col, row, width, height = window or (0, 0, dataset.RasterXSize, dataset.RasterYSize)
    handle = dataset.GetRasterBand(band)
    how = gdal.GRIORA_NearestNeighbour if nearest else gdal.GRIORA_Average
    options = {} if size is None else {"buf_xsize": size[0], "buf_ysize": size[1], "resample_alg": how}
    values, reason = _attempt(lambda: handle.ReadAsArray(col, row, width, height, **options))
    if reason:
        raise ImageError(
            f"Cannot read pixels {col}..{col + width - 1}, rows {row}..{row + height - 1} of "
            f"'{dataset.GetDescription()}': {reason}. The file is damaged or cut short: get it again."
        )
    nodata = handle.GetNoDataValue()
    result: FloatImage = values.astype(np.float32)
    if handle.GetMaskFlags() & gdal.GMF_PER_DATASET:  # an alpha or mask band, in the file or in a sidecar file
        with quiet():
            hidden = handle.GetMaskBand().ReadAsArray(col, row, width, height, *(size or ()))
        if hidden is not None:
            result[hidden == 0] = np.nan
    if nodata is not None:
        result[values == nodata] = np.nan
    if values.dtype.kind == "f":
        result[~np.isfinite(result)] = np.nan
    return result


class RasterWriter:
    """A raster that is being written; :func:`created` opens and closes it."""

    def __init__(self, dataset: gdal.Dataset, path: str) -> None:
        self._dataset, self._path = dataset, path

    def describe(
        self,
        geotransform: Optional[Sequence[float]],
        crs_wkt: str,
        nodata: Optional[float],
        descriptions: Sequence[str],
        metadata: Mapping[str, object],
        unit: str,
    ) -> None:
        """Set the place on the ground, and the facts of all bands."""
        if geotransform is not None:
            self._dataset.SetGeoTransform(list(geotransform))
        if crs_wkt:
            self._dataset.SetProjection(crs_wkt)
        if metadata:
            self._dataset.SetMetadata({name: str(value) for name, value in metadata.items()})
        for index in range(self._dataset.RasterCount):
            handle = self._dataset.GetRasterBand(index + 1)
            if nodata is not None:
                handle.SetNoDataValue(nodata)
            if index < len(descriptions):
                handle.SetDescription(descriptions[index])
            if unit:
                handle.SetUnitType(unit)

    def write(self, values: AnyArray, col: int = 0, row: int = 0, band: int = 1, keep: bool = False) -> None:
        """Write (height, width) values at a place; NaN becomes the band's nodata value. Raises WorkspaceError.

        With ``keep``, NaN does not replace values that are there already.
        """
        handle = self._dataset.GetRasterBand(band)
        nodata = handle.GetNoDataValue()
        if keep:
            before = self.read(Window(col, row, values.shape[1], values.shape[0]), band)
            values = np.where(np.isfinite(values), values, before.astype(values.dtype))
        if nodata is not None and values.dtype.kind == "f":
            values = np.where(np.isfinite(values), values, values.dtype.type(nodata))
        data = np.ascontiguousarray(values)
        _require_written(self._path, _attempt(lambda: None if handle.WriteArray(data, col, row) else True)[1])

    def read(self, window: Window, band: int = 1) -> FloatImage:
        """What was written so far, as :func:`read` gives it."""
        return read(self._dataset, window, band)

    def set_statistics(self) -> None:
        """Write the bands' statistics into the file: QGIS would compute them, and write them beside it."""
        for index in range(self._dataset.RasterCount):
            _attempt(lambda: self._dataset.GetRasterBand(index + 1).ComputeStatistics(False))  # noqa: B023 - runs now

    def set_metadata(self, tags: Mapping[str, str], domain: str = "") -> None:
        """Metadata of one of GDAL's domains, such as "RPC"."""
        self._dataset.SetMetadata(dict(tags), domain)

    def set_natural_colours(self) -> None:
        """Say that the first three bands are red, green and blue; before anything is written."""
        for band in range(self._dataset.RasterCount):
            meaning = COLOURS[band] if band < len(COLOURS) else gdal.GCI_Undefined
            self._dataset.GetRasterBand(band + 1).SetColorInterpretation(meaning)

    def flush(self) -> None:
        """Write GDAL's cache to the file, so that memory does not grow. Raises WorkspaceError."""
        _require_written(self._path, _attempt(lambda: (self._dataset.FlushCache(), True))[1])

    def close(self) -> None:
        """Close the file: only then it is complete, and can be renamed (Windows). Raises WorkspaceError."""

        _require_written(self._path, _attempt(self._release)[1])

    def abandon(self) -> None:
        """Close the file, complete or not."""
        with quiet(), suppress(RuntimeError):
            self._release()

    def _release(self) -> bool:
        """Close the dataset now, though a debugger or profiler may hold the frame of a function that had it."""
        dataset, self._dataset = self._dataset, None
        if dataset is not None and hasattr(dataset, "Close"):  # GDAL 3.8
            dataset.Close()
        elif dataset is not None:
            dataset.__swig_destroy__(dataset)
        return True


def write(
    path: str, bands: Sequence[AnyArray], geotransform: Optional[Sequence[float]], crs_wkt: str, **options: Any
) -> str:
    """Write bands (each (height, width), NaN = nodata for floats) as a GeoTIFF, with the options of :func:`created`.

    Raises WorkspaceError where the file cannot be written. Returns ``path``.
    """
    frame = RasterFrame(bands[0].shape, bands[0].dtype, len(bands), geotransform, crs_wkt)
    with created(path, frame, **options) as writer:
        for index, values in enumerate(bands, start=1):
            writer.write(values, band=index)
    return path


@dataclass(frozen=True)
class RasterFrame:
    """The arrays that a new raster holds: ``bands`` of one ``shape`` (rows, columns), and where they lie on the ground.

    ``geotransform`` None: an image in its sensor's geometry.
    """

    shape: Tuple[int, ...]
    dtype: DTypeLike
    bands: int = 1
    geotransform: Optional[Sequence[float]] = None
    crs_wkt: str = ""


@contextmanager
def created(
    path: str,
    frame: RasterFrame,
    *,
    nodata: Optional[float] = NODATA,
    descriptions: Sequence[str] = (),
    metadata: Optional[Mapping[str, object]] = None,
    unit: str = "",
    cog: bool = False,
    compress: bool = True,
    own: bool = False,
    overviews: str = "AVERAGE",
) -> Iterator[RasterWriter]:
    """A new raster to fill by window, in the format of its name's extension: it gets its name only if the block ends
    without an error. It is made as a tiled GeoTIFF.

    ``cog``: where it stays one, a cloud optimized GeoTIFF, with overviews and
    statistics, for products that people look at; it is a copy of the filled one, because windows may be filled in any
    order. ``own``: for this machine to read again; compressed in a third of the time, where its GDAL has ZSTD.
    ``overviews`` is GDAL's resampling for these; numbers that name something must not be averaged.
    """
    temporary = temporary_name(path, own)
    whole = f"{os.path.splitext(temporary)[0]}.cog{os.path.splitext(temporary)[1]}"
    writer = RasterWriter(_create(temporary, path, frame, compress=compress, own=own), path)
    try:
        writer.describe(frame.geotransform, frame.crs_wkt, nodata, descriptions, metadata or {}, unit)
        yield writer
        writer.flush()
        if cog:
            writer.set_statistics()
        writer.close()
        form = raster_format(path)
        if form.driver != GEOTIFF:
            _to_format(temporary, path, form)
            return
        if cog:
            _to_cog(temporary, whole, path, np.dtype(frame.dtype), overviews)
            os.replace(whole, temporary)
        take_name(temporary, path, own)
    finally:
        writer.abandon()
        for part in (temporary, whole, whole + ".ovr.tmp", whole + ".msk.ovr.tmp"):
            if os.path.exists(part):
                os.unlink(part)


def _to_cog(source: str, target: str, path: str, dtype: np.dtype[np.generic], overviews: str) -> None:
    """Copy a raster as a Cloud Optimized GeoTIFF, with overviews."""
    options = ["COMPRESS=DEFLATE", "LEVEL=1", f"PREDICTOR={'FLOATING_POINT' if dtype.kind == 'f' else 'STANDARD'}"]
    options += ["OVERVIEWS=IGNORE_EXISTING", f"RESAMPLING={overviews}", "BLOCKSIZE=256", "BIGTIFF=IF_SAFER"]
    with opened(source) as dataset:

        def copy() -> Optional[bool]:
            made = gdal.GetDriverByName("COG").CreateCopy(target, dataset, options=options)
            return None if made is None else True  # the file is closed here

        _require_written(path, _attempt(copy)[1])


def _to_format(source: str, path: str, form: Format) -> None:
    """Copy a raster into another format, with the files that belong to it; all get their names when they are complete.

    Raises WorkspaceError, also where the format does not keep what the raster is: its cells, its place and its datum.
    """
    with temporary_folder(path) as folder, opened(source) as dataset:
        target = os.path.join(folder, os.path.basename(path))

        def copy() -> Optional[bool]:
            made = gdal.GetDriverByName(form.driver).CreateCopy(target, dataset, options=list(form.options))
            return None if made is None else True  # the file is closed here

        _require_written(path, _attempt(copy)[1])
        for name in sorted(os.listdir(folder), key=lambda each: each == os.path.basename(path)):  # itself last
            take_name(os.path.join(folder, name), os.path.join(os.path.dirname(path), name))


def _create(temporary: str, path: str, frame: RasterFrame, *, compress: bool, own: bool) -> gdal.Dataset:
    dtype = np.dtype(frame.dtype)
    kinds = {"float32": gdal.GDT_Float32, "float64": gdal.GDT_Float64}
    kinds.update({"uint8": gdal.GDT_Byte, "uint16": gdal.GDT_UInt16, "int32": gdal.GDT_Int32})
    options = ["TILED=YES", "BIGTIFF=IF_SAFER"]
    if compress and own and "ZSTD" in gdal.GetDriverByName("GTiff").GetMetadataItem("DMD_CREATIONOPTIONLIST"):
        options += ["COMPRESS=ZSTD", "ZSTD_LEVEL=1"]
    elif compress:
        options += ["COMPRESS=DEFLATE", "ZLEVEL=1", f"PREDICTOR={3 if dtype.kind == 'f' else 2}"]
    size = (frame.shape[1], frame.shape[0], frame.bands, kinds[dtype.name])
    dataset, reason = _attempt(lambda: gdal.GetDriverByName("GTiff").Create(temporary, *size, options))
    if dataset is None:
        raise not_written(path, reason)
    return dataset


def colour_interpretations(dataset: gdal.Dataset) -> List[int]:
    """Each band's colour interpretation, in order."""
    return [dataset.GetRasterBand(i).GetColorInterpretation() for i in range(1, dataset.RasterCount + 1)]


def grey_band(dataset: gdal.Dataset) -> int:
    """The band to match on: 0 (grey of red, green and blue) for a colour image, else the first that has intensities.

    Alpha and palette bands have none.
    """
    meanings = colour_interpretations(dataset)
    if all(colour in meanings for colour in COLOURS):
        return 0
    for band, meaning in enumerate(meanings, start=1):
        if meaning not in (gdal.GCI_AlphaBand, gdal.GCI_PaletteIndex):
            return band
    return 1


def name_of(path: str) -> str:
    """An image's short name: that of its file, without the extension."""
    return Path(path).stem


def raster_identity(path: str) -> List[List[object]]:
    """What distinguishes a raster from a changed one: the identities of all files that GDAL says belong to it.

    Masks, overviews, RPC files beside it, and the images behind a VRT are among them.
    """
    return [file_identity(file) for file in files_of(path)]


_NO_PIXELS = (".aux.xml", ".ovr", ".txt", ".rpb", ".rpc", ".imd", ".geom", ".json", ".qml")


def content_of(path: str) -> str:
    """A digest that distinguishes a raster's pixels from those of another raster that replaced it under the same name
    (:func:`.workspace.file_sample`), wherever the files lie; "" for one that is not on a disk.

    Statistics and overviews that programs add later do not count, nor do metadata.
    """
    if not os.path.isfile(path):
        return ""
    files = [file for file in files_of(path) if file == path or not file.lower().endswith(_NO_PIXELS)]
    parts = [file_sample(file) for file in files if os.path.isfile(file)]
    return hashlib.sha256(" ".join(sorted(parts)).encode()).hexdigest()[:24]


def files_of(path: str) -> List[str]:
    """All files that GDAL says belong to a raster, in their order; of one that it cannot open, the path alone."""
    try:
        with opened(path) as dataset:
            files = _attempt(dataset.GetFileList)[0]
            if files is None:  # where GDAL raises exceptions: for a damaged sidecar file, when it first reads it
                files = _attempt(dataset.GetFileList)[0]
    except ImageError:
        files = []
    return sorted({path, *(files or [])})
