"""Small things that help in the desktop: geoid grids, reports of a batch run, a quiet start."""

from __future__ import annotations

import functools
import http.server
import os
import shutil
import threading

import numpy as np
import pytest
from osgeo import gdal

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture
def network(tmp_path):
    """A server in place of PROJ's, which has one grid as a small GeoTIFF; gives its address."""
    folder = tmp_path / "network"
    folder.mkdir()
    raster = gdal.GetDriverByName("GTiff").Create(str(folder / "us_nga_egm08_25.tif"), 20, 10, 1, gdal.GDT_Float32)
    raster.GetRasterBand(1).WriteArray(np.full((10, 20), 30.0, np.float32))
    raster = None
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.mark.slow
def test_grids_are_fetched_a_batch_ends_well_loading_is_quiet(sample, desktop_start, network, tmp_path, monkeypatch):
    monkeypatch.setenv("PROJ_NETWORK_ENDPOINT", network)
    for variable in ("XDG_DATA_HOME", "PROJ_USER_WRITABLE_DIRECTORY", "http_proxy", "HTTP_PROXY", "all_proxy"):
        monkeypatch.delenv(variable, raising=False)
    grids = tmp_path / ".local" / "share" / "proj"
    reports = [str(tmp_path / f"report_{number}.html") for number in (1, 2)]
    rows = [{"IMAGES": sample.images, "REPORT": report} for report in reports]
    night = "[repm]\nfirst_steps_shown=true\n[UI]\nUITheme=Night Mapping\n"
    found = desktop_start("drive_helpers.py", {"rows": rows, "folder_of_grids": str(grids)}, settings=night)
    assert not [text for text in found["log"] if "uplicate" in text], found["log"]
    assert found["grids"]["us_nga_egm08_25.tif"] == "Fetch" == found["grids"]["us_noaa_g2018u0.tif"]
    assert {"fr_ign_RAF18.tif", "uk_os_OSGM15_GB.tif"} < set(found["grids"])  # of the datums that dialogs offer
    assert found["looked up"].startswith("nl_") and found["looked up"] in found["grids"]
    assert "is not a vertical CRS" in found["no datum"]
    assert found["said"].startswith("us_nga_egm08_25.tif is installed")
    assert found["fetched"]["us_nga_egm08_25.tif"] == "Installed" and os.path.exists(grids / "us_nga_egm08_25.tif")
    if found["grids"]["us_nga_egm96_15.tif"] == "Fetch":  # the server does not have it
        assert found["failed"].startswith("The grid could not be fetched") and not found["parts"]
        assert found["failed"].endswith("Settings > Options > Network.")
    assert not found["cut"]  # by a message of several lines
    assert found["default"] == [False, True]  # the packages are there: Enter closes
    assert [page for page in found["pages"] if page in reports] == reports and all(map(os.path.exists, reports))
    assert not [text for text in found["log"] if "Traceback" in text], found["log"]
