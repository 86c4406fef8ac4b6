"""Bad input: what the plugin makes of it, beside what an earlier revision made of the same files.

Each trial runs stages of a checkout as the dialogs do, in a process of its own, and says in a few words how they
ended. A trial that ends with a DSM says how far that lies from the truth. This module has the trials on images and
RPCs, and those of input_heights.py and input_terrain.py with them; those of a second campaign are in input_second.py.
The earlier revision is that of REPM_BENCH_BEFORE, by default the last one before these cases were looked at.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import List, Sequence

import numpy as np
import pyproj
from osgeo import gdal

from benchmarks import input_heights, input_second, input_terrain
from benchmarks.input_case import Ended, Job, Trial, off, pipeline, pixels_of, say_of, town, true_views, write_plain
from benchmarks.runner import ROOT, earlier, few, say
from benchmarks.tables import Section, table
from repm_qgis.imagery.raster import write
from repm_qgis.rpc.model import Rpc
from repm_qgis.rpc.writers import rpc_tags

BEFORE = os.environ.get("REPM_BENCH_BEFORE", "d8da444")
SECOND = "913e92d"


# --- images ---------------------------------------------------------------------------------------------------------


def geom(rpc: Rpc) -> str:
    """OSSIM's file of an RPC, which Orfeo ToolBox leaves beside a crop as that of the whole image."""
    lines = ["type:  ossimRpcModel", "polynomial_format:  B"]
    for key, text in rpc_tags(rpc).items():
        if key.endswith("_COEFF"):
            lines += [f"{key.lower()}_{number:02d}:  {word}" for number, word in enumerate(text.split())]
        else:
            lines.append(f"{key.lower()}:  {text}")
    return "\n".join(lines) + "\n"


def averaged(pixels: np.ndarray, step: int) -> np.ndarray:
    rows, columns = (side // step * step for side in pixels.shape)
    blocks = pixels[:rows, :columns].reshape(rows // step, step, columns // step, step)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint16)


def stepped(step: float, folder: Path) -> List[Job]:
    """Crops whose pixels are means of ``step`` x ``step`` px, or parts of one, with the whole image's RPC beside."""
    images = []
    for view in true_views(2):
        col, row = 100, 60
        crop = pixels_of(view.image)[row:, col:]
        if step > 1:
            crop = averaged(crop, int(step))
        elif step < 1:
            crop = np.kron(crop[200:600, 200:600], np.ones((round(1 / step),) * 2, np.uint16))
            col, row = col + 200, row + 200
        place = (col, step, 0.0, row, 0.0, step)
        images.append(write_plain(folder / f"{view.name}.tif", crop, place=place))
        (folder / f"{view.name}.geom").write_text(geom(view.rpc))
    return [pipeline(folder, images)]


def contradicting(folder: Path) -> List[Job]:
    """Images of 1 m whose metadata say so, under RPCs of 0.5 m."""
    images = []
    for view in true_views(2):
        pixels = averaged(pixels_of(view.image), 2)
        images.append(write_plain(folder / f"{view.name}.tif", pixels, view.rpc, tags={"GSD": "1.0"}))
    return [pipeline(folder, images)]


def abroad(folder: Path) -> str:
    """An image of another continent, whose RPC was made for other heights."""
    view = true_views(3)[2]
    rpc = replace(view.rpc, lon_off=-47.0, lat_off=-23.0, height_off=view.rpc.height_off + 800.0)
    return write_plain(folder / "abroad.tif", pixels_of(view.image), rpc)


def with_foreign(order: Sequence[int], folder: Path) -> List[Job]:
    """A pair alone, and with an image of another continent at a place among the images."""
    pair = list(town().images[:2])
    every = [*pair, abroad(folder)]
    return [pipeline(folder, pair, "alone"), pipeline(folder, [every[k] for k in order])]


def foreign_only(folder: Path) -> List[Job]:
    return [pipeline(folder, [town().images[0], abroad(folder)])]


def points_of_three(folder: Path) -> List[Job]:
    """A run of two images with control points that were measured in three."""
    scene = town()
    return [pipeline(folder, scene.images[:2], gcps=str(scene.folder / "gcps.csv"))]


def stale(folder: Path) -> List[Job]:
    """A crop with its own RPC, and one from elsewhere in its image, with the whole image's RPC file beside it."""
    images = []
    for number, view in enumerate(true_views(2)):
        col, row = (300, 300) if number else (0, 0)
        crop = pixels_of(view.image)[row : row + 500, col : col + 500]
        images.append(write_plain(folder / f"{view.name}.tif", crop))
        (folder / f"{view.name}.geom").write_text(geom(view.rpc))
    return [pipeline(folder, images)]


def crops_apart(folder: Path) -> List[Job]:
    """Crops of two corners of the scene, each with an RPC of its own."""
    images = []
    for view, (col, row) in zip(true_views(2), ((0, 0), (700, 700))):
        crop = pixels_of(view.image)[row : row + 300, col : col + 300]
        images.append(write_plain(folder / f"{view.name}.tif", crop, view.rpc.shifted(col, row)))
    return [pipeline(folder, images)]


def dated(days: Sequence[str], folder: Path) -> List[Job]:
    """A pair whose tags say when it was taken."""
    images = []
    for view, day in zip(true_views(2), days):
        pixels = pixels_of(view.image)
        images.append(write_plain(folder / f"{view.name}.tif", pixels, view.rpc, tags={"IMAGING_DATE": day}))
    return [pipeline(folder, images)]


def as_it_is(folder: Path) -> List[Job]:
    """A pair whose RPCs were made for little more than the heights of the ground."""
    return [pipeline(folder, town().images[:2])]


def sparse_under_coarse(folder: Path) -> List[Job]:
    """A DSM with heights in two of five rows, and a reference in cells of 90 m that covers it."""
    row = np.arange(450)[:, None] % 5
    heights = np.where((row < 2) & np.ones(450, bool), 200.0, np.nan).astype(np.float32)
    crs = pyproj.CRS("EPSG:32631").to_wkt("WKT1_GDAL")
    dsm = write(str(folder / "dsm.tif"), [heights], (500000.0, 1.0, 0.0, 4800000.0, 0.0, -1.0), crs)
    place = (499500.0, 90.0, 0.0, 4800500.0, 0.0, -90.0)
    reference = write(str(folder / "reference.tif"), [np.full((20, 20), 201.0, np.float32)], place, crs)
    return [("comparedsm", {"dsm": dsm, "reference": reference})]


def as_alone(ended: Ended) -> str:
    """Whether the DSM has the very heights of the pair's own."""
    own, found = (gdal.Open(str(ended.folder / name)) for name in ("alone.tif", "run.tif"))
    if (own.GetGeoTransform(), own.GetProjection()) != (found.GetGeoTransform(), found.GetProjection()):
        return f"exit 0, another DSM than the pair's own, in {found.GetSpatialRef().GetName()}"
    same = own.ReadAsArray().tobytes() == found.ReadAsArray().tobytes()
    said = say_of(ended, ("left out:",))
    return f"exit 0, heights {'identical with' if same else 'other than'} the pair's own, to the byte; {said}"


def _off_town(ended: Ended, words: str = "") -> str:
    found = off(ended, town().reference)
    return f"{found}; {say_of(ended, (words,))}" if words else found


TRIALS: List[Trial] = [
    Trial("1", "crops of step 2 with the whole images' `.geom`", partial(stepped, 2), _off_town),
    Trial("1", "crops of step 0.5 with the whole images' `.geom`", partial(stepped, 0.5), _off_town),
    Trial("1", "images of 1 m, so their metadata, under RPCs of 0.5 m", contradicting, _off_town),
    Trial("2", "a pair, then an image of another continent", partial(with_foreign, (0, 1, 2)), as_alone),
    Trial("2", "an image of another continent, then a pair", partial(with_foreign, (2, 0, 1)), as_alone),
    Trial("2", "two images of two continents", foreign_only, _off_town),
    Trial(
        "8", "control points of three images, a run of two", points_of_three, partial(_off_town, words="not used here")
    ),
    Trial("8", "a crop with the whole image's RPC file beside it", stale, _off_town),
    Trial("9", "crops of two corners of a scene", crops_apart, _off_town),
    Trial(
        "9",
        "two images of two years; IMAGING_DATE",
        partial(dated, ("2012-06-20T10:40:00Z", "2014-06-20T10:40:00Z")),
        partial(say_of, words=("years apart",)),
    ),
    Trial("9", "RPCs of 100 m of heights", as_it_is, partial(say_of, words=("(from: ",))),
    Trial("9", "a DSM with many holes, a reference of 90 m", sparse_under_coarse, str),
]


# --- the table ------------------------------------------------------------------------------------------------------


def second_campaign() -> List[str]:
    return [
        f"What an independent campaign broke: how each case ended then (revision {SECOND}), and how it ends now. Its "
        "other classes are in `make bench-faults` (7, 10, 12, 14, 16).",
        table("class | input | before | now", _tried(input_second.TRIALS, SECOND)),
    ]


def _tried(trials: Sequence[Trial], revision: str) -> List[List[str]]:
    """A row for each trial: its point, its input, and how it ends at an earlier revision and now."""
    rows = []
    with tempfile.TemporaryDirectory() as place:
        before = earlier(revision, Path(place))
        for trial in few(list(trials)):
            say(f"{trial.point}: {trial.what} ...")
            cells = [trial.run(tree) if tree else "not measured" for tree in (before, ROOT)]
            rows.append([trial.point, trial.what, *cells])
    return rows


def never_silently_wrong() -> List[str]:
    every = [*TRIALS, *input_heights.TRIALS, *input_terrain.TRIALS]
    rows = _tried(sorted(every, key=lambda trial: int(trial.point)), BEFORE)
    return [
        "Each row is a case of bad input: how the run ended before these cases were looked at "
        f"(revision {BEFORE}), and how it ends now. Distances are those of the DSM from the simulated surface.",
        table("point | input | before | now", rows),
    ]


PARTS = {
    "trials": never_silently_wrong,
    "second": second_campaign,
    "sound": input_second.sound_mosaics,
    "parallax": input_heights.along_parallax,
    "calibration": input_heights.calibration,
}
SECTIONS = [Section("input", "Bad input", "make bench-input", PARTS)]
