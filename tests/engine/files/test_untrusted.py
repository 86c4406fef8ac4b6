"""Files that come with data: pipes, and VRTs that reach for the network, are refused before anything waits."""

from __future__ import annotations

import http.server
import os
import threading
import time
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import ImageError, InputTableError, SceneError
from repm_qgis.files import untrusted
from repm_qgis.files.untrusted import refusal_of
from repm_qgis.files.vector import open_vector
from repm_qgis.imagery.raster import opened, opened_image, raster_identity, read
from repm_qgis.pointing import ground_control
from repm_qgis.pointing.ground_control import read_gcps
from repm_qgis.scene import Scene, load_views

VRT = (
    '<VRTDataset rasterXSize="100" rasterYSize="80"><VRTRasterBand dataType="UInt16" band="1"><SimpleSource>'
    '<SourceFilename relativeToVRT="{relative}">{source}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>'
    "</VRTRasterBand></VRTDataset>"
)
pipes = pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes with names in folders")


def vrt(path, source, relative=1):
    path.write_text(VRT.format(source=source, relative=relative))
    return str(path)


@pipes
def test_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.tif")
    with pytest.raises(ImageError, match="pipe.tif' is a pipe or a device"), opened(str(tmp_path / "pipe.tif")):
        pass


@pipes
@pytest.mark.parametrize(
    "beside", ("{0}.tif.aux.xml", "{0}.tif.ovr", "{0}.tif.msk", "{0}.IMD", "{0}_RPC.TXT", "DIM_a.XML")
)
@pytest.mark.parametrize("behind_a_vrt", (False, True))
def test_a_pipe_beside_an_image_is_refused_at_once(tmp_path, write_image, beside, behind_a_vrt):
    write_image(tmp_path / "IMG_a_R1C1.tif")
    beside = beside.format("IMG_a_R1C1")
    os.mkfifo(tmp_path / beside)
    path = str(tmp_path / "IMG_a_R1C1.tif")
    if behind_a_vrt:
        (tmp_path / "v").mkdir()
        path = vrt(tmp_path / "v" / "outer.vrt", "../IMG_a_R1C1.tif")
    with pytest.raises(ImageError, match=f"has the pipe or device '{beside}' beside it: remove that"), opened(path):
        pass


@pipes
def test_a_pipe_of_another_name_keeps_nobody_from_an_image(tmp_path, write_image):
    write_image(tmp_path / "IMG_a_R1C1.tif")
    os.mkfifo(tmp_path / "other")
    with opened(str(tmp_path / "IMG_a_R1C1.tif")) as dataset:
        assert dataset.RasterYSize > 0


@pipes
def test_a_pipe_as_the_source_of_a_vrt_or_as_a_scene_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ImageError, match="leads to 'pipe', which is a pipe or a device"):
        with opened(vrt(tmp_path / "a.vrt", "pipe")):
            pass
    with pytest.raises(SceneError, match="pipe' is a pipe or a device, not a file"):
        Scene.load(str(tmp_path / "pipe"))


def test_vrts_that_fan_out_are_refused_at_once(tmp_path, write_image):
    """Seven small files, of which each names the next one ten times: GDAL would open ten million."""
    write_image(tmp_path / "7.vrt.tif")
    os.replace(tmp_path / "7.vrt.tif", tmp_path / "7.vrt")
    for number in range(7):
        source = f'<SimpleSource><SourceFilename relativeToVRT="1">{number + 1}.vrt</SourceFilename></SimpleSource>'
        (tmp_path / f"{number}.vrt").write_text(
            whole(f'<VRTRasterBand dataType="UInt16" band="1">{10 * source}</VRTRasterBand>')
        )
    start = time.monotonic()
    with pytest.raises(ImageError, match="0.vrt' makes GDAL open more than 1000000 files"):
        with opened(str(tmp_path / "0.vrt")):
            pass
    assert time.monotonic() - start < 2.0
    with opened(str(tmp_path / "4.vrt")) as dataset:  # a thousand
        assert dataset.RasterXSize == 100


def test_vrts_of_very_many_files_are_refused(tmp_path, write_image, monkeypatch):
    monkeypatch.setattr("repm_qgis.files.untrusted._MOST_FILES", 15)
    parts = []
    for number in range(20):
        write_image(tmp_path / f"{number}.tif")
        parts.append(f"<SimpleSource><SourceFilename relativeToVRT='1'>{number}.tif</SourceFilename></SimpleSource>")
    for count, refused in ((10, False), (20, True)):
        band = f'<VRTRasterBand dataType="UInt16" band="1">{"".join(parts[:count])}</VRTRasterBand>'
        (tmp_path / f"m{count}.vrt").write_text(whole(band))
        said = refusal_of(str(tmp_path / f"m{count}.vrt"))
        assert said.startswith("leads to more than 15 files") if refused else said == ""


@pytest.mark.parametrize("source", ("/vsicurl/http://127.0.0.1/a.tif", "/vsis3/bucket/a.tif", "https://127.0.0.1/a"))
@pytest.mark.parametrize("nested", (False, True))
def test_a_vrt_may_not_reach_for_the_network(tmp_path, source, nested):
    path = vrt(tmp_path / "a.vrt", source, 0)
    if nested:
        path = vrt(tmp_path / "outer.vrt", "a.vrt")
    with pytest.raises(ImageError, match=r"\.vrt' leads to the network source"), opened(path):
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


# --- what files that came with data reach for -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def server():
    """An HTTP server of this machine: its address, and what was asked of it."""
    asked = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_error(404)

        def do_HEAD(self):
            self.do_GET()

        def log_message(self, *_):
            pass

    listening = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=listening.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{listening.server_port}/x.tif", asked
    listening.shutdown()
    listening.server_close()


def whole(body, attributes=""):
    return f'<VRTDataset rasterXSize="100" rasterYSize="80"{attributes}>{body}</VRTDataset>'


def band(source, before="", attributes=""):
    name = f'<SourceFilename relativeToVRT="0">{source}</SourceFilename><SourceBand>1</SourceBand>'
    return (
        f'<VRTRasterBand dataType="UInt16" band="1"{attributes}>{before}<SimpleSource>{name}</SimpleSource>'
        "</VRTRasterBand>"
    )


WMS = (
    '<GDAL_WMS><Service name="TMS"><ServerUrl>{url}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service><DataWindow>'
    "<UpperLeftX>-2e7</UpperLeftX><UpperLeftY>2e7</UpperLeftY><LowerRightX>2e7</LowerRightX><LowerRightY>-2e7"
    "</LowerRightY><TileLevel>2</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY></DataWindow>"
    "<Projection>EPSG:3857</Projection><BandsCount>1</BandsCount></GDAL_WMS>"
)
STAC = (
    '{{"type": "FeatureCollection", "stac_version": "1.0.0", "features": [{{"type": "Feature", "stac_version": "1.0.0",'
    '"properties": {{"proj:epsg": 32631, "proj:transform": [1, 0, 0, 0, -1, 0], "proj:shape": [9, 9]}},'
    '"assets": {{"a": {{"href": "{url}"}}}}}}]}}'
)
PYTHON = "<PixelFunctionType>f</PixelFunctionType><PixelFunctionLanguage>Python</PixelFunctionLanguage>"
OVERVIEW = "<Overview><SourceFilename>/vsicurl/{url}</SourceFilename><SourceBand>1</SourceBand></Overview>"
WARPED = "<GDALWarpOptions><SourceDataset>/vsicurl/{url}</SourceDataset></GDALWarpOptions>"
AUX = '<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">/vsicurl/{url}</MDI></Metadata></PAMDataset>'
NETWORK = band("/vsicurl/{url}")
# What is opened, and the text files beside the image "a.tif" that take part.
ATTACKS = {
    "entities": ("x.vrt", {"x.vrt": whole(band("&#47;vsi&#99;url/{url}"))}),
    "cdata": ("x.vrt", {"x.vrt": whole(band("<![CDATA[/vsi]]><![CDATA[curl/{url}]]>"))}),
    "comment": ("x.vrt", {"x.vrt": whole(band("/vsi<!-- -->curl/{url}"))}),
    "warped": ("x.vrt", {"x.vrt": whole(WARPED, ' subClass="VRTWarpedDataset"')}),
    "overview in a VRT": ("x.vrt", {"x.vrt": whole(band("a.tif", OVERVIEW))}),
    "Python": ("x.vrt", {"x.vrt": whole(band("a.tif", PYTHON, ' subClass="VRTDerivedRasterBand"'))}),
    "entity declared": ("x.vrt", {"x.vrt": '<!DOCTYPE x [<!ENTITY e "/vsicurl/{url}">]>' + whole(band("&e;"))}),
    "standard input": ("x.vrt", {"x.vrt": whole(band("/vsistdin/"))}),
    "database": ("x.vrt", {"x.vrt": whole(band("PG:host=127.0.0.1 dbname=x"))}),
    "XML in a VRT": ("x.vrt", {"x.vrt": whole(band("&lt;GDAL_WMS&gt;&lt;/GDAL_WMS&gt;"))}),
    "WMS": ("x.xml", {"x.xml": WMS}),
    "VRT of WMS": ("x.vrt", {"x.vrt": whole(band("x.xml")), "x.xml": WMS}),
    "STAC": ("x.json", {"x.json": STAC}),
    "VRT of STAC": ("x.vrt", {"x.vrt": whole(band("x.json")), "x.json": STAC}),
    "overviews beside": ("a.tif", {"a.tif.ovr": whole(NETWORK)}),
    "mask beside": ("a.tif", {"a.tif.msk": whole(NETWORK)}),
    "metadata beside": ("a.tif", {"a.tif.aux.xml": AUX}),
    "metadata beside, in a VRT": ("x.vrt", {"x.vrt": whole(band("a.tif")), "a.tif.aux.xml": AUX}),
    "text in place of a path": (whole(NETWORK), {}),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_nothing_beside_the_data_leads_elsewhere(tmp_path, monkeypatch, write_image, server, attack):
    url, asked = server
    monkeypatch.chdir(tmp_path)
    write_image(tmp_path / "a.tif")
    given, files = ATTACKS[attack]
    for name, text in files.items():
        (tmp_path / name).write_text(text.replace("{{", "{").replace("}}", "}").replace("{url}", url))
    gdal.VSICurlClearCache()
    asked.clear()
    with pytest.raises(ImageError) as caught, opened(given.replace("{url}", url)) as dataset:
        read(dataset, None, 1, (10, 8))
    assert not asked and "\n" not in str(caught.value) and given[:5] in str(caught.value)


@pytest.mark.parametrize("domain, key", (("OVERVIEWS", "OVERVIEW_FILE"), ("GEOLOCATION", "X_DATASET")))
@pytest.mark.parametrize("behind_a_vrt", (False, True))
def test_tags_of_an_image_lead_nowhere(tmp_path, write_image, server, domain, key, behind_a_vrt):
    url, asked = server
    path = write_image(tmp_path / "a.tif")
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.SetMetadata({key: f"/vsicurl/{url}"}, domain)
    dataset = None  # noqa: F841 - closes it
    path = vrt(tmp_path / "a.vrt", "a.tif") if behind_a_vrt else path
    gdal.VSICurlClearCache()
    asked.clear()
    with pytest.raises(ImageError, match="network source '/vsicurl'"), opened(path) as dataset:
        read(dataset, None, 1, (10, 8))
    assert not asked


def test_a_vrt_in_an_archive_leads_nowhere(tmp_path, server):
    url, asked = server
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("inner.vrt", whole(NETWORK.replace("{url}", url)))
    inside = f"/vsizip/{tmp_path}/a.zip/inner.vrt"
    gdal.VSICurlClearCache()
    asked.clear()
    for path in (inside, vrt(tmp_path / "a.vrt", inside, 0)):
        with pytest.raises(ImageError, match="unpack the archive"), opened(path) as dataset:
            read(dataset)
    assert not asked


def test_images_in_archives_and_network_paths_that_were_typed_work(tmp_path, write_image, server):
    url, asked = server
    image = write_image(tmp_path / "a.tif")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.write(image, "a.tif")
    inside = f"/vsizip/{tmp_path}/a.zip/a.tif"
    for path in (inside, vrt(tmp_path / "a.vrt", inside, 0)):
        with opened(path) as dataset:
            assert np.isfinite(read(dataset)).any()
    asked.clear()
    with pytest.raises(ImageError), opened(f"/vsicurl/{url}?typed"):
        pass
    assert asked  # the server has no such image, but it was asked


def test_a_vrt_of_many_vrts_is_no_deep_one(tmp_path, write_image):
    write_image(tmp_path / "a.tif")
    parts = [vrt(tmp_path / f"{number}.vrt", "a.tif") for number in range(20)]
    sources = "".join(f"<SimpleSource><SourceFilename>{part}</SourceFilename></SimpleSource>" for part in parts)
    (tmp_path / "all.vrt").write_text(whole(f'<VRTRasterBand dataType="UInt16" band="1">{sources}</VRTRasterBand>'))
    with opened(str(tmp_path / "all.vrt")) as dataset:
        assert read(dataset).shape == (80, 100)
    for number in range(12):
        vrt(tmp_path / f"deep{number}.vrt", f"deep{number + 1}.vrt")
    with pytest.raises(ImageError, match="more than 8 deep"), opened(str(tmp_path / "deep0.vrt")):
        pass


@pytest.mark.parametrize(
    "name, text",
    (
        ("v.vrt", '<OGRVRTDataSource><OGRVRTLayer name="x"><SrcDataSource>{url}</SrcDataSource></OGRVRTLayer>'
         "</OGRVRTDataSource>"),
        ("w.xml", "<OGRWFSDataSource><URL>{url}</URL></OGRWFSDataSource>"),
        ("g.gml", '<a xmlns:gml="http://www.opengis.net/gml" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
         'xsi:schemaLocation="x {url}"><gml:featureMember/></a>'),
    ),
)  # fmt: skip
def test_layers_lead_nowhere(tmp_path, server, name, text):
    url, asked = server
    (tmp_path / name).write_text(text.replace("{url}", f"/vsicurl/{url}" if name == "v.vrt" else url))
    gdal.VSICurlClearCache()
    asked.clear()
    assert open_vector(str(tmp_path / name)) is None
    with pytest.raises(InputTableError, match=name):
        read_gcps(str(tmp_path / name), None)
    assert not asked


# --- what files claim -----------------------------------------------------------------------------------------------


def sparse(path, side, *options):
    """A TIFF that claims side x side pixels and holds none."""
    gdal.GetDriverByName("GTiff").Create(str(path), side, side, 1, gdal.GDT_UInt16, ["SPARSE_OK=YES", *options])
    return str(path)


def claim(path, width, height):
    """Change what a TIFF claims: an image of 8 x 8 px becomes one of any size in the same few bytes."""
    sparse(path, 8)
    data = bytearray(path.read_bytes())
    start = int.from_bytes(data[4:8], "little")
    for entry in range(start + 2, start + 2 + 12 * int.from_bytes(data[start : start + 2], "little"), 12):
        tag, value = int.from_bytes(data[entry : entry + 2], "little"), {256: width, 257: height, 278: height}
        if tag in value:
            data[entry + 2 : entry + 12] = (
                (4).to_bytes(2, "little") + (1).to_bytes(4, "little") + value[tag].to_bytes(4, "little")
            )
    path.write_bytes(bytes(data))
    return str(path)


@pytest.mark.parametrize("side", (60_000, 400_000))
def test_files_that_claim_more_than_they_can_hold(tmp_path, side):
    with pytest.raises(ImageError) as caught, opened(claim(tmp_path / "bomb.tif", side, side)):
        pass
    assert "bomb.tif' " in str(caught.value) and "get the file again" in str(caught.value)
    assert f"{side} x {side} px" in str(caught.value) or "Cannot open" in str(caught.value)
    assert os.path.getsize(tmp_path / "bomb.tif") < 1000


def test_sparse_images_are_refused_where_views_are_made(tmp_path):
    path = sparse(tmp_path / "empty.tif", 60_000, "TILED=YES", "COMPRESS=DEFLATE")
    with pytest.raises(ImageError, match=r"empty.tif' claims 60000 x 60000 px and holds 0 % of them"):
        load_views([path])
    mosaic = vrt(tmp_path / "a.vrt", "empty.tif").replace("100", "60000")
    (tmp_path / "a.vrt").write_text(VRT.format(source="small.tif", relative=1).replace('"100"', '"60000"'))
    text = (tmp_path / "a.vrt").read_text().replace('"80"', '"60000"')
    part = (
        '</SourceBand><SrcRect xOff="0" yOff="0" xSize="8" ySize="8"/><DstRect xOff="0" yOff="0" xSize="8" ySize="8"/>'
    )
    (tmp_path / "a.vrt").write_text(text.replace("</SourceBand>", part))
    claim(tmp_path / "small.tif", 8, 8)
    with pytest.raises(ImageError, match="a.vrt' claims 60000 x 60000 px"), opened_image(mosaic):
        pass


def test_more_pixels_than_any_satellite_has(tmp_path, monkeypatch):
    path = sparse(tmp_path / "wide.tif", 400_000, "BLOCKYSIZE=1")
    with pytest.raises(ImageError, match="400000 x 400000 px, more than any satellite's image"):
        load_views([path])


@pytest.mark.parametrize(
    "driver, name, options",
    (
        ("GTiff", "z.tif", ["TILED=YES", "COMPRESS=DEFLATE", "ZLEVEL=9"]),
        ("GTiff", "l.tif", ["TILED=YES", "COMPRESS=LZW", "BLOCKXSIZE=1024", "BLOCKYSIZE=1024"]),
        ("GTiff", "s.tif", ["TILED=YES", "COMPRESS=ZSTD", "BLOCKXSIZE=2048", "BLOCKYSIZE=2048"]),
        ("JP2OpenJPEG", "j.jp2", []),
    ),
)
def test_large_images_of_one_value_pass(tmp_path, monkeypatch, driver, name, options):
    """Nothing compresses better; the bound below which nothing is asked is lowered, so that 16 Mpx are enough."""
    source = gdal.GetDriverByName("MEM").Create("", 4096, 4096, 1, gdal.GDT_Byte)
    source.GetRasterBand(1).WriteArray(np.full((4096, 4096), 7, np.uint8))
    made = gdal.GetDriverByName(driver)
    if made is None or (name == "s.tif" and "ZSTD" not in made.GetMetadataItem("DMD_CREATIONOPTIONLIST")):
        pytest.skip("this GDAL cannot write it")
    made.CreateCopy(str(tmp_path / name), source, options=options)
    monkeypatch.setattr(untrusted, "_HARMLESS_PX", 1000)
    (tmp_path / "v.vrt").write_text(
        VRT.format(source=name, relative=1).replace('"100"', '"4096"').replace('"80"', '"4096"')
    )
    for path in (name, "v.vrt"):
        with opened_image(str(tmp_path / path)) as dataset:
            assert dataset.RasterXSize == 4096


def test_tables_above_the_limit_are_not_read(tmp_path):
    for name in ("big.csv", "big.geojson", "big.kml"):
        with open(tmp_path / name, "wb") as stream:
            stream.truncate(2 << 30)  # sparse: no disk is needed
        with pytest.raises(
            InputTableError, match=f"{name}' has 2048 MiB, and a table or text of points has at most 64"
        ):
            read_gcps(str(tmp_path / name), None)


@pipes
def test_a_pipe_in_place_of_a_table_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(InputTableError, match="pipe or a device"):
        read_gcps(str(tmp_path / "pipe.csv"), None)


def test_tables_with_too_many_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(ground_control, "_LIMITS", replace(ground_control._LIMITS, rows=3))
    (tmp_path / "p.csv").write_text("id,lon,lat,height\n" + "".join(f"{k},1,1,1\n" for k in range(4)))
    with pytest.raises(InputTableError, match="p.csv' has more than 3 rows"):
        read_gcps(str(tmp_path / "p.csv"), None)


def test_a_message_is_one_line_whatever_the_file_is_called(tmp_path):
    with pytest.raises(ImageError) as caught, opened(str(tmp_path / "a\nb.tif")):
        pass
    assert "a b.tif" in str(caught.value) and "\n" not in str(caught.value)


def test_text_in_place_of_a_layer_is_not_opened():
    text = '{"type": "FeatureCollection", "features": []}'
    assert gdal.OpenEx(text, gdal.OF_VECTOR) is not None and open_vector(text) is None
