"""Refined images with their pinhole cameras for other software: one module a layout, all written from one model.

``model`` says what a tile's views are, ``images`` writes their pixels, ``ties`` reads tie points; ``colmap``,
``mvsnet``, ``whutlc`` and ``nerfstudio`` each hold one :class:`Layout`.
"""

from __future__ import annotations

from typing import Dict

from .colmap import COLMAP
from .layout import Layout
from .mvsnet import MVSNET
from .nerfstudio import NERFSTUDIO
from .whutlc import WHUTLC

LAYOUTS: Dict[str, Layout] = {layout.name: layout for layout in (COLMAP, MVSNET, WHUTLC, NERFSTUDIO)}
