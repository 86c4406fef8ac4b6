"""How much disk space a run takes: estimated before its work begins, and refused where it cannot fit.

Bytes are those of measured runs whose images see all of the ground; a run may match as little as a third of it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Dict, Iterable, List, NamedTuple, Sequence

from osgeo import ogr

from ..contracts.errors import WorkspaceError
from ..contracts.options import VIEWER_CELLS, DsmFuseOptions, DtmOptions, EditDsmOptions, MosaicOptions
from ..contracts.products import tiles_folder
from ..contracts.records import ViewPair
from ..runtime.progress import Progress
from ..runtime.workspace import existing_place, free_bytes, size_of
from ..scene import Scene, folder_of
from ..stereo.parameters import STEREO

_LEAST = 1 / 3  # of what is expected: less is not refused
_HEIGHT_MAP = 6.5  # bytes for each pixel of ground that a pair sees: three bands, compressed
_REFINED_IMAGE = 1.2  # for each pixel of 16 bits, compressed
_FUSED_CELL, _GREY_CELL, _POINT = 18.0, 4.0, 32.0  # fused tiles, blocks of greys, points of tiles, not compressed
_JOINED_CELL = 24.0  # of the joined tiles, the ground in shadows, and the blocks compared with the images
_RASTERS = {"output": 2.9, "confidence": 15.0, "ortho": 3.5, "water_mask": 0.1}  # for each cell, with overviews
_COLOURED = 2.0  # for each cell and band of 16 bits
_ALL_HEIGHTS = 4.0  # for each cell, while holes are filled
_MOSAIC_CELL, _MOSAIC_SOURCES = 16.0, 1.5  # of a block, not compressed, and of the sources, with overviews
_TERRAIN_CELL, _TERRAIN_MASK = 9.0, 0.05  # of a block, not compressed; of the mask, of a raster of heights
_LAZ, _LAS, _PLY, _EPT = 4.2, 30.0, 31.0, 14.0  # for each point; EPT: while it is built
_NORMAL = 12.0  # of a point; LAZ takes less
_VERTEX = 48.0  # with its two triangles
_ITEM = 1 << 14  # of a STAC item, whatever the DSM
_REPORT = 2 << 20  # of a report with its pictures, whatever the DSM
_PAGE_CELL = 3.0  # heights, an orthophoto and the expected error


class Need(NamedTuple):
    """Bytes that will be written at a path: as many as are expected, and the least that are possible."""

    path: str
    least: float
    expected: float


def _need(path: str, expected: float, there: float = 0.0) -> Need:
    """``there`` are bytes that an earlier run has left and that this one takes as they are."""
    return Need(path, max(_LEAST * expected - there, 0.0), max(expected - there, 0.0))


def images_need(scene: Scene, folder: str) -> Need:
    """The refined images of all tiles."""
    windows = [view.window for tile in scene.tiles for view in tile.views.values()]
    return _need(folder, _REFINED_IMAGE * sum(window.width * window.height for window in windows))


def heights_need(scene: Scene, pairs: Sequence[ViewPair], folder: str) -> Need:
    """The height maps of these pairs, over all tiles with their margins, but for those that are there."""
    margin = 2 * STEREO.tile_margin_px * scene.gsd_m
    sides = [(x1 - x0, y1 - y0) for x0, y0, x1, y1 in (tile.bounds for tile in scene.tiles)]
    grown = sum((x + margin) * (y + margin) for x, y in sides) / sum(x * y for x, y in sides)
    return _need(folder, _HEIGHT_MAP * seen_px(scene, pairs) * grown, size_of(folder))


def fusion_needs(
    scene: Scene,
    pairs: Sequence[ViewPair],
    options: DsmFuseOptions,
    cell: float,
    *,
    bands: int = 0,
    ortho_cell: float = 0.0,
) -> List[Need]:
    """Fused tiles and products on cells of a side (m), without what an earlier run has left of the tiles.

    ``bands`` are those of an orthophoto in colour, 0 for greys; ``ortho_cell`` (m) its cells, 0 for the DSM's.
    """
    finer = (cell / ortho_cell) ** 2 if ortho_cell else 1.0
    cells, points = _area(scene) / cell**2, seen_px(scene, pairs) if options.cloud or options.ept else 0.0
    folder = str(scene.path.parent)
    ortho = bands * _COLOURED if bands else _GREY_CELL if options.ortho or options.viewer else 0.0
    each = _POINT + (2 * _NORMAL if options.cloud and options.cloud_normals else 0.0)
    between = cells * (_FUSED_CELL + _JOINED_CELL + finer * ortho) + points * each
    needs = [_need(folder, between, size_of(str(folder_of(Path(options.scene), "fusion"))))]
    if options.fill == "all":
        needs.append(_need(folder, cells * _ALL_HEIGHTS))
    rasters = {**_RASTERS, "output": 2 * _RASTERS["output"]}  # the last to be copied in its final form
    rasters["ortho"] = finer * (bands * _COLOURED if bands else _RASTERS["ortho"])
    needs += [_need(getattr(options, name), cells * size) for name, size in rasters.items() if getattr(options, name)]
    if options.viewer:  # rasters that it drapes are temporary where they are no products
        temporary = [name for name in ("ortho", "confidence") if not getattr(options, name)]
        needs += [_need(folder, cells * _RASTERS[name]) for name in temporary]
        needs.append(_need(options.viewer, min(cells, VIEWER_CELLS) * _PAGE_CELL))
    if options.stac:
        needs.append(_need(options.stac, _ITEM))
    if options.report:
        needs.append(_need(options.report, _REPORT))
    if options.view_heights:
        needs.append(_need(options.view_heights, len(pairs) * cells * (_RASTERS["output"] + _RASTERS["confidence"])))
    if points:
        kind = Path(options.cloud or "").suffix.lower()
        each = {".las": _LAS, ".ply": _PLY}.get(kind, _LAZ) + (_NORMAL if options.cloud_normals else 0.0)
        needs.append(_need(options.cloud or folder, points * each))
    if options.ept:
        needs.append(_need(options.ept, points * _EPT))
    if options.mesh:
        needs.append(_need(options.mesh, min(cells, options.mesh_vertices or cells) * _VERTEX))
    return needs


def mosaic_needs(options: MosaicOptions, cells: int, folder: str) -> List[Need]:
    """Blocks in a folder, without what an earlier run has left there, and products of a mosaic of so many cells."""
    needs = [_need(folder, cells * _MOSAIC_CELL, size_of(folder))]
    for path, each in ((options.output, _RASTERS["output"]), (options.sources, _MOSAIC_SOURCES)):
        if path:
            copies = 1 if tiles_folder(path) else 2  # a GeoTIFF is copied in its final form
            needs.append(_need(path, cells * copies * each))
    return needs


def terrain_needs(options: DtmOptions, cells: int, folder: str) -> List[Need]:
    """Blocks in a folder, and products of a terrain of so many cells; each is copied in its final form."""
    needs = [_need(folder, cells * _TERRAIN_CELL)]
    rasters = ((options.output, 1.0), (options.heights, 1.0), (options.mask, _TERRAIN_MASK))
    return needs + [_need(path, 2 * share * cells * _RASTERS["output"]) for path, share in rasters if path]


def editing_needs(options: EditDsmOptions, cells: int, bands: int) -> List[Need]:
    """Products of an edited DSM of so many cells, whose confidence has so many bands; each is copied in its final
    form from one that is not compressed."""
    rasters = ((options.output, 1), (options.edited_confidence, bands))
    return [_need(path, cells * count * (4.0 + _RASTERS["output"])) for path, count in rasters if path]


def _area(scene: Scene) -> float:
    """The ground that two views see at least, square metres."""
    return float(ogr.CreateGeometryFromWkt(scene.area).GetArea()) if scene.area else 0.0


def seen_px(scene: Scene, pairs: Sequence[ViewPair]) -> float:
    """The pixels of ground that both views of a pair see, of all pairs together."""
    return _area(scene) / scene.gsd_m**2 * sum(pair.share for pair in pairs)


def require_space(work: str, needs: Iterable[Need], progress: Progress) -> None:
    """Say what ``work`` will write on which disk; files that it replaces stay until the new ones are whole.

    Raises WorkspaceError where a disk has not even the least; a warning says where it may not have enough.
    """
    disks: Dict[object, List[Need]] = {}
    for need in needs:
        disks.setdefault(os.stat(existing_place(need.path)).st_dev, []).append(need)
    for group in disks.values():
        least, expected = sum(need.least for need in group), sum(need.expected for need in group)
        path = max(group, key=lambda need: need.expected).path
        free = free_bytes(path)
        if free is None or not expected:
            continue
        if free < least:
            raise WorkspaceError(
                f"The disk of '{path}' has {_text(free)} free, and {work} writes at least {_text(least)} there: free "
                "some space, or choose a place on another disk."
            )
        text = f"{work.capitalize()} will write about {_text(expected)} on the disk of '{path}' ({_text(free)} free)"
        if free < expected:
            progress.info(f"{text}: if it fills up, free some space and run again, which continues there.")
        else:
            progress.info(f"{text}.")


def _text(count: float) -> str:
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.1f} MiB"
