"""All parameters of the method: those of every package, and those of the stages themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Tuple

from ..buildings.parameters import BuildingParameters
from ..contracts.parameters import Parameters
from ..fusion.parameters import FusionParameters
from ..imagery.parameters import StretchParameters
from ..matching.parameters import MatchingParameters
from ..mosaic.parameters import MosaicParameters
from ..ortho.parameters import OrthoParameters
from ..planning.altitudes import AltitudeParameters
from ..pointing.parameters import PointingParameters
from ..registration.parameters import RegistrationParameters
from ..solids.parameters import SolidsParameters
from ..terrain.parameters import TerrainParameters


@dataclass(frozen=True)
class TileParameters(Parameters):
    """How the ground is divided, and when a stage has too little data to continue. All values but the sizes are
    chosen."""

    sizes_px: Tuple[int, ...] = (1300, 1200, 1000, 800)  # automatic ones; larger match no faster and take more memory
    least_overlap_px: int = 64  # side of the smallest area that two images must share
    surface_px: int = 48  # cells of the terrain model's surface: finer ones carry roofs, which rays may meet twice
    least_matched: int = 1000  # pixels with a height: below that, nothing was reconstructed
    least_matched_share: float = 0.01  # the same as a share of all pixels
    finest_cell_gsd: float = 0.25  # a finer cell of the DSM than so many ground sampling distances is refused: 16 cells
    # for each pixel contain no detail of the matching
    least_cells: int = 4  # along each side of a DSM: a coarser cell is refused
    most_tiles: int = 10_000  # 40,000 px a side in tiles of 400 px: more take days, and their scene half a gigabyte
    cell_gsd: float = 2.0  # side of an automatic cell of the DSM in ground sampling distances


@dataclass(frozen=True)
class EngineParameters(Parameters):
    """Everything that a study may vary: it gives ``replace(ENGINE, ...)`` to :func:`repm_qgis.stages.run_stage`."""

    tiles: TileParameters = TileParameters()
    altitudes: AltitudeParameters = AltitudeParameters()
    stretch: StretchParameters = StretchParameters()
    pointing: PointingParameters = PointingParameters()
    matching: MatchingParameters = MatchingParameters()
    fusion: FusionParameters = FusionParameters()
    ortho: OrthoParameters = OrthoParameters()
    solids: SolidsParameters = SolidsParameters()
    registration: RegistrationParameters = RegistrationParameters()
    mosaic: MosaicParameters = MosaicParameters()
    terrain: TerrainParameters = TerrainParameters()
    buildings: BuildingParameters = BuildingParameters()

    def of_quality(self, quality: str) -> "EngineParameters":
        """These parameters with what QUALITY ``fast`` or ``best`` changes; `make bench-towns` measures both."""
        if quality == "default":
            return self
        pointing, matching = self.pointing, self.matching
        if quality == "fast":
            # Fewer subpixel steps save a fifteenth of the CPU and cost two views of jax_068 1.6 points of C1.
            planning = replace(pointing.planning, pairs=pointing.planning.pairs.fewest())
            return replace(self, pointing=replace(pointing, planning=planning))
        # A third pair for each view takes another third of the CPU and gains nothing with 19 views.
        return replace(self, matching=replace(matching, sgm=matching.sgm.in_eight_directions()))

    def in_fingerprint(self) -> List[object]:
        """The part of the parameters that is in a fingerprint: only changes from the defaults."""
        changes = self.changes()
        return [changes] if changes else []


ENGINE = EngineParameters()
