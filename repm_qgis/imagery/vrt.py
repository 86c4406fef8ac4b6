"""GDAL's virtual rasters: a text that shows many files as one, or a file with other facts about it."""

from __future__ import annotations

import html
import os
from dataclasses import dataclass
from typing import Iterator, Mapping, Sequence, Tuple

from osgeo import gdal

from ..contracts.arrays import Size, Window
from ..contracts.paths import real_path
from .raster import NODATA


@dataclass(frozen=True)
class Mosaicked:
    """What a VRT of float32 bands shows: ``tiles`` are files with the windows that they fill, ``overview`` is one file
    with all of it in larger cells, and the others are the facts that :func:`~.raster.created` takes of a raster."""

    size: Size
    geotransform: Sequence[float]
    crs_wkt: str
    descriptions: Sequence[str]
    metadata: Mapping[str, object]
    unit: str
    tiles: Sequence[Tuple[str, Window]]
    overview: str


def vrt_text(shown: Mosaicked, folder: str) -> str:
    """The text of a VRT that lies in ``folder``; it names its files from there, so that all can be moved together."""
    return "\n".join(_lines(shown, folder)) + "\n"


def _lines(shown: Mosaicked, folder: str) -> Iterator[str]:
    yield f'<VRTDataset rasterXSize="{shown.size[0]}" rasterYSize="{shown.size[1]}">'
    yield f'<SRS dataAxisToSRSAxisMapping="1,2">{html.escape(shown.crs_wkt)}</SRS>'
    yield f"<GeoTransform>{', '.join(repr(float(value)) for value in shown.geotransform)}</GeoTransform>"
    yield "<Metadata>"
    for name, value in shown.metadata.items():
        yield f'<MDI key="{html.escape(name)}">{html.escape(str(value))}</MDI>'
    yield "</Metadata>"
    for band, description in enumerate(shown.descriptions, start=1):
        yield f'<VRTRasterBand dataType="Float32" band="{band}" blockXSize="256" blockYSize="256">'
        yield f"<Description>{html.escape(description)}</Description>"
        if shown.unit:
            yield f"<UnitType>{html.escape(shown.unit)}</UnitType>"
        yield f"<NoDataValue>{NODATA}</NoDataValue>"
        yield f"<Overview>{_source(shown.overview, folder, band)}</Overview>"
        for path, (col, row, width, height) in shown.tiles:
            size = f'xSize="{width}" ySize="{height}"'
            yield f"<SimpleSource>{_source(path, folder, band)}"
            yield (
                f'<SourceProperties RasterXSize="{width}" RasterYSize="{height}" DataType="Float32" '
                'BlockXSize="256" BlockYSize="256"/>'
            )
            yield f'<SrcRect xOff="0" yOff="0" {size}/><DstRect xOff="{col}" yOff="{row}" {size}/></SimpleSource>'
        yield "</VRTRasterBand>"
    yield "</VRTDataset>"


def image_vrt_text(image: gdal.Dataset, path: str, folder: str, metadata: Mapping[str, Mapping[str, str]]) -> str:
    """The text of a VRT that lies in ``folder`` and has an image's pixels and mask, but no georeferencing of its own.

    ``image`` is the opened image with that ``path``; ``metadata`` has the items of each domain. Pixels stay in the
    image's file, which the VRT names from its folder where that is possible.
    """
    return "\n".join(_image_lines(image, path, folder, metadata)) + "\n"


def _image_lines(
    image: gdal.Dataset, path: str, folder: str, metadata: Mapping[str, Mapping[str, str]]
) -> Iterator[str]:
    name, relative = _name_from(path, folder)
    size = f'xSize="{image.RasterXSize}" ySize="{image.RasterYSize}"'
    rectangles = f'<SrcRect xOff="0" yOff="0" {size}/><DstRect xOff="0" yOff="0" {size}/>'
    yield f'<VRTDataset rasterXSize="{image.RasterXSize}" rasterYSize="{image.RasterYSize}">'
    for domain, items in metadata.items():
        yield f'<Metadata domain="{html.escape(domain)}">'
        for key, value in items.items():
            yield f'<MDI key="{html.escape(key)}">{html.escape(value)}</MDI>'
        yield "</Metadata>"
    for number in range(1, image.RasterCount + 1):
        band = image.GetRasterBand(number)
        yield f'<VRTRasterBand dataType="{gdal.GetDataTypeName(band.DataType)}" band="{number}">'
        yield f"<ColorInterp>{gdal.GetColorInterpretationName(band.GetColorInterpretation())}</ColorInterp>"
        if band.GetNoDataValue() is not None:
            yield f"<NoDataValue>{band.GetNoDataValue():.17g}</NoDataValue>"
        yield f"<SimpleSource>{_named(name, relative, number)}{rectangles}</SimpleSource>"
        yield "</VRTRasterBand>"
    flags = image.GetRasterBand(1).GetMaskFlags()
    if flags & gdal.GMF_PER_DATASET and not flags & gdal.GMF_ALPHA:
        yield '<MaskBand><VRTRasterBand dataType="Byte">'
        yield f"<SimpleSource>{_named(name, relative, 'mask,1')}{rectangles}</SimpleSource>"
        yield "</VRTRasterBand></MaskBand>"
    yield "</VRTDataset>"


def _source(path: str, folder: str, band: int) -> str:
    return _named(os.path.relpath(path, folder).replace(os.sep, "/"), True, band)


def _named(name: str, relative: bool, band: int | str) -> str:
    source = f'<SourceFilename relativeToVRT="{int(relative)}">{html.escape(name)}</SourceFilename>'
    return f"{source}<SourceBand>{band}</SourceBand>"


def _name_from(path: str, folder: str) -> Tuple[str, bool]:
    """An image's name for a VRT in a folder, and whether it is one from there: files on other drives, and those that
    are on no disk, have none.

    Links are followed up to the image's folder, as the system follows them when the VRT is read; not that of the image,
    beside which its mask may lie.
    """
    if not os.path.exists(path):
        return path, False
    place = os.path.join(real_path(os.path.dirname(os.path.abspath(path))), os.path.basename(path))
    try:
        return os.path.relpath(place, real_path(folder)).replace(os.sep, "/"), True
    except ValueError:
        return place, False
