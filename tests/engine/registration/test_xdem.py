"""xdem as the oracle: its Nuth and Kääb finds the shift that we find. It runs with a Python of its own.

REPM_XDEM_PYTHON names an interpreter with the package xdem (``python3 -m venv /tmp/xdem && /tmp/xdem/bin/pip install
xdem``): it needs a newer numpy than QGIS ships.
"""

from __future__ import annotations

import json
import os
import subprocess

import numpy as np
import pyproj
import pytest

from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.imagery.raster import write
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.references import in_datum, read_reference
from repm_qgis.registration.solve import Prior, solve_shift
from repm_qgis.registration.surfaces import SupportMeans

PYTHON = os.environ.get("REPM_XDEM_PYTHON", "")
ORACLE = """
import json, sys
import xdem
reference, moved = (xdem.DEM(path) for path in sys.argv[1:])
found = xdem.coreg.NuthKaab()
found.fit(reference, moved)
shifts = found.meta["outputs"]["affine"]
print(json.dumps([float(shifts[f"shift_{axis}"]) for axis in "xyz"]))
"""
CELL, SIDE, WEST, NORTH = 10.0, 300, 500_000.0, 4_000_000.0


@pytest.mark.skipif(not PYTHON, reason="REPM_XDEM_PYTHON names no interpreter with xdem")
@pytest.mark.parametrize("moved", ((7.0, -12.0, 3.0), (-25.0, 4.0, -8.0)))
def test_xdem_finds_the_same_shift(tmp_path, moved):
    rng = np.random.default_rng(3)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE, CELL), np.fft.fftfreq(SIDE, CELL)))
    frequency[0, 0] = 1.0
    spectrum = np.fft.fft2(rng.normal(size=(SIDE, SIDE))) * frequency**-2 * np.exp(-((60 * frequency) ** 2))
    truth = np.fft.ifft2(spectrum).real
    truth *= 80.0 / truth.std()
    wave = np.meshgrid(np.fft.fftfreq(SIDE, CELL), np.fft.fftfreq(SIDE, CELL))
    turned = np.exp(2j * np.pi * (wave[0] * moved[0] - wave[1] * moved[1]))  # content moves by minus the shift
    own = np.fft.ifft2(np.fft.fft2(truth) * turned).real - moved[2]
    own, reference = (z + rng.normal(size=z.shape) * 0.3 for z in (own, truth))
    inner = (slice(10, -10), slice(10, -10))
    grid = CellGrid(WEST + 10 * CELL, NORTH - 10 * CELL, CELL, own[inner].shape)
    wkt = pyproj.CRS("EPSG:32631").to_wkt()
    files = []
    for name, heights in (("reference", reference), ("own", own)):
        data = heights[inner].astype(np.float32)
        files.append(write(str(tmp_path / f"{name}.tif"), [data], grid.geotransform, wkt))
    done = subprocess.run([PYTHON, "-c", ORACLE, *files], capture_output=True, text=True, check=True)
    oracle = np.array(json.loads(done.stdout.strip().splitlines()[-1]))
    least = REGISTRATION.averaged_cells * CELL  # as for every reference that is as fine as the surface
    found = read_reference(files[0], "EPSG:32631", grid.bounds, least)
    wanted = in_datum(found, "EPSG:32631", HeightDatum.of(""))
    means = SupportMeans(grid, own[inner], wanted, REGISTRATION.covered)
    ours = solve_shift(means, wanted, Prior(10.0, 5.0, 60.0))
    assert ours.moved == pytest.approx(moved, abs=0.05)
    assert ours.moved == pytest.approx(oracle, abs=0.05)
    assert (np.abs(ours.moved - moved) < 4 * ours.deviations).all()
