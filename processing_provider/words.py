"""Choices in words: what a dialog shows for the values that commands, models and the engine use."""

from __future__ import annotations

from qgis.PyQt.QtCore import QCoreApplication


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmWords", text)


def shown(parameter: str, value: str) -> str:
    """A value of a choice in the user's language, with the value itself behind it where that is another word."""
    words = _words()
    text = words.get(f"{parameter}={value}") or words.get(value) or value
    return text if text.lower() == value.lower() else f"{text} ({value})"


def _words() -> dict[str, str]:
    return {
        "auto": _tr("Automatic"),
        "none": _tr("None"),
        "all": _tr("All"),
        "preview": _tr("Preview"),
        "default": _tr("Default"),
        "best": _tr("Best"),
        "fewest": _tr("Fewest"),
        "city": _tr("City"),
        "mountains": _tr("Mountains"),
        "urban": _tr("Town"),
        "shift": _tr("Shift"),
        "affine": _tr("Affine"),
        "jitter": _tr("Affine and jitter"),
        "tilt": _tr("Shift and tilt"),
        "vertical": _tr("Vertical offset"),
        "3d": _tr("3-D shift"),
        "icp": _tr("3-D shift by nearest points"),
        "mean": _tr("Mean"),
        "median": _tr("Median"),
        "occlusions": _tr("Occlusions"),
        "inside": _tr("Inside"),
        "greys": _tr("Greys"),
        "homography": _tr("Homography"),
        "polynomial": _tr("Polynomial"),
        "terrain": _tr("Terrain"),
        "bilinear": _tr("Bilinear"),
        "cubic": _tr("Cubic"),
        "lanczos": _tr("Lanczos"),
        "sgm": _tr("Semi-global matching"),
        "BACKEND=colmap": _tr("COLMAP on a GPU"),
        "rpc": _tr("With the RPCs"),
        "ADJUSTMENT=colmap": _tr("With COLMAP"),
        "PRESET=fast": _tr("First look"),
        "QUALITY=fast": _tr("Fewest pairs"),
        "FILL=all": _tr("All holes"),
        "COLOUR=all": _tr("All bands"),
        "WATER=keep": _tr("As matched"),
        "WATER=flatten": _tr("Flat, rivers fall"),
    }


def groups() -> list[tuple[str, tuple[str, ...]]]:
    """The headings under which a dialog with many advanced parameters shows them, in their order."""
    return [
        (_tr("Images"), ("RPCS", "MASKS", "ORTHO_READY_HEIGHT")),
        (_tr("Area and heights"), ("CRS", "DEM", "ALTITUDE_MIN", "ALTITUDE_MAX")),
        (_tr("Control and references"), ("GCP_DATUM", "REFERENCE_DATUM", "STABLE")),
        (_tr("Cameras"), ("TILE_SIZE", "ERROR_BUDGET", "MODEL", "ORDER")),
        (_tr("Matching"), ("PAIRS", "POINTING", "ADJUSTMENT", "BACKEND")),
        (_tr("Surface"), ("METHOD", "FILL", "WATER", "OUTLIER_RADIUS")),
        (
            _tr("Orthophoto, colours, point cloud and mesh"),
            ("ORTHO_RESOLUTION", "COLOUR", "XS", "PANSHARPEN", "CLOUD_NORMALS", "MESH_VERTICES"),
        ),
    ]


def hints() -> dict[str, str]:
    """What an empty line or a zero means, by parameter: shown in its place."""
    ellipsoid, automatic = _tr("WGS 84 ellipsoid"), _tr("automatic")
    return {
        "VERTICAL_DATUM": ellipsoid,
        "GCP_DATUM": ellipsoid,
        "VIEW": _tr("the first"),
        "TILE": _tr("all"),
        "RESOLUTION": automatic,
        "ORTHO_RESOLUTION": automatic,
        "TILE_SIZE": automatic,
        **dict.fromkeys(("ALTITUDE_MIN", "ALTITUDE_MAX", "ORTHO_READY_HEIGHT"), automatic),
        "ALTITUDE": _tr("the middle"),
        "OUTLIER_RADIUS": _tr("off"),
        "MESH_VERTICES": _tr("one for each cell"),
        "GPU_MEMORY": _tr("what is free"),
    }


def automatic_datum() -> str:
    return _tr("Automatic: what each file says, or else what fits")
