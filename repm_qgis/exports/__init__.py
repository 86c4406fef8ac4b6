"""Refined images with their pinhole cameras for other software: one module for each format, all from one model.

``model`` holds the views of a tile, ``images`` writes their pixels, ``ties`` reads tie points.
"""

from __future__ import annotations

from .colmap import COLMAP
from .mvsnet import MVSNET
from .nerfstudio import NERFSTUDIO
from .whutlc import WHUTLC

FORMATS = {made.name: made for made in (COLMAP, MVSNET, WHUTLC, NERFSTUDIO)}
