"""Corrected RPCs of real sensors: GDAL's transformer with the exported files against the pointed model."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np
from osgeo import gdal

from benchmarks.runner import few
from benchmarks.scenes import SHARED
from benchmarks.tables import table
from repm_qgis.imagery.vrt import image_vrt_text
from repm_qgis.rpc import Rpc
from repm_qgis.rpc.correction import corrected
from repm_qgis.rpc.fit import fit_rpc
from repm_qgis.rpc.readers import read_rpc_file
from repm_qgis.rpc.writers import rpb_text, rpc_tags, rpc_txt

_SHIFT = np.array([[1.0, 0.0, 17.25], [0.0, 1.0, -20.0]])
_TURN = np.array([[0.7, -1.0, 0.0], [1.0, 0.6, 0.0]])
_POINTS = 1000


def corrected_rpcs() -> List[str]:
    """Shifts and affine corrections in the forms that other software reads, for every RPC of the shared data."""
    by_site: Dict[str, List[Path]] = {}
    for path in sorted(path for path in (SHARED / "rpc").rglob("*") if path.is_file()):
        by_site.setdefault(path.name.split("__")[0] if "__" in path.name else path.stem[:20], []).append(path)
    if not by_site:
        return [f"Corrected RPCs are not measured: there are no RPCs in {SHARED / 'rpc'}."]
    rows = []
    for site, paths in few(list(by_site.items())):
        worst = np.max([_errors(path) for path in paths], axis=0)
        rows.append([site, len(paths), *(f"{error:.1e}" for error in worst)])
    return [
        "**4. Corrected RPCs**: the largest distance in px, over each image and its heights, of GDAL's transformer "
        "with the exported VRT, `.RPB` and `_RPC.TXT` (the worst of the three) from the pointed model, for a shift of "
        "(17, -20) px alone and with a drift; the last columns fit all eighty coefficients instead of the numerators. "
        "Bar: 0.01 px.",
        table(
            "RPCs of | files | shift | drift 1e-4 | drift 1e-3 | all eighty, 1e-4 | all eighty, 1e-3",
            rows,
        ),
    ]


def _errors(path: Path) -> Tuple[float, ...]:
    rpc = read_rpc_file(str(path))
    size = (500, 500) if path.suffix == ".NTF" else (round(2 * rpc.col_scale), round(2 * rpc.row_scale))
    chance = np.random.default_rng(5)
    pixels = chance.uniform(-0.5, np.array(size) - 0.5, (_POINTS, 2))
    ground = rpc.localise(pixels, chance.uniform(*rpc.height_range, _POINTS))
    found, fitted = [], []
    for drift in (0.0, 1e-4, 1e-3):
        pointing = _SHIFT + drift * _TURN
        linear, shift = pointing[:, :2], pointing[:, 2]
        wanted = rpc.project(ground) @ linear.T + shift

        def localise(pixels: np.ndarray, heights: np.ndarray, linear=linear, shift=shift) -> np.ndarray:
            return rpc.localise((pixels - shift) @ np.linalg.inv(linear).T, heights)

        made = corrected(rpc, pointing, size, rpc.height_range).rpc
        found.append(max(_distance(seen, wanted) for seen in _by_gdal(made, ground)))
        if drift:
            fitted.append(_distance(fit_rpc(localise, size, rpc.height_range).rpc.project(ground), wanted))
    return (*found, *fitted)


def _distance(pixels: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(pixels - wanted, axis=1).max())


def _by_gdal(rpc: Rpc, ground: np.ndarray) -> List[np.ndarray]:
    """The pixels of ground points by each exported form."""
    seen = []
    with tempfile.TemporaryDirectory() as folder:
        for name, write in (("image.vrt", None), ("image.RPB", rpb_text), ("image_RPC.TXT", rpc_txt)):
            place = Path(folder) / name
            place.mkdir()
            image = str(place / "image.tif")
            gdal.GetDriverByName("GTiff").Create(image, 16, 16, 1).FlushCache()
            if write is None:
                text = image_vrt_text(gdal.Open(image), image, str(place), {"RPC": rpc_tags(rpc)})
            else:
                text = write(rpc)
            (place / name).write_text(text)
            transformer = gdal.Transformer(gdal.Open(image if write else str(place / name)), None, ["METHOD=RPC"])
            pixels, _ = transformer.TransformPoints(1, ground.tolist())
            seen.append(np.array(pixels)[:, :2] - 0.5)
    return seen
