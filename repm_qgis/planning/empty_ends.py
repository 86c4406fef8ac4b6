"""Masks of images' empty ends, where no nodata value marks these: of the views, and of the images of their colours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import List

from ..imagery.collars import write_collar_mask
from ..runtime.progress import Progress
from ..scene import View


def without_empty_ends(view: View, target: Path, progress: Progress) -> View:
    """The view with a mask at ``target`` of the empty ends of its part and of what its own mask hides; as it is where
    it has none. Raises ImageError for an image that cannot be read, WorkspaceError for a mask that cannot be written.
    """
    fills: List[float] = []
    share = write_collar_mask(
        view.image,
        view.band,
        view.mask,
        target=str(target),
        check=progress.check_cancelled,
        part=view.part,
        told=fills.append,
    )
    if not share:
        return view
    looked_at = f"the part of '{view.name}' around EXTENT" if view.part else f"'{view.name}'"
    percent = f"{100 * share:.1f}"
    if fills:
        progress.info(
            f"{percent} % of the pixels of {looked_at} are margins of the value {fills[0]:g}, or black ones, "
            "that no nodata value marks: they are left out."
        )
    else:
        progress.info(
            f"{percent} % of the pixels of {looked_at} are black margins that no nodata value marks: they are left out."
        )
    return replace(view, mask=str(target))
