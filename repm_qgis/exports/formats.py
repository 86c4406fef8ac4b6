"""The description of a format: where its images lie, its requirements for the cameras, and the files beside the
images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Tuple

from .model import TileModel


@dataclass(frozen=True)
class ExportFormat:
    """How one software stores images and cameras in a folder.

    Attributes
    ----------
    image : relative path of a view's image, without extension, from the model and the view's index.
    extension : of 8-bit images; 16-bit ones are always TIFF.
    write : writes cameras into a folder from the model and the images' relative paths.
    mask : relative path of an image's mask (255 where the image has data) from the image's own; "" where it has none.
    prepare : changes cameras and images to what the format can store.
    require : raises MissingPackageError where a package is missing.
    """

    name: str
    image: Callable[[TileModel, int], str]
    extension: str
    write: Callable[[TileModel, Tuple[str, ...], Path], None]
    mask: Callable[[str], str] = lambda image: ""
    prepare: Callable[[TileModel], TileModel] = lambda model: model
    require: Callable[[], object] = lambda: None

    def images(self, model: TileModel, bits: str) -> Tuple[str, ...]:
        """Relative paths of all views' images."""
        extension = self.extension if bits == "8" else ".tif"
        return tuple(self.image(model, index) + extension for index in range(len(model.views)))
