"""The same images as files of other kinds: whether their DSM is the same.

The real pair has values of 12 bits in files of 16. GDAL writes it in each form, with the RPC as that form carries it.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence

import numpy as np
from osgeo import gdal

from benchmarks.runner import few, is_quick, pipeline
from benchmarks.scenes import Scene, absent, real_or_town
from benchmarks.scoring import difference, nmad, scores
from benchmarks.tables import Section, table
from repm_qgis.imagery.raster import quiet
from repm_qgis.rpc import Rpc
from repm_qgis.scene import load_view

NAMES = ("pleiades_pair", "pleiades_triplet")
LEAST_ALIKE_M = 0.05


@dataclass(frozen=True)
class Form:
    """A kind of file: its driver, extension, and options of gdal.Translate; or ``colours`` and an alpha band."""

    name: str
    driver: str
    suffix: str
    options: Mapping[str, object] = field(default_factory=dict)
    colours: bool = False

    def writable(self) -> bool:
        driver = gdal.GetDriverByName(self.driver)
        return driver is not None and bool(driver.GetMetadataItem("DCAP_CREATECOPY"))

    def write(self, image: str, folder: Path) -> str:
        """Write an image's file of this kind, and give its path."""
        target = str(folder / f"{Path(image).stem}{self.suffix}")
        if self.colours:
            _write_coloured(image, target)
            return target
        with quiet():  # NITF's own tag rounds the RPC, and GDAL writes the whole one beside it
            gdal.Translate(target, image, format=self.driver, **self.options)
        return target


def _write_coloured(image: str, target: str) -> None:
    """Write the image as red, green and blue of 16 bits, and an alpha band that hides nothing."""
    source = gdal.Open(image)
    grey, size = source.ReadAsArray(), (source.RasterXSize, source.RasterYSize)
    options = ["PHOTOMETRIC=RGB", "ALPHA=YES"]
    made = gdal.GetDriverByName("GTiff").Create(target, *size, 4, gdal.GDT_UInt16, options)
    made.SetMetadata(source.GetMetadata("RPC"), "RPC")
    for number in (1, 2, 3):
        made.GetRasterBand(number).WriteArray(grey)
    made.GetRasterBand(4).Fill(65535)


_BYTES = {"outputType": gdal.GDT_Byte, "scaleParams": [[80, 700, 1, 255]]}
FORMS = (
    Form("16 bit, as it came", "GTiff", ".tif"),
    Form("12 bit", "GTiff", ".tif", {"creationOptions": ["NBITS=12"]}),
    Form("float", "GTiff", ".tif", {"outputType": gdal.GDT_Float32}),
    Form("float, 0 to 1", "GTiff", ".tif", {"outputType": gdal.GDT_Float32, "scaleParams": [[0, 10000, 0, 1]]}),
    Form("JPEG 2000, lossless", "JP2OpenJPEG", ".jp2", {"creationOptions": ["QUALITY=100", "REVERSIBLE=YES"]}),
    Form("NITF", "NITF", ".ntf"),
    Form("COG", "COG", ".tif", {"creationOptions": ["COMPRESS=DEFLATE"]}),
    Form("VRT", "VRT", ".vrt"),
    Form("RGBA, 16 bit", "GTiff", ".tif", colours=True),
    Form("JPEG 2000, 4 bits a pixel", "JP2OpenJPEG", ".jp2", {"creationOptions": ["QUALITY=25"]}),
    Form("JPEG 2000, 1 bit a pixel", "JP2OpenJPEG", ".jp2", {"creationOptions": ["QUALITY=6.25"]}),
    Form("8 bit", "GTiff", ".tif", _BYTES),
)
_NARROWER = {"altitude_min": 2257.0, "altitude_max": 2420.0}  # the pair's run finds 2242 to 2421 m
MIXED = {
    "pleiades_pair": (
        ("JPEG 2000, lossless", "RGBA, 16 bit"),
        ("NITF", "float, 0 to 1"),
        ("12 bit", "VRT"),
        ("COG", "8 bit"),
    ),
    "pleiades_triplet": (("RGBA, 16 bit", "JPEG 2000, lossless", "float, 0 to 1"), ("NITF", "COG", "VRT")),
}


def rpc_error_px(image: str, original: str) -> float:
    """How far the RPC of a file is from the original's, at its corners and heights; the largest error, px."""
    rpcs: List[Rpc] = [load_view(path).rpc for path in (image, original)]
    view = load_view(original)
    corners = np.array([[c, r] for c in (0.0, view.width) for r in (0.0, view.height)])
    ground = np.concatenate([view.localise(corners, height) for height in view.rpc.height_range])
    return float(np.abs(np.subtract(*(rpc.project(ground) for rpc in rpcs))).max())


def measured(
    scene: Scene, forms: Sequence[Form], reference: Optional[str], folder: str, **options: object
) -> List[object]:
    """The row of a run whose images have these forms, in turn, beside the DSM of the original files (None: itself)."""
    places = [Path(folder) / str(number) for number in range(len(forms))]  # an RPC beside one image is not the other's
    images = []
    for place, form, image in zip(places, forms, scene.images):
        place.mkdir(parents=True)
        images.append(form.write(image, place))
    off = max(map(rpc_error_px, images, scene.images))
    dsm = pipeline(images, folder, resolution=scene.resolution, **options).output
    found = scores(dsm, scene.reference, scene.align)
    same = nmad(difference(dsm, reference)) if reference else 0.0
    return [found.valid, same, off, found.rmse]


def of(scene: Scene, work: str) -> List[List[object]]:
    """The rows of a scene: each form alone, then mixed."""
    named: Dict[str, Form] = {form.name: form for form in FORMS}
    alone = [[FORMS[0]] * 3] if scene.name == NAMES[1] else [[form] * len(scene.images) for form in FORMS]
    mixed = MIXED.get(scene.name, MIXED[NAMES[len(scene.images) > 2]])
    rows: List[List[object]] = []
    reference = None
    for number, forms in enumerate([*few(alone), *few([[named[name] for name in one] for one in mixed])]):
        names, drivers = (
            " + ".join(dict.fromkeys(each)) for each in zip(*((form.name, form.driver) for form in forms))
        )
        missing = [form.driver for form in forms if not form.writable()]
        if missing:
            rows.append([scene.name, names, drivers, f"not measured: this GDAL does not write {missing[0]}", *"---"])
            continue
        folder = f"{work}/{scene.name.split()[0]}_{number}"
        os.makedirs(folder)
        rows.append([scene.name, names, drivers, *measured(scene, forms, reference, folder)])
        reference = reference or f"{folder}/dsm.tif"
    if scene.name == NAMES[0] and not is_quick():
        folder, forms = f"{work}/narrower", [FORMS[0]] * len(scene.images)
        found = measured(scene, forms, reference, folder, **_NARROWER)
        rows.append([scene.name, "16 bit, 15 m less of altitudes", "GTiff", *found])
    return rows


def forms() -> List[str]:
    with tempfile.TemporaryDirectory() as work:
        rows = [row for scene in few(real_or_town(*NAMES)) for row in of(scene, work)]
    return [
        "The real pair, and three views of which each has another form, written by GDAL "
        f"{gdal.VersionInfo('RELEASE_NAME')} in other forms: values of 12 bits (94 to 1883), RGBA with three equal "
        "colours, 8 bits from 80 to 700 linearly. Every DSM is compared with that of the files as they came and with "
        "S2P's, the reference; the RPC of each file with the original's, at the corners and the ends of its heights.",
        table(
            "images | form | driver | valid, % of the reference's cells | NMAD against the original's DSM, m | RPC off "
            "by, px | RMSE against the reference, m",
            rows,
        ),
        *absent(*NAMES),
        f"Bar of the project: at most {LEAST_ALIKE_M:g} m NMAD where the form loses nothing. Whole numbers that stay "
        "what they are give the same DSM to the bit; of floats, the means that the altitude range comes from are not "
        "rounded. 8 bits and lossy compression lose values. The last row of the pair shows how much of that is chance: "
        "the same files, searched over a slightly smaller range of altitudes.",
    ]


SECTIONS = [Section("files", "Files of other kinds", "make bench-files", {"forms": forms})]
