"""What an image says of its ground sampling distance, and that a contradiction with its RPC is refused."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal, osr

from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.imagery.spacing import stated_spacings
from repm_qgis.scene import load_view


def image(path, transform=None, epsg=None, **items):
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), 200, 100, 1, gdal.GDT_UInt16)
    if transform:
        dataset.SetGeoTransform(transform)
    if epsg:
        reference = osr.SpatialReference()
        reference.ImportFromEPSG(epsg)
        dataset.SetProjection(reference.ExportToWkt())
    dataset.SetMetadata(items)
    dataset = None  # noqa: F841
    return gdal.Open(str(path))


DEGREE_M = 111320.0


@pytest.mark.parametrize(
    "transform, epsg, items, metres",
    (
        (None, None, {}, []),
        (None, None, {"GSD": "0.5"}, [0.5]),
        (None, None, {"gsd": "0.5 m"}, [0.5]),
        (None, None, {"NITF_USE00A_MEAN_GSD": "019.7"}, [0.5004]),
        (None, None, {"GSD": "half a metre"}, []),
        (None, None, {"GSD": "0"}, []),
        ((500000.0, 0.5, 0.0, 4800000.0, 0.0, -0.5), 32631, {}, [0.5]),
        ((500000.0, 0.3, 0.4, 4800000.0, 0.4, -0.3), 32631, {}, [0.5]),  # turned
        ((1.44, 0.5 / DEGREE_M / 0.724, 0.0, 43.6, 0.0, -0.5 / DEGREE_M), 4326, {}, [0.5]),
        ((200.0, 2.0, 0.0, 100.0, 0.0, 2.0), None, {}, []),  # pixels of another image, and no metres
        ((0.0, 1.0, 0.0, 0.0, 0.0, -1.0), 32631, {}, []),  # none was set
    ),
)
def test_what_is_said(tmp_path, transform, epsg, items, metres):
    found = [spacing for spacing, _ in stated_spacings(image(tmp_path / "a.tif", transform, epsg, **items))]
    assert found == pytest.approx(metres, rel=0.005)


def test_a_spacing_that_contradicts_the_rpc_is_refused_with_both_numbers(tmp_path, write_image, synthetic_rpc):
    path = write_image(tmp_path / "a.tif", np.ones((100, 100), np.uint16), synthetic_rpc())
    plain = load_view(path).gsd_m
    for factor, agrees in ((1.0, True), (1.25, True), (0.8, True), (1.35, False), (0.74, False), (2.0, False)):
        dataset = gdal.Open(path, gdal.GA_Update)
        dataset.SetMetadataItem("GSD", f"{factor * plain:.6f}")
        dataset = None
        if agrees:
            assert load_view(path).gsd_m == plain
            continue
        with pytest.raises(RpcInvalidError) as caught:
            load_view(path)
        for words in (path, f"{plain:.3g} m on the ground", f"item GSD says {factor * plain:.3g} m"):
            assert words in str(caught.value)
