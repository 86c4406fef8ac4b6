"""Files that come with data: pipes, and VRTs that reach for the network, are refused before anything waits."""

from __future__ import annotations

import os

import pytest

from repm_qgis.errors import ImageError
from repm_qgis.imagery.raster import opened, raster_identity

VRT = (
    '<VRTDataset rasterXSize="100" rasterYSize="80"><VRTRasterBand dataType="UInt16" band="1"><SimpleSource>'
    '<SourceFilename relativeToVRT="{relative}">{source}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>'
    "</VRTRasterBand></VRTDataset>"
)


def vrt(path, source, relative=1):
    path.write_text(VRT.format(source=source, relative=relative))
    return str(path)


def test_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.tif")
    with pytest.raises(ImageError, match="pipe.tif' is a pipe or a device"), opened(str(tmp_path / "pipe.tif")):
        pass


@pytest.mark.parametrize("source", ("/vsicurl/http://127.0.0.1/a.tif", "/vsis3/bucket/a.tif", "https://127.0.0.1/a"))
@pytest.mark.parametrize("nested", (False, True))
def test_a_vrt_may_not_reach_for_the_network(tmp_path, source, nested):
    path = vrt(tmp_path / "a.vrt", source, 0)
    if nested:
        path = vrt(tmp_path / "outer.vrt", "a.vrt")
    with pytest.raises(ImageError, match=r"\.vrt' is a VRT that names the network source"), opened(path):
        pass


def test_local_vrts_work_and_circles_end(tmp_path, write_image):
    write_image(tmp_path / "a.tif")
    with opened(vrt(tmp_path / "inner.vrt", "a.tif")), opened(vrt(tmp_path / "outer.vrt", "inner.vrt")) as dataset:
        assert (dataset.RasterXSize, dataset.RasterYSize) == (100, 80)
    vrt(tmp_path / "inner.vrt", "outer.vrt")
    with opened(str(tmp_path / "outer.vrt")) as dataset:  # reading it is GDAL's affair, which says what is wrong
        assert dataset.RasterCount == 1


def test_the_identity_knows_masks_and_the_images_behind_a_vrt(tmp_path, write_image):
    image = write_image(tmp_path / "a.tif")
    outer = vrt(tmp_path / "a.vrt", "a.tif")
    first, behind = raster_identity(image), raster_identity(outer)
    assert raster_identity(image) == first and len(behind) == 2
    write_image(tmp_path / "a.tif.msk")
    assert raster_identity(image) != first
    status = os.stat(image)
    with open(image, "r+b") as stream:
        stream.seek(status.st_size - 2)
        stream.write(b"xx")
    os.utime(image, ns=(status.st_atime_ns, status.st_mtime_ns))  # as cp -p and rsync -t do
    assert raster_identity(outer) != behind
