"""Removes the half-written files of an engine process that was ended before it could do so itself."""

from __future__ import annotations

import glob
import os
import shutil
from typing import Iterator, Mapping

from ..repm_qgis.contracts.products import BUILT_FOLDER, FOLDER, SCENE, forms, kept_folder, tiles_folder

_MARK = ".*.part*"  # repm_qgis/runtime/workspace.py: temporary_name


def _patterns(options: Mapping[str, object]) -> Iterator[str]:
    known = forms()
    for name, value in options.items():
        form = known.get(name)
        if not form or not value or not isinstance(value, str):
            continue
        if form == FOLDER:
            yield os.path.join(glob.escape(value), "**", _MARK)
        elif form == SCENE:  # products, and what fusion keeps, lie in the scene's folder
            yield os.path.join(glob.escape(os.path.dirname(value)), "**", _MARK)
        elif form == BUILT_FOLDER:
            yield _beside(value, os.path.basename(value))
        else:
            if tiles_folder(value):
                yield _beside(value, os.path.basename(tiles_folder(value)))
            yield os.path.join(glob.escape(kept_folder(value)), "**", _MARK)
            yield _beside(value, os.path.splitext(os.path.basename(value))[0])


def _beside(path: str, stem: str) -> str:
    return os.path.join(glob.escape(os.path.dirname(path)), f".{glob.escape(stem)}.part*")


def remove_half_written(options: Mapping[str, object], since: float) -> list[str]:
    """Remove temporary files of a stage with these options that changed after ``since`` (seconds since 1970).

    Gives the files removed. Only the engine's own temporary names are touched, and only where this stage writes.
    """
    removed = []
    for pattern in _patterns(options):
        for path in glob.glob(pattern, recursive=True):
            try:
                if os.path.getmtime(path) < since - 2:  # some file systems count in 2 s
                    continue
                if os.path.isdir(path) and not os.path.islink(path):  # an export's model, built under this name
                    shutil.rmtree(path)
                else:
                    os.unlink(path)
                removed.append(path)
            except OSError:  # gone already, or not ours to remove: the next run overwrites it
                continue
    return removed
