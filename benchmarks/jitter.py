"""Satellites that shake: scenes of a three-line camera with waves of the attitude that the RPCs do not know."""

from __future__ import annotations

import resource
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

import numpy as np
from osgeo import gdal
from scipy import ndimage

from benchmarks.runner import few, pipeline, say
from benchmarks.scenes import Scene, simulated, zy3
from benchmarks.scoring import scores
from benchmarks.tables import Section, table
from repm_qgis.imagery.raster import write
from repm_qgis.pointing.vertical_parallax import vertical_parallax
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.simulation.scene import make_views

SIZE, RELIEF_M = 2048, 900.0
JITTER_PX = 1.0  # of the slowest sine at most; three of them make up to 1.5 px
_DEM_M, _DEM_NOISE_M = 30.0, 1.5


def scene(jitter_px: float) -> Scene:
    """The images, with or without jitter; the surface is the same."""
    spec = replace(zy3(SIZE, RELIEF_M), jitter_px=jitter_px)
    return simulated("jitter" if jitter_px else "steady", spec, 5.0)


@dataclass(frozen=True)
class Case:
    """A run: of which images, with which options."""

    label: str
    jitter_px: float
    images: Tuple[int, ...] = (0, 1, 2)
    pointing: str = "auto"
    reference: bool = False


CASES = (
    Case("steady, without waves", 0.0, pointing="shift"),
    Case("steady", 0.0),
    Case("jitter, without waves", JITTER_PX, pointing="shift"),
    Case("jitter", JITTER_PX),
    Case("jitter, and a DEM as REFERENCE", JITTER_PX, reference=True),
    Case("jitter, forward and backward, without waves", JITTER_PX, (0, 2), "shift"),
    Case("jitter, forward and backward", JITTER_PX, (0, 2)),
    Case("jitter, forward and backward, and a DEM as REFERENCE", JITTER_PX, (0, 2), reference=True),
)


def dem(truth: str, place: Path) -> str:
    """The true surface in cells of 30 m, with noise of 1.5 m that is correlated over some 60 m."""
    means = str(place / "means.tif")
    gdal.Warp(means, truth, xRes=_DEM_M, yRes=_DEM_M, resampleAlg="average")
    dataset = gdal.Open(means)
    height = dataset.ReadAsArray().astype(np.float64)
    noise = ndimage.gaussian_filter(np.random.default_rng(3).normal(size=height.shape), 1.0)
    noisy = (height + noise * _DEM_NOISE_M / noise.std()).astype(np.float32)
    return write(str(place / "dem.tif"), [noisy], dataset.GetGeoTransform(), dataset.GetProjection(), unit="m")


def parallax_px(made: SceneFile, case: Case) -> float:
    """The root mean square of the vertical parallax of the true surface, as the corrected views see it, px: what no
    choice of a height explains, in the pair of the outermost views."""
    spec = replace(zy3(made.views[0].width, RELIEF_M), jitter_px=case.jitter_px)
    true = [make_views(spec)[number] for number in (case.images[0], case.images[-1])]
    views = made.views[0], made.views[-1]
    numbers, side = np.random.default_rng(0), made.views[0].width
    ground = true[0].localise(numbers.uniform(0.1 * side, 0.9 * side, (4000, 2)), numbers.uniform(400.0, 1100.0, 4000))
    pixels = true[0].project(ground), true[1].project(ground)
    inside = ((pixels[1] > 0) & (pixels[1] < side - 1)).all(axis=1)
    seen = pixels[0][inside], pixels[1][inside]
    found = vertical_parallax(views, seen, ground[inside])[0]
    return float(np.sqrt(np.mean(found**2)))


def row(case: Case) -> List[object]:
    say(f"{case.label} ...")
    made = scene(case.jitter_px)
    with tempfile.TemporaryDirectory() as work:
        options: Dict[str, object] = {"pointing": case.pointing, "resolution": made.resolution}
        if case.reference:
            options["reference"] = [dem(made.reference, Path(work))]
        before = _cpu_s()
        pipeline([made.images[number] for number in case.images], work, **options)
        seconds = _cpu_s() - before
        found = scores(f"{work}/dsm.tif", made.reference, not case.reference)
        last = SceneFile.load(str(Path(work, "w", "reconstructed.json")))
        waves = max((jitter.most_px for jitter in (view.jitter for view in last.views) if jitter), default=None)
        parallax = parallax_px(last, case)
        ties = last.pointing
        count, left = (ties.count, ties.after_px) if ties else (0, 0.0)
    size = "none" if waves is None else f"{waves:.2f}"
    figures = [round(value, 3) for value in (left, parallax, found.rmse, found.nmad)]
    return [case.label, size, count, *figures, round(found.valid, 1), round(seconds)]


def _cpu_s() -> float:
    used = [resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def simulations() -> List[str]:
    cases: Sequence[Case] = few(CASES)
    return [
        f"A simulated tri-stereo of a camera like ZY-3's (2.1 to 2.5 m, 22 degrees forward and backward, {SIZE} px a "
        f"side) over {RELIEF_M:.0f} m of relief, with three sines in each direction of each view: periods from 360 to "
        "1700 lines, together up to 1.5 px. The RPCs do not know of them. DSMs of 5 m against the true surface, after "
        "the best whole-cell shift and the median height difference are taken out; with a REFERENCE as they are. The "
        f"DEM has cells of {_DEM_M:.0f} m and {_DEM_NOISE_M} m of correlated noise. Vertical parallax: root mean "
        "square of the outermost views' at places of the true surface. *Without waves* is POINTING `shift`, all others "
        "`auto`. CPU seconds are the whole pipeline's.",
        table(
            "images | largest wave, px | tie points | their residual, px | vertical parallax, px | RMSE m | NMAD m | "
            "valid % | CPU s",
            [row(case) for case in cases],
        ),
    ]


SECTIONS = [Section("jitter", "Satellites that shake", "make bench-jitter", {"simulations": simulations})]
