"""GDAL's virtual rasters: a text that shows many files as one."""

from __future__ import annotations

import html
import os
from dataclasses import dataclass
from typing import Iterator, Mapping, Sequence, Tuple

from ..arrays import Size, Window
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


def _source(path: str, folder: str, band: int) -> str:
    name = os.path.relpath(path, folder).replace(os.sep, "/")
    return f'<SourceFilename relativeToVRT="1">{html.escape(name)}</SourceFilename><SourceBand>{band}</SourceBand>'
