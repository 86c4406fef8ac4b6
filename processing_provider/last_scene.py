"""The scenes that were written last, of which a stage's dialog proposes the newest one that it can use; and the
workspaces of late, which the panel of scenes shows."""

from __future__ import annotations

import os

from qgis.core import QgsSettings

from ..repm_qgis.scene import serves

_KEY = "repm/last_scenes"  # paths, newest first, one a line
_MOST = 12
_FOLDERS = "repm/workspaces"  # as the scenes are kept
_MOST_FOLDERS = 30


def last_scene(stage: str) -> str:
    """The path of the newest scene that is there and that a stage can take; "" where there is none."""
    return next((path for path in _known() if os.path.exists(path) and serves(path, stage)), "")


def remember(path: str) -> None:
    """Put a scene before all others."""
    others = [known for known in _known() if known != path]
    QgsSettings().setValue(_KEY, "\n".join([path, *others][:_MOST]))
    remember_workspace(os.path.dirname(path))


def workspaces() -> list[str]:
    """The folders of the workspaces of late, the newest first, whether they are still there or not."""
    return str(QgsSettings().value(_FOLDERS, "") or "").splitlines()


def remember_workspace(folder: str, instead_of: str = "") -> None:
    """Put a workspace before all others, or in the place of one that has moved."""
    known = workspaces()
    place = known.index(instead_of) if instead_of in known else 0
    others = [each for each in known if each not in (folder, instead_of)]
    others.insert(place, folder)
    QgsSettings().setValue(_FOLDERS, "\n".join(others[:_MOST_FOLDERS]))


def forget_workspace(folder: str) -> None:
    """Take a workspace out of the list; its files stay."""
    QgsSettings().setValue(_FOLDERS, "\n".join(each for each in workspaces() if each != folder))


def of_surface(path: str) -> str:
    """The scene that a DSM was fused of, among those that were written last; "" where it is none of them."""
    from ..repm_qgis.contracts.errors import RepmError
    from ..repm_qgis.imagery.raster import opened

    try:
        with opened(path) as dataset:
            made_of = dataset.GetMetadataItem("REPM_SCENE")
        return next((known for known in _known() if made_of and _fingerprint(known) == made_of), "")
    except RepmError:
        return ""


def _fingerprint(path: str) -> str:
    from ..repm_qgis.contracts.errors import RepmError
    from ..repm_qgis.scene import Scene

    try:
        return Scene.load(path).fingerprint if os.path.exists(path) else ""
    except RepmError:
        return ""


def _known() -> list[str]:
    return str(QgsSettings().value(_KEY, "") or "").splitlines()
