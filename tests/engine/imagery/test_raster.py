"""Reading and writing rasters: values, nodata, damaged files, and files that are whole or absent."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Window
from repm_qgis.contracts.errors import ImageError, WorkspaceError
from repm_qgis.imagery.raster import RasterFrame, created, files_of, grey_band, name_of, opened, read, write

ROOT = Path(__file__).resolve().parents[3]
WKT = (
    'PROJCS["WGS 84 / UTM zone 31N",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",3],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1],AUTHORITY["EPSG","32631"]]'
)
TRANSFORM = (500000.0, 0.5, 0.0, 4800000.0, 0.0, -0.5)


def heights(rows=300, columns=200):
    values = np.random.default_rng(4).normal(200, 30, (rows, columns)).astype(np.float32)
    values[50:60, 20:90] = np.nan
    return values


def test_what_is_written_is_read(tmp_path):
    path, values = str(tmp_path / "a.tif"), heights()
    assert (
        write(
            path, [values, values + 1], TRANSFORM, WKT, descriptions=("height", "other"), unit="m", metadata={"NOTE": 5}
        )
        == path
    )
    with opened(path) as dataset:
        np.testing.assert_array_equal(read(dataset), values)
        np.testing.assert_array_equal(read(dataset, (10, 40, 30, 25), 2), values[40:65, 10:40] + 1)
    dataset = gdal.Open(path)  # GDAL alone
    assert dataset.GetGeoTransform() == TRANSFORM and "32631" in dataset.GetProjection()
    band = dataset.GetRasterBand(1)
    assert band.GetNoDataValue() == -9999 and band.GetDescription() == "height" and band.GetUnitType() == "m"
    assert (band.ReadAsArray()[50:60, 20:90] == -9999).all() and dataset.GetMetadataItem("NOTE") == "5"
    assert band.GetBlockSize() == [256, 256]
    dataset = band = None
    assert os.listdir(tmp_path) == ["a.tif"]


@pytest.mark.parametrize("own", (False, True))
def test_both_compressions_keep_every_bit(tmp_path, own):
    values = np.random.default_rng(1).normal(size=(70, 300)).astype(np.float32)
    path = write(str(tmp_path / "a.tif"), [values], None, "", own=own)
    with opened(path) as dataset:
        np.testing.assert_array_equal(read(dataset), values)


def test_overviews_leave_nodata_out(tmp_path):
    path, values = str(tmp_path / "a.tif"), heights(1200, 900)
    write(path, [values], TRANSFORM, WKT, cog=True)
    dataset = gdal.Open(path)
    first = dataset.GetRasterBand(1).GetOverview(0)
    assert (first.XSize, first.YSize) == (450, 600) and dataset.GetRasterBand(1).GetOverviewCount() >= 2
    small = first.ReadAsArray()
    dataset = first = None
    expected = values[200:, 200:].reshape(500, 2, 350, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(small[100:, 100:], expected, atol=1e-3)
    assert set(np.unique(small[small < 0])) == {-9999.0}


@pytest.mark.parametrize("shape, dtype", (((1200, 900), "float32"), ((300, 300), "float32"), ((1100, 1300), "uint8")))
def test_products_pass_gdals_own_cog_validation(tmp_path, shape, dtype):
    from osgeo_utils.samples.validate_cloud_optimized_geotiff import validate

    path, values = str(tmp_path / "a.tif"), heights(*shape)
    values = values if dtype == "float32" else np.nan_to_num(values, nan=0).astype(np.uint8)
    with created(
        path,
        RasterFrame(shape, dtype, 2, TRANSFORM, WKT),
        nodata=-9999.0 if dtype == "float32" else 0,
        descriptions=("first", "second"),
        unit="m",
        metadata={"NOTE": 5},
        cog=True,
    ) as writer:
        for row in range(0, shape[0], 256):  # by windows, as tiles come
            for band in (1, 2):
                writer.write(values[row : row + 256], 0, row, band)
    warnings, errors, _ = validate(path, full_check=True)
    assert not errors and not warnings
    with opened(path) as dataset:
        np.testing.assert_array_equal(
            read(dataset, band=2)[250:260],
            np.where(values == 0, np.nan, values)[250:260] if dtype == "uint8" else values[250:260],
        )
        band = dataset.GetRasterBand(2)
        assert (band.GetDescription(), band.GetUnitType()) == ("second", "m")
        assert dataset.GetMetadataItem("NOTE") == "5" and dataset.GetMetadataItem("COMPRESSION", "IMAGE_STRUCTURE")
    assert os.listdir(tmp_path) == ["a.tif"]


@pytest.mark.parametrize(
    "dtype, nodata",
    (
        ("uint8", 0),
        ("uint16", 65535),
        ("float32", -32768.0),
        ("float32", float("nan")),
        ("float32", -3.4028234663852886e38),
    ),
)
def test_nodata_of_any_kind_becomes_nan(tmp_path, write_image, dtype, nodata):
    values = np.random.default_rng(0).integers(1, 200, (90, 80)).astype(dtype)
    values[3, 4] = nodata
    path = write_image(tmp_path / "a.tif", values, nodata=nodata)
    with opened(path) as dataset:
        found = read(dataset)
    assert np.isnan(found[3, 4]) and np.isnan(found).sum() == 1
    assert found.dtype == np.float32 and (found[0] == values[0]).all()


def test_infinite_values_become_nan(tmp_path, write_image):
    values = np.ones((80, 80), dtype=np.float32)
    values[1, 1], values[2, 2] = np.inf, -np.inf
    with opened(write_image(tmp_path / "a.tif", values)) as dataset:
        assert np.argwhere(np.isnan(read(dataset))).tolist() == [[1, 1], [2, 2]]


def test_decimated_reading_averages_what_is_known(tmp_path, write_image):
    values = np.random.default_rng(0).integers(1, 4000, (160, 240)).astype(np.uint16)
    values[:4, :4] = 0
    values[10, 10] = 0
    with opened(write_image(tmp_path / "a.tif", values, nodata=0)) as dataset:
        found = read(dataset, (0, 0, 240, 160), 1, (60, 40))
    assert np.isnan(found[0, 0])
    block = values[8:12, 8:12].astype(float)
    assert found[2, 2] == pytest.approx(block[block > 0].mean(), abs=0.6)
    np.testing.assert_allclose(found[10:], values.reshape(40, 4, 60, 4).mean(axis=(1, 3))[10:], atol=0.6)


@pytest.mark.parametrize("compress", (False, True))
def test_truncated_files_are_image_errors(tmp_path, compress):
    path = tmp_path / "cut.tif"
    write(str(path), [heights(900, 900)], TRANSFORM, WKT, compress=compress)
    path.write_bytes(path.read_bytes()[: len(path.read_bytes()) // 2])
    with pytest.raises(ImageError) as caught, opened(str(path)) as dataset:
        read(dataset)
    assert str(path) in str(caught.value)
    assert "get it again" in str(caught.value) or "get the file again" in str(caught.value)


def test_what_is_no_raster(tmp_path):
    text = tmp_path / "a.tif"
    text.write_text("not a raster")
    for path, words in (
        (str(text), "Cannot open the raster"),
        (str(tmp_path / "gone.tif"), "it does not exist"),
        (str(tmp_path), "Cannot open"),
    ):
        with pytest.raises(ImageError) as caught, opened(path):
            pass
        assert path in str(caught.value) and words in str(caught.value)


def test_gdals_global_state_is_left_alone(tmp_path):
    before = gdal.GetUseExceptions()
    for use in (gdal.UseExceptions, gdal.DontUseExceptions):
        use()
        with pytest.raises(ImageError), opened(str(tmp_path / "gone.tif")):
            pass
        write(str(tmp_path / "a.tif"), [heights()], TRANSFORM, WKT)
        with pytest.raises(WorkspaceError):
            write("/proc/nowhere/a.tif", [heights()], TRANSFORM, WKT)
    (gdal.UseExceptions if before else gdal.DontUseExceptions)()


def test_an_exception_leaves_nothing(tmp_path):
    path = str(tmp_path / "a.tif")
    with pytest.raises(KeyError), created(path, RasterFrame((100, 100), "float32", 1, TRANSFORM, WKT)) as writer:
        writer.write(np.ones((50, 100), np.float32))
        raise KeyError
    assert os.listdir(tmp_path) == []


def test_an_exception_leaves_what_was_there_before(tmp_path):
    path = str(tmp_path / "a.tif")
    write(path, [np.full((60, 60), 7, np.float32)], TRANSFORM, WKT)
    with pytest.raises(KeyError), created(path, RasterFrame((100, 100), "float32", 1, TRANSFORM, WKT)) as writer:
        writer.write(np.ones((50, 100), np.float32))
        raise KeyError
    with opened(path) as dataset:
        assert (read(dataset) == 7).all()
    assert os.listdir(tmp_path) == ["a.tif"]


def test_the_name_appears_only_at_the_end(tmp_path):
    path = tmp_path / "new" / "folder" / "a.tif"
    with created(str(path), RasterFrame((100, 100), "uint8"), nodata=0) as writer:
        writer.write(np.ones((100, 100), np.uint8))
        assert not path.exists()
    assert os.listdir(path.parent) == ["a.tif"]


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.tif").mkdir()
    places = [str(tmp_path / "file" / "a.tif"), str(tmp_path / "folder.tif")]
    for path in places if os.name == "nt" else [*places, "/proc/nowhere/a.tif"]:
        with pytest.raises(WorkspaceError) as caught:
            write(path, [heights()], TRANSFORM, WKT)
        assert os.path.dirname(path) in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.tif"]


def test_a_file_is_whole_though_somebody_holds_its_dataset(tmp_path):
    """As a debugger or profiler does, with the frame of a function that had it."""
    path, values = str(tmp_path / "a.tif"), np.arange(300 * 300, dtype=np.float32).reshape(300, 300)
    with created(path, RasterFrame(values.shape, values.dtype), compress=False) as writer:
        held = writer._dataset
        writer.write(values[:150])
        writer.write(values[150:], row=150)
    with opened(path) as dataset:
        assert np.array_equal(read(dataset), values)
    assert held is not None


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of the file size")
@pytest.mark.parametrize("where", ("during", "at the end"))
def test_a_full_disk_is_an_error_and_leaves_nothing(tmp_path, where):
    """A limit of the file size stands for the full disk. GDAL writes at the end what fits into its cache."""
    rows = 3000 if where == "during" else 600
    code = f"""
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (400000, 400000))
import numpy as np
from osgeo import gdal
gdal.SetCacheMax({8 << 20 if where == "during" else 64 << 20})
from repm_qgis.contracts.errors import WorkspaceError
from repm_qgis.imagery.raster import write
try:
    write({str(tmp_path / "a.tif")!r}, [np.random.default_rng(0).normal(0, 1, ({rows}, 3000)).astype("float32")],
          None, "")
except WorkspaceError as error:
    sys.stdout.write(str(error))
    sys.exit(1)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, check=False
    )
    assert done.returncode == 1, done.stderr
    assert "a.tif" in done.stdout
    assert os.listdir(tmp_path) == []


def test_the_band_to_match_on(tmp_path):
    dataset = gdal.GetDriverByName("GTiff").Create(str(tmp_path / "a.tif"), 70, 70, 2)
    dataset.GetRasterBand(1).SetColorInterpretation(gdal.GCI_AlphaBand)
    dataset.GetRasterBand(2).SetColorInterpretation(gdal.GCI_GrayIndex)
    assert grey_band(dataset) == 2
    dataset = None
    assert name_of("/a/b/IMG_1.x.TIF") == "IMG_1.x"


@pytest.mark.parametrize("raises", (True, False))
def test_the_files_of_an_image_whose_rpc_file_is_damaged(tmp_path, raises):
    """Whether GDAL raises exceptions is for QGIS and its plugins to say."""
    path, sidecar, mask = (str(tmp_path / name) for name in ("a.tif", "a_RPC.TXT", "a.tif.msk"))
    write(path, [np.ones((64, 64), np.float32)], None, "")
    write(mask, [np.ones((64, 64), np.uint8)], None, "", nodata=None)
    Path(sidecar).write_text("LINE_OFF: 1\n")
    before = gdal.GetUseExceptions()
    (gdal.UseExceptions if raises else gdal.DontUseExceptions)()
    try:
        assert files_of(path) == sorted([path, sidecar, mask])
    finally:
        (gdal.UseExceptions if before else gdal.DontUseExceptions)()


@pytest.mark.parametrize("kind", ("overviews", "JPEG 2000"))
def test_without_overviews_a_reduced_reading_is_the_mean_of_the_pixels(tmp_path, kind):
    values = np.random.default_rng(1).integers(10, 2000, (1024, 1024)).astype(np.uint16)
    plain = write(str(tmp_path / "a.tif"), [values], None, "", nodata=None)
    path = str(tmp_path / ("b.tif" if kind == "overviews" else "b.jp2"))
    driver = gdal.GetDriverByName("GTiff" if kind == "overviews" else "JP2OpenJPEG")
    if driver is None:
        pytest.skip("this GDAL has no JP2OpenJPEG")
    driver.CreateCopy(path, gdal.Open(plain), options=["QUALITY=100", "REVERSIBLE=YES"] if kind != "overviews" else [])
    if kind == "overviews":
        gdal.Open(path).BuildOverviews("NEAREST", [2, 4, 8])
    window, size = Window(64, 32, 800, 640), (100, 80)
    with opened(plain) as dataset:
        means = read(dataset, window, 1, size)
    with opened(path, overviews=False) as dataset:
        np.testing.assert_array_equal(read(dataset, window, 1, size), means)
    with opened(path) as dataset:
        assert np.abs(read(dataset, window, 1, size) - means).max() > 100


def test_the_grey_of_equal_colours_is_exact(tmp_path):
    values = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    path = str(tmp_path / "a.tif")
    made = gdal.GetDriverByName("GTiff").Create(path, 256, 256, 3, gdal.GDT_UInt16, ["PHOTOMETRIC=RGB"])
    for number in (1, 2, 3):
        made.GetRasterBand(number).WriteArray(values)
    made = None
    with opened(path) as dataset:
        np.testing.assert_array_equal(read(dataset, None, 0), values.astype(np.float32))


@pytest.mark.parametrize("kind", ("CInt16", "CFloat32"))
def test_complex_pixels_are_refused_at_once(tmp_path, kind):
    path = str(tmp_path / "radar.tif")
    gdal.GetDriverByName("GTiff").Create(path, 64, 64, 1, gdal.GetDataTypeByName(kind))
    with pytest.raises(ImageError, match=f"radar.tif' has complex pixels .{kind}., as radar images have"), opened(path):
        pass
