"""The products of a workspace: their files, sizes, and their removal."""

from __future__ import annotations

import os
import re
import shutil
from contextlib import suppress
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from ..contracts.errors import OptionError, WorkspaceError, reason_of
from ..contracts.formats import companions
from ..contracts.paths import real_path
from ..contracts.products import (
    BUILT_FOLDER,
    FOLDER,
    OF_SCENES,
    POINTS,
    POLYGONS,
    PRODUCTS,
    RASTER,
    SCENE,
    Product,
    products_of,
    stem_of,
)
from ..runtime.locks import exclusive
from ..runtime.progress import Silent
from .facts import ProductFacts, Value
from .places import entries_of, is_remote, lies_in

_MOST_FILES = 50_000  # of a product's folder that are counted
_NUMBER = re.compile(r"_\d{1,4}$")
_RASTERS = (".tif", ".tiff", ".vrt", ".img", ".jp2", ".asc")
_SHAPES = (".gpkg", ".shp", ".geojson", ".fgb")
_OF_SCENE = re.compile(r"^tiles\.|_tie_points\.")  # which stages to come read, and the report links


def products_in(folder: str, commanded: Mapping[str, Value], images: set[str]) -> List[ProductFacts]:
    """The products of a workspace, in the order of ``PRODUCTS``: those that a run was asked for, and those with their
    usual names."""
    found: Dict[str, ProductFacts] = {}
    for each in products_of("pipeline"):
        path = commanded.get(each.option)
        if isinstance(path, str) and each.option not in ("workspace", "report") and os.path.isabs(path):
            found[real_path(path)] = _facts(folder, each, path)
    for entry in entries_of(folder):
        product = _product_of(entry)
        real = real_path(entry.path)
        if product is not None and real not in found and real not in images:
            found[real] = _facts(folder, product, entry.path)
    order = {(each.stage, each.option): number for number, each in enumerate(PRODUCTS)}
    first = order["dsmfuse", "output"]

    def place(made: ProductFacts) -> Tuple[bool, int, str]:
        number = order[made.product.stage, made.product.option]
        return number < first, number, made.path

    return sorted(found.values(), key=place)


def _product_of(entry: os.DirEntry[str]) -> Optional[Product]:
    """The product that has the name of a file or folder; None where that is no product's."""
    name, end = os.path.splitext(entry.name) if entry.is_file() else (entry.name, "")
    name, end = _NUMBER.sub("", name).lower(), end.lower()
    best: Tuple[int, Optional[Product]] = (0, None)
    for each in PRODUCTS:
        if each.option in ("workspace", "report", "heights" if each.stage == "reconstruct" else ""):
            continue
        own = each.option if each.option in ("tiles", "tie_points") else stem_of(each.stage, each)
        if not _has_form(each, end, entry.is_dir()):
            continue
        if name == own or name.endswith(f"_{own}"):
            length = len(own)
        else:  # such as dsm_registered
            length = 1 if each.stage in OF_SCENES and name.startswith(f"{own}_") else 0
        if length > best[0]:
            best = (length, each)
    return best[1]


def _has_form(product: Product, end: str, is_folder: bool) -> bool:
    if product.form in (FOLDER, BUILT_FOLDER) or is_folder:
        return is_folder and product.form in (FOLDER, BUILT_FOLDER) and product.stage != "sampledata"
    if product.form == SCENE:
        return False
    if product.form == RASTER:
        return end in _RASTERS
    if product.form in (POINTS, POLYGONS):
        return end in _SHAPES
    return end in re.findall(r"\*(\.\w+)", product.filter)


def _facts(folder: str, product: Product, path: str) -> ProductFacts:
    removable = lies_in(folder, path) and not _OF_SCENE.search(os.path.basename(path))
    there = not is_remote(path) and os.path.lexists(path)
    size = sum(map(_size, _belonging(product, path))) if there else 0
    return ProductFacts(product, path, size, there, removable)


def _belonging(product: Product, path: str) -> List[str]:
    """The files of a product: its own, and those beside it."""
    beside: List[str] = []
    if product.form not in (FOLDER, BUILT_FOLDER):
        with suppress(KeyError, OptionError):  # a format that this product is not written in
            beside = companions(product, path)
    return [each for each in dict.fromkeys((path, *beside)) if os.path.lexists(each)]


def _size(path: str) -> int:
    """The bytes of a file, or of all files in a folder."""
    total = 0
    with suppress(OSError):
        if os.path.islink(path) or not os.path.isdir(path):
            return os.lstat(path).st_size
        count = 0
        for place, _, files in os.walk(path):
            for name in files:
                count += 1
                if count > _MOST_FILES:
                    return total
                with suppress(OSError):
                    total += os.lstat(os.path.join(place, name)).st_size
    return total


class _Impatient(Silent):
    """Does not wait for a lock."""

    def check_cancelled(self) -> None:
        raise WorkspaceError("The workspace is in use by another run: remove products when that has ended.")


def remove_products(folder: str, products: Sequence[ProductFacts]) -> List[str]:
    """Remove products with what belongs to them; gives the paths removed.

    Raises WorkspaceError where another run writes in the workspace, where something else than a product in it is
    named, and where a file cannot be removed.
    """
    removed = []
    with exclusive("remove", _Impatient(), [folder]):
        for made in products:
            if not (made.removable and lies_in(folder, made.path)):
                raise WorkspaceError(
                    f"'{made.path}' is not a product in the workspace '{folder}': it is not removed here."
                )
            for path in _belonging(made.product, made.path):
                if not lies_in(folder, path):
                    continue
                try:
                    if os.path.isdir(path):
                        shutil.rmtree(path)
                    else:
                        os.unlink(path)
                except OSError as error:
                    raise WorkspaceError(
                        f"Cannot remove '{path}' ({reason_of(error)}): close what has it open."
                    ) from error
                removed.append(path)
    return removed
