"""The kind of a file, by its name only: the names that users may give for clouds, meshes and images."""

from __future__ import annotations

import os

IMAGE_ENDS = (".tif", ".tiff", ".jp2", ".ntf", ".nitf")
"""How the names of images end in what vendors deliver."""


def is_cloud(path: str) -> bool:
    """Whether a file is a point cloud, by its extension."""
    return path.lower().endswith((".laz", ".las"))


def is_textured(path: str) -> bool:
    """Whether a mesh is to be one with a picture, glTF or OBJ, by its extension; QGIS shows neither."""
    return path.lower().endswith((".glb", ".obj"))


def is_ply(path: str) -> bool:
    """Whether a cloud or a mesh is to be PLY, by its extension."""
    return path.lower().endswith(".ply")


def is_archive(path: str) -> bool:
    """Whether a path is that of an archive whose images can be read where they are, by its name."""
    return path.lower().endswith((".zip", ".tar")) and not path.startswith("/vsi")


def is_packed_whole(path: str) -> bool:
    """Whether a path is that of an archive that is compressed from end to end, so that reading any image in it means
    to unpack all that lies before."""
    ends = (".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz", ".7z", ".rar")
    return path.lower().endswith(ends) and not path.startswith("/vsi")


def is_catalogue(path: str) -> bool:
    """Whether a path is that of a STAC item or catalogue, by its name."""
    return path.lower().endswith((".json", ".geojson"))


def is_delivery(path: str) -> bool:
    """Whether a path in IMAGES stands for all images of a folder, an archive or a STAC item."""
    return is_archive(path) or is_packed_whole(path) or is_catalogue(path) or os.path.isdir(path)
