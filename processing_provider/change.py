"""repm:change."""

from __future__ import annotations

from ..repm_qgis.contracts.documents import JsonMapping
from ..repm_qgis.contracts.options import ChangeOptions
from . import parameters
from .base import RepmAlgorithm


class Change(RepmAlgorithm):
    """Finds what changed between the DSMs of two dates."""

    ID = "change"
    GROUP = "evaluation"
    STEP = 4
    TAGS = "change detection,difference,DoD,volume,cut and fill,quarry,stockpile,level of detection"

    def title(self) -> str:
        return self.tr("Find changes between two dates")

    def shortDescription(self) -> str:
        return self.tr("What was built, removed or dug away between two DSMs, with volumes and their uncertainty.")

    def parameters(self) -> list:
        return [
            parameters.helped(
                parameters.Raster("BEFORE", self.tr("DSM of the first date")),
                self.tr("A raster of heights in metres, in any CRS."),
            ),
            parameters.helped(
                parameters.Raster("AFTER", self.tr("DSM of the second date")),
                self.tr(
                    "A raster of heights in metres, in any CRS; it may have other cells than that of the first date."
                ),
            ),
            parameters.helped(
                parameters.Raster("BEFORE_CONFIDENCE", self.tr("Confidence of the first date"), optional=True),
                self.tr(
                    "The confidence raster that was made with the DSM, or one band with the expected error in metres. "
                    "Give both dates', or none: then the errors are estimated from ground that did not change, and a "
                    "change must be twice as large to be shown."
                ),
            ),
            parameters.helped(
                parameters.Raster("AFTER_CONFIDENCE", self.tr("Confidence of the second date"), optional=True),
                self.tr("As for the first date."),
            ),
            parameters.choice(
                ChangeOptions,
                "align",
                self.tr("Alignment on stable ground"),
                self.tr(
                    "3d: the second DSM is moved in all three axes until the ground that did not change agrees; "
                    "vertical: it is moved up or down only; none: both already fit."
                ),
            ),
            parameters.number(
                ChangeOptions,
                "min_area",
                self.tr("Smallest change (m²)"),
                self.tr("Smaller changes are left out: 50 m² keeps small houses and drops cars and single trees."),
            ),
            parameters.cluster(),
            *(parameters.product(self.ID, name) for name in ("output", "significant", "volumes", "report")),
        ]

    def _scene_name(self, options: JsonMapping) -> str:
        from ..repm_qgis.names import dates_name

        return dates_name(options["before"], options["after"])

    def _days(self, options: JsonMapping, result: JsonMapping) -> list[str]:
        from ..repm_qgis.names import surface_days

        return sorted({*surface_days(options["before"]), *surface_days(options["after"])})
