"""Bad input, the second campaign: what an independent campaign broke, beside revision 913e92d, which it broke.

benchmarks/input.py runs the trials; benchmarks/own_rpcs.py shows what sound scenes say of their RPCs,
benchmarks/faults.py has the trials that interrupt a run or meddle with its folders.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Callable, Iterator, List, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from benchmarks.input_case import (
    Ended,
    Job,
    Trial,
    off,
    pipeline,
    pixels_of,
    run_in,
    say_of,
    town,
    true_views,
    write_plain,
)
from benchmarks.input_dsms import WRONG, relief, surface
from benchmarks.own_rpcs import sound_scenes
from benchmarks.runner import ROOT, few, say
from benchmarks.tables import table
from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import RepmError
from repm_qgis.geometry.tiles import enclosing
from repm_qgis.geometry.vertical import DEVIATION_TAG, ELLIPSOID, TAG
from repm_qgis.imagery.raster import opened, read, write
from repm_qgis.rpc.model import Rpc
from repm_qgis.rpc.writers import rpc_tags, rpc_txt
from repm_qgis.scene import Scene

_PLACE, _CRS = (500000.0, 1.0, 0.0, 4800000.0, 0.0, -1.0), pyproj.CRS("EPSG:32631").to_wkt("WKT1_GDAL")
_LOCAL = 'LOCAL_CS["site of works",UNIT["metre",1]]'
_ELLIPSOID = {TAG: ELLIPSOID}
_WORK = "years of work"


# --- 1, 2: RPCs that are not the images' own, or broken -------------------------------------------------------------


def plain_images(rpcs: Sequence[Rpc], folder: Path) -> List[str]:
    """Images of the town with these RPCs, one each."""
    return [
        write_plain(folder / f"{view.name}.tif", pixels_of(view.image), rpc)
        for view, rpc in zip(true_views(len(rpcs)), rpcs)
    ]


def with_rpcs(owners: Sequence[int], with_dem: bool, folder: Path) -> List[Job]:
    """Images of the town, each with the RPC of the one named; a DEM of the true ground where one is asked for."""
    views = true_views(len(owners))
    images = plain_images([views[owner].rpc for owner in owners], folder)
    dem = {"dem": str(shutil.copy(town().reference, folder / "dem.tif"))} if with_dem else {}
    return [pipeline(folder, images, report=str(folder / "r.html"), **dem)]


def with_trend(folder: Path) -> List[Job]:
    """The second RPC's rows run away, by 14 px between the middle and the last one."""
    first, second = (view.rpc for view in true_views(2))
    images = plain_images([first, replace(second, row_scale=1.028 * second.row_scale)], folder)
    return [pipeline(folder, images, report=str(folder / "r.html"))]


def verdict(ended: Ended) -> str:
    """The report's verdict, with how far the DSM is from the true surface."""
    return f"{off(ended, town().reference)}; {reported(ended)[len('exit 0: ') :]}"


# --- 4: mosaics -----------------------------------------------------------------------------------------------------


def flat_town(east: int) -> np.ndarray:
    """Houses on flat ground, m, in cells of 1 m, so many cells further to the east."""
    random, heights = np.random.default_rng(5), np.full((400, 460), 120.0, np.float32)
    for row, column, deep, wide, high in random.uniform((0, 0, 8, 8, 4), (400, 460, 25, 25, 15), (260, 5)):
        heights[int(row) : int(row + deep), int(column) : int(column + wide)] += np.float32(high)
    return heights[:, 30 - east : 430 - east]


def put_together(wrong: str, folder: Path) -> List[Job]:
    """A good DSM, and one of which 200 of 300 m overlap it."""
    if wrong == "displaced by 20 m in a flat town":
        dsms = [
            write(str(folder / f"{east}.tif"), [flat_town(east)], _PLACE, _CRS, metadata=_ELLIPSOID) for east in (0, 20)
        ]
    elif wrong == "6 m too high, and both state 0.5 m":
        tags = {**_ELLIPSOID, DEVIATION_TAG: "0.5"}
        heights = (relief()[:, :200], relief()[:, 100:] + np.float32(6.0))
        places = (_PLACE, (_PLACE[0] + 100.0, *_PLACE[1:]))
        dsms = [
            write(str(folder / f"{k}.tif"), [np.ascontiguousarray(heights[k])], places[k], _CRS, metadata=tags)
            for k in (0, 1)
        ]
    else:
        dsms = [surface(folder, "good"), surface(folder, "wrong", wrong, start=100)]
    return [("mosaic", {"dsms": dsms, "output": str(folder / "m.tif"), "report": str(folder / "r.html")})]


def reported(ended: Ended) -> str:
    """The verdict at the report's top, and what was warned of."""
    top = (ended.folder / "r.html").read_text(encoding="utf-8").split("<h2")[0]
    warned = " ".join(f"“{text}”" for text in ended.warned)
    return f"exit 0: {'“Good.”' if 'Good.' in top else '“Look at”'} {warned}".rstrip()


# --- 5: scale, offset and unit of a band ----------------------------------------------------------------------------


def other_units(stage: str, folder: Path) -> List[Job]:
    """The same surface in feet, which the band's unit says, and in centimetres as whole numbers, by its scale."""
    feet = write(
        str(folder / "feet.tif"), [relief() / np.float32(0.3048)], _PLACE, _CRS, unit="ft", metadata=_ELLIPSOID
    )
    path = str(folder / "scaled.tif")
    dataset = gdal.GetDriverByName("GTiff").Create(path, *relief().shape[::-1], 1, gdal.GDT_Int32)
    dataset.SetGeoTransform(_PLACE)
    dataset.SetProjection(_CRS)
    dataset.SetMetadata(_ELLIPSOID)
    band = dataset.GetRasterBand(1)
    band.SetScale(0.01)
    band.SetOffset(100.0)
    band.WriteArray(np.rint((relief() - 100.0) * 100).astype(np.int32))
    band = dataset = None
    if stage == "mosaic":
        return [(stage, {"dsms": [feet, path], "output": str(folder / "m.tif"), "report": str(folder / "r.html")})]
    return [(stage, {"dsm": feet, "reference": path, "report": str(folder / "r.html")})]


def spread(ended: Ended) -> str:
    return f"NMAD {ended.result['nmad']:.2f} m; {reported(ended)}"


# --- 6: comparisons -------------------------------------------------------------------------------------------------


def compared(wrong: str, folder: Path) -> List[Job]:
    reference, dsm = surface(folder, "reference"), surface(folder, "dsm", wrong)
    return [("comparedsm", {"dsm": dsm, "reference": reference, "align": "vertical", "report": str(folder / "r.html")})]


# --- 8, 9: copies and replaced images -------------------------------------------------------------------------------


def with_copy(rounded: bool, folder: Path) -> List[Job]:
    """A pair alone, and with a copy of its first image, whose RPC may have lost digits."""
    pair = list(town().images[:2])
    again = shutil.copy(pair[0], folder / "again.tif")
    if rounded:
        dataset = gdal.Open(str(again), gdal.GA_Update)
        tags = dataset.GetMetadata("RPC")
        dataset.SetMetadata({**tags, "SAMP_OFF": f"{float(tags['SAMP_OFF']) + 0.3:.1f}"}, "RPC")
        dataset = None
    return [pipeline(folder, pair, "alone"), pipeline(folder, [pair[0], str(again), pair[1]])]


def as_the_pair(ended: Ended) -> str:
    own, found = (gdal.Open(str(ended.folder / name)).ReadAsArray().tobytes() for name in ("alone.tif", "run.tif"))
    same = "identical with" if own == found else "other than"
    return f"exit 0, heights {same} the pair's own, to the byte; {say_of(ended, ('copy of',))}"


def replaced(folder: Path) -> Iterator[Job]:
    """An image takes the name of another one, with the same size and time, between two stages."""
    images = [shutil.copy(path, folder) for path in town().images[:2]]
    yield pipeline(folder, list(map(str, images)))
    before = os.stat(images[0])
    dataset = gdal.Open(str(images[0]), gdal.GA_Update)
    dataset.GetRasterBand(1).WriteArray(dataset.ReadAsArray()[::-1])
    dataset = None
    os.utime(images[0], ns=(before.st_atime_ns, before.st_mtime_ns))
    scene = str(folder / "run" / "reconstructed.json")
    yield (
        "dsmfuse",
        {"scene": scene, "output": str(folder / "d.tif"), "ortho": str(folder / "o.tif"), "resolution": 1.0},
    )


# --- 11, 15: RPCs ---------------------------------------------------------------------------------------------------


def mirrored_rows(folder: Path) -> List[Job]:
    images = []
    for number, view in enumerate(true_views(2)):
        path = write_plain(folder / f"{view.name}.tif", pixels_of(view.image), view.rpc)
        if number:
            dataset = gdal.Open(path, gdal.GA_Update)
            dataset.SetMetadata({**rpc_tags(view.rpc), "LINE_SCALE": f"-{view.rpc.row_scale}"}, "RPC")
            dataset = None
        images.append(path)
    return [pipeline(folder, images)]


def across_180_degrees(folder: Path) -> List[Job]:
    """The town where the longitude changes its sign, one image on either side."""
    rpcs = [replace(view.rpc, lon_off=180.0 - side) for view, side in zip(true_views(2), (0.0, 360.0))]
    return [pipeline(folder, plain_images(rpcs, folder))]


def filled(ended: Ended) -> str:
    return f"exit 0: VALID_PERCENT {ended.result['valid_percent']:.1f}"


# --- 12 to 14: what lies there already --------------------------------------------------------------------------------


def linked_lock(folder: Path) -> List[Job]:
    """A link under the name of a product's lock leads to a file of the user."""
    (folder / "precious").write_text(_WORK)
    (folder / ".run.tif.lock").symlink_to(folder / "precious")
    return [pipeline(folder, town().images[:2])]


def precious(ended: Ended) -> str:
    same = (ended.folder / "precious").read_text() == _WORK
    return f"exit 0: what the link leads to is {'as it was' if same else 'lost'}"


def private(folder: Path) -> List[Job]:
    """A product of the same name that only its owner may read."""
    (folder / "run.tif").touch(0o600)
    return [pipeline(folder, town().images[:2])]


def permissions(ended: Ended) -> str:
    return f"exit 0: the product's permissions are {os.stat(ended.folder / 'run.tif').st_mode & 0o777:04o}"


def beside_a_mesh(folder: Path) -> List[Job]:
    """A picture and a material of the user under the names that an OBJ would take."""
    for name in ("m.obj.jpg", "m.obj.mtl", "m.jpg", "m.mtl"):
        (folder / name).write_text(_WORK)
    return [pipeline(folder, town().images[:2], mesh=str(folder / "m.obj"), ortho=str(folder / "o.tif"))]


def kept(ended: Ended) -> str:
    lost = [path.name for path in sorted(ended.folder.glob("m.*")) if path.suffix in (".jpg", ".mtl")]
    lost = [name for name in lost if (ended.folder / name).read_bytes() != _WORK.encode()]
    theirs = [name for name in lost if name in ("m.obj.jpg", "m.obj.mtl", "m.jpg", "m.mtl")]
    return f"exit 0: {f'replaced: {theirs}' if theirs else 'no file of the user was replaced'}"


# --- 17 to 21: files that are odd or damaged ------------------------------------------------------------------------


def local_crs(what: str, folder: Path) -> List[Job]:
    path = write(str(folder / f"{what}.tif"), [relief()], _PLACE, _LOCAL)
    if what == "dem":
        return [pipeline(folder, town().images[:2], dem=path)]
    return [("comparedsm", {"dsm": surface(folder, "dsm"), "reference": path})]


def cloud(damage: Callable[[bytearray], bytearray], folder: Path) -> List[Job]:
    """A reference of points whose header is damaged."""
    import laspy

    made, path = laspy.create(point_format=6, file_version="1.4"), folder / "reference.las"
    x, y = np.meshgrid(np.arange(200.0), np.arange(200.0))
    made.x, made.y, made.z = x.ravel() + 500000.0, y.ravel() + 4799800.0, np.full(x.size, 300.0)
    made.write(str(path))
    path.write_bytes(damage(bytearray(path.read_bytes())))
    return [pipeline(folder, town().images[:2], reference=[str(path)])]


def cut_in_header(content: bytearray) -> bytearray:
    return content[:200]


def too_many_records(content: bytearray) -> bytearray:
    content[100:104] = struct.pack("<I", 0xFFFFFFFF)
    return content


def other_letters(folder: Path) -> List[Job]:
    """Metadata with a key and a value in Latin-1."""
    images = []
    for view in true_views(2):
        path = write_plain(folder / f"{view.name}.tif", pixels_of(view.image), view.rpc, tags={"hXhe": "straXe"})
        content = Path(path).read_bytes().replace(b"hXhe", b"h\xf6he").replace(b"straXe", b"stra\xdfe")
        Path(path).write_bytes(content)
        images.append(path)
    return [pipeline(folder, images)]


def pipe_beside(name: str, folder: Path) -> List[Job]:
    images = plain_images([view.rpc for view in true_views(2)], folder)
    os.mkfifo(f"{os.path.splitext(images[0])[0]}{name}")
    return [pipeline(folder, images)]


def fan(folder: Path) -> List[Job]:
    """Seven VRTs, of which each names the next one ten times."""
    images = plain_images([view.rpc for view in true_views(2)], folder)
    rows, columns = pixels_of(images[0]).shape
    for number in range(7):
        source = f"{number + 1}.vrt" if number < 6 else os.path.basename(images[0])
        one = f'<SimpleSource><SourceFilename relativeToVRT="1">{source}</SourceFilename></SimpleSource>'
        band = f'<VRTRasterBand dataType="UInt16" band="1">{10 * one}</VRTRasterBand>'
        text = f'<VRTDataset rasterXSize="{columns}" rasterYSize="{rows}">{band}</VRTDataset>'
        (folder / f"{number}.vrt").write_text(text)
    (folder / "0_RPC.TXT").write_text(rpc_txt(true_views(2)[0].rpc))
    return [pipeline(folder, [str(folder / "0.vrt"), images[1]])]


def edited(change: Callable[[dict], None], folder: Path) -> Iterator[Job]:
    """A scene file that somebody has edited between two stages."""
    yield pipeline(folder, town().images[:2])
    path = folder / "run" / "reconstructed.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    change(document)
    path.write_text(json.dumps(document), encoding="utf-8")
    yield "dsmfuse", {"scene": str(path), "output": str(folder / "d.tif"), "resolution": 1.0}


def without_base(document: dict) -> None:
    for pair in document["pairs"]:
        pair["base_to_height"] = 0


def unknown_backend(document: dict) -> None:
    for tile in document["tiles"]:
        for heights in tile["heights"]:
            heights["backend"] = "psychic"


def without_views(document: dict) -> None:
    document["views"] = []


_MOSAICS: Sequence[str] = (
    "times 3.28",
    "upside down",
    "mirrored",
    "displaced by 20 m",
    "displaced by 20 m in a flat town",
    "6 m too high, and both state 0.5 m",
    "right",
)

_TRIALS = [
    *(
        Trial("1", what, partial(with_rpcs, owners, with_dem), verdict)
        for what, owners, with_dem in (
            ("a pair with exchanged RPCs", (1, 0), False),
            ("a pair with exchanged RPCs and a correct DEM", (1, 0), True),
            ("three images, two with exchanged RPCs", (1, 0, 2), False),
            ("a pair with one RPC on both images", (0, 0), False),
        )
    ),
    Trial("2", "an RPC whose LINE_SCALE is 2.8 % too large", with_trend, verdict),
    *(Trial("4", f"a mosaic with a DSM that is {wrong}", partial(put_together, wrong), reported) for wrong in _MOSAICS),
    Trial("5", "a DSM in feet compared with one in scaled centimetres", partial(other_units, "comparedsm"), spread),
    Trial("5", "a mosaic of the two", partial(other_units, "mosaic"), reported),
    *(Trial("6", f"a DSM that is {wrong}, compared", partial(compared, wrong), spread) for wrong in WRONG),
    Trial("8", "a pair and a copy of one of its images", partial(with_copy, False), as_the_pair),
    Trial("8", "a pair and a copy whose RPC was rounded", partial(with_copy, True), as_the_pair),
    Trial("9", "an image that is replaced before the fusion", replaced, filled),
    Trial("11", "an RPC with a negative LINE_SCALE", mirrored_rows, filled),
    Trial("12", "a link under the name of a product's lock", linked_lock, precious),
    Trial("13", "an earlier product of mode 0600", private, permissions),
    Trial("14", "pictures and materials of the user beside an OBJ", beside_a_mesh, kept),
    Trial("15", "a pair across 180 degrees", across_180_degrees, filled),
    Trial("17", "a DEM with a local CRS", partial(local_crs, "dem"), filled),
    Trial("17", "a reference with a local CRS", partial(local_crs, "reference"), str),
    Trial("18", "a LAS file that is cut in its header", partial(cloud, cut_in_header), filled),
    Trial("18", "a LAS file that claims 4 294 967 295 records", partial(cloud, too_many_records), filled),
    Trial("19", "metadata in Latin-1", other_letters, filled),
    *(
        Trial("20", f"a pipe `NAME{name}` beside an image", partial(pipe_beside, name), filled)
        for name in (".tif.aux.xml", ".IMD")
    ),
    Trial("20", "VRTs of which each names the next one ten times", fan, filled),
    Trial("21", "a scene with a base-to-height ratio of 0", partial(edited, without_base), filled),
    Trial("21", "a scene with an unknown backend", partial(edited, unknown_backend), filled),
    Trial("21", "a scene without views", partial(edited, without_views), filled),
]

TRIALS: List[Trial] = [replace(trial, limit_s=120.0) for trial in _TRIALS]


# --- sound scenes ---------------------------------------------------------------------------------------------------


def _bounds(images: Sequence[str], folder: Path) -> Tuple[Bounds, str]:
    """The ground that a scene's images show together, and its CRS."""
    ended = run_in(ROOT, "epmfit", {"images": list(images), "workspace": str(folder / "w")}, folder)
    if ended.error:
        raise RepmError(ended.error)
    scene = Scene.load(str(ended.result["scene"]))
    return enclosing([tile.bounds for tile in scene.tiles]), scene.crs


def _half(images: Sequence[str], bounds: Bounds, crs: str, side: int, folder: Path) -> str:
    """A DSM of three fifths of a scene, in the west or the east, made from the images; the second one in feet."""
    reach = 0.6 * (bounds.xmax - bounds.xmin)
    ends = (bounds.xmin, bounds.xmin + reach) if side == 0 else (bounds.xmax - reach, bounds.xmax)
    path = str(folder / f"half_{side}.tif")
    made = {"images": list(images), "workspace": str(folder / f"w{side}"), "output": path}
    extent = [ends[0], bounds.ymin, ends[1], bounds.ymax]
    ended = run_in(ROOT, "pipeline", {**made, "extent": extent, "extent_crs": crs}, folder)
    if ended.error:
        raise RepmError(ended.error)
    if side:
        with opened(path) as dataset:
            heights, place, wkt = read(dataset), dataset.GetGeoTransform(), dataset.GetProjection()
            tags = dataset.GetMetadata()
        write(path, [heights / np.float32(0.3048)], place, wkt, unit="ft", metadata=tags)
    return path


def sound_mosaics() -> List[str]:
    """What a mosaic says of two parts of a sound scene, one in metres and one in feet."""
    rows = []
    for name, images in few(sound_scenes()):
        say(f"{name} ...")
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            bounds, crs = _bounds(images, folder)
            halves = [_half(images, bounds, crs, side, folder) for side in (0, 1)]
            report = str(folder / "r.html")
            ended = run_in(ROOT, "mosaic", {"dsms": halves, "output": str(folder / "m.tif"), "report": report}, folder)
            table_of = re.sub("<[^>]+>", " ", Path(report).read_text(encoding="utf-8").split("horizontal shift, m")[1])
            _, _, _, median, _, spread_m, beside = table_of.split()[:7]
            rows.append([name, median, spread_m, beside, reported(ended)])
    return [
        "Two parts of sound scenes that overlap by a fifth, each made from the images by itself, one of them in feet, "
        "put together: no warning is to be given.",
        table("scene | median before, m | NMAD, m | to the side, m | the mosaic's report", rows),
    ]
