"""repm:environment."""

from __future__ import annotations

from typing import Any, Mapping

from qgis.core import Qgis, QgsProcessingException, QgsProcessingFeedback

from . import engine, parameters
from .base import RepmAlgorithm


class Environment(RepmAlgorithm):
    """Reports what is installed for the engine, and what is missing."""

    ID = "environment"
    GROUP = "tools"
    STEP = 1
    TAGS = "versions,install,packages,CUDA,GPU,PROJ grids,help"

    def title(self) -> str:
        return self.tr("Report the environment")

    def shortDescription(self) -> str:
        return self.tr("Versions, missing packages with the command that installs them, CUDA, memory, PROJ grids.")

    def parameters(self) -> list:
        return [parameters.product(self.ID, "report")]

    def run_stage(self, options: Mapping[str, Any], feedback: QgsProcessingFeedback) -> dict[str, Any]:
        """In the engine's interpreter, which is the one that matters; in QGIS's where that one does not run."""
        feedback.pushInfo(self.tr("QGIS {version}").format(version=Qgis.version()))
        try:
            return engine.run_apart(self.ID, options, feedback)
        except QgsProcessingException as error:
            if feedback.isCanceled():
                raise
            feedback.pushWarning(
                self.tr("The engine does not run, so the report describes QGIS's own Python: {reason}").format(
                    reason=error
                )
            )
            return engine.run_here(self.ID, options, feedback)
