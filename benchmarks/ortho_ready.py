"""Ortho-ready products of a real pair: how far their DSM is from that of the sensor's images, and why."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any, Callable, List, Sequence

import numpy as np
from osgeo import gdal

from benchmarks.runner import few, pipeline, say
from benchmarks.scenes import absent, real_or_town
from benchmarks.scoring import difference
from benchmarks.tables import Section, table
from repm_qgis.geometry.frames import utm_crs
from repm_qgis.numerics.robust import nmad
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import View, load_views, middle_of

_KERNELS = ("cubic", "cubicspline", "lanczos", "bilinear")
_CELL = 0.5


def _moved(view: View, path: str, kernel: str) -> None:
    """The sensor's image, resampled half a pixel to the right and down: nothing else is changed."""
    width, height = view.size[0] - 1, view.size[1] - 1
    gdal.Translate(path, view.image, srcWin=[0.5, 0.5, width, height], width=width, height=height, resampleAlg=kernel)
    _tag(path, rpc_tags(view.rpc.shifted(0.5, 0.5)))


def _projected(view: View, path: str, kernel: str, crs: str, height_m: float, gsd_m: float) -> None:
    """The image as a vendor projects it to the map at one height."""
    options = {"transformerOptions": [f"RPC_HEIGHT={height_m}"], "errorThreshold": 0, "dstNodata": 0}
    gdal.Warp(path, view.image, dstSRS=crs, rpc=True, xRes=gsd_m, yRes=gsd_m, resampleAlg=kernel, **options)
    _tag(path, rpc_tags(view.rpc))


def _tag(path: str, tags: Any) -> None:
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.SetMetadata(tags, "RPC")
    dataset = None  # noqa: F841 - it is written now


def _dsm(images: Sequence[str], folder: Path, **options: object) -> Path:
    folder.mkdir()
    pipeline(images, folder, resolution=_CELL, workers=1, **options)
    return folder / "dsm.tif"


def _geometry_px(view: View, product: str, height_m: float) -> float:
    """The largest distance from where the product's model sees ground points to where GDAL puts their pixels, px."""
    (made,) = load_views([product], height=height_m)
    rng = np.random.default_rng(1)
    pixels = rng.uniform(50, np.array(view.size) - 50, (500, 2))
    ground = view.rpc.localise(pixels, rng.uniform(*view.rpc.height_range, 500))
    seen = made.model.project(ground) + 0.5
    ways = ["SRC_METHOD=GEOTRANSFORM", "DST_METHOD=RPC", f"RPC_HEIGHT={height_m}", "RPC_PIXEL_ERROR_THRESHOLD=1e-6"]
    back = gdal.Transformer(gdal.Open(product), gdal.Open(view.image), ways)
    found = np.array([back.TransformPoint(0, float(col), float(row))[1][:2] for col, row in seen]) - 0.5
    return float(np.hypot(*(found - pixels).T).max())


class _Trial:
    """A pair's own DSM, and how far that of images is which were made of it."""

    def __init__(self, images: Sequence[str], folder: str) -> None:
        self.views, self.folder = load_views(images), folder
        self.rows: List[List[object]] = []
        self.base = _dsm(images, Path(folder, "sensor"))

    def add(self, label: str, make: Callable[[View, str], None], **options: object) -> None:
        made = Path(self.folder, str(len(self.rows)))
        made.mkdir()
        paths = [str(made / f"{view.name}.tif") for view in self.views]
        for view, path in zip(self.views, paths):
            make(view, path)
        error = difference(str(_dsm(paths, made / "run", **options)), str(self.base))
        error = error[np.isfinite(error)]
        self.rows.append([label, f"{nmad(error):.3f}", f"{np.median(error):+.3f}", f"{np.abs(error).mean():.3f}"])


def ortho_ready() -> List[str]:
    (scene,) = real_or_town("pleiades_pair")
    say(f"ortho-ready: {scene.name}")
    with tempfile.TemporaryDirectory() as folder:
        trial = _Trial(scene.images[:2], folder)
        first = trial.views[0]
        crs = utm_crs(*middle_of(trial.views))
        height_m = float(np.mean(first.rpc.height_range)) + 50.0
        for kernel in few(_KERNELS):
            trial.add(f"moved by half a pixel, {kernel}", partial(_moved, kernel=kernel))
        for gsd_m in few((0.5, 0.25)):
            for kernel in few(_KERNELS[:3]):
                make = partial(_projected, kernel=kernel, crs=crs, height_m=height_m, gsd_m=gsd_m)
                trial.add(f"projected at {gsd_m} m, {kernel}", make, ortho_ready_height=height_m)
        product = str(Path(folder, "geometry.tif"))
        _projected(first, product, "near", crs, height_m, 0.5)
        geometry, rows = _geometry_px(first, product, height_m), trial.rows
    return [
        f"A pair of 0.5 m ({scene.name}), and what GDAL makes of its images: moved by half a pixel in their own "
        "geometry, with RPCs that are moved as well, and projected to UTM at one height, 50 m above the middle of the "
        "RPCs' heights. All DSMs have cells of 0.5 m. The table has their differences from the DSM of the images "
        "themselves: what a resampling does where no geometry changes is the least that a projection can do. "
        f"The product's model and GDAL's own transformer agree within {geometry:.1g} px over 500 points between the "
        "RPC's heights.",
        table("images | NMAD, m | median, m | mean of absolute differences, m", rows),
        *absent("pleiades_pair"),
    ]


SECTIONS = [Section("ortho_ready", "Ortho-ready products", "make bench-ortho_ready", {"ortho_ready": ortho_ready})]
