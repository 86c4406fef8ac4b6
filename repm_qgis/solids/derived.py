"""Products that are made from the finished DSM: one module each, which the table of products names as ``maker``."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Iterator, Optional, Tuple

from ..contracts.options import DsmFuseOptions
from ..contracts.products import Product, paths_of
from ..runtime.parallel import run_whole
from ..runtime.progress import Progress
from .parameters import SolidsParameters


@dataclass(frozen=True)
class FinishedDsm:
    """The written DSM with the options of its run, the file of its points (None: there are none), its CRS, and the
    orthophoto in colour, None where there are only greys."""

    options: DsmFuseOptions
    cloud: Optional[str]
    crs: str
    parameters: SolidsParameters
    ortho: Optional[str] = None


def make_derived(finished: FinishedDsm, progress: Progress) -> Iterator[Tuple[Product, str, Optional[str]]]:
    """Make the requested products; gives each product with its path and the file in it that QGIS opens.

    A maker's ``make(finished, path, progress)`` gives that file, or None where there was nothing to write.
    """
    for product, path in paths_of("dsmfuse", finished.options):
        if product.maker:
            yield product, path, run_whole(_made, (product, finished, path), progress, product.title)


def _made(task: Tuple[Product, FinishedDsm, str], progress: Progress) -> Optional[str]:
    product, finished, path = task
    maker = importlib.import_module(f"{__package__}.{product.maker}")
    file: Optional[str] = maker.make(finished, path, progress)
    return file
