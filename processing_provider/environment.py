"""repm:environment."""

from __future__ import annotations

from typing import Mapping

from qgis.core import Qgis, QgsProcessingException, QgsProcessingFeedback, QgsProcessingParameterFile

from ..repm_qgis.contracts.options import EnvironmentOptions
from ..repm_qgis.contracts.results import EnvironmentResult
from ..repm_qgis.contracts.stages import ENVIRONMENT
from ..repm_qgis.runtime.packages import REQUIREMENTS, requirements_of, sizes_mb
from . import engine, installation, parameters
from .base import RepmAlgorithm


class Environment(RepmAlgorithm):
    """Reports what is installed for the engine, and what is missing; installs or removes it on request."""

    ID = "environment"
    GROUP = "tools"
    STEP = 1
    TAGS = "versions,install,packages,CUDA,GPU,PROJ grids,help"

    def title(self) -> str:
        return self.tr("Report the environment")

    def shortDescription(self) -> str:
        return self.tr("Versions, missing packages and their installation, CUDA, memory, PROJ grids.")

    def parameters(self) -> list:
        download, disk = sizes_mb(requirements_of([REQUIREMENTS]))
        folder = QgsProcessingParameterFile.Behavior.Folder
        wheels = QgsProcessingParameterFile(
            "WHEELS", self.tr("Install from a folder of wheels (without a network)"), folder, "", "", True
        )
        return [
            parameters.switch(
                EnvironmentOptions,
                "install",
                self.tr("Install what the engine needs, if it is missing"),
                self.tr(
                    "Makes or renews the engine's own environment in your profile (about {download:.0f} MB to "
                    "download, {disk:.0f} MB on the disk), through the proxy of QGIS's settings. QGIS "
                    "itself is not changed."
                ).format(download=download, disk=disk),
            ),
            parameters.helped(
                wheels,
                self.tr("Files that end with .whl, for this Python and system. Empty: the Python Package Index."),
            ),
            parameters.advanced(
                parameters.switch(
                    EnvironmentOptions,
                    "remove",
                    self.tr("Remove the engine's environment"),
                    self.tr("Do this before you uninstall the plugin, because QGIS removes the plugin's folder alone."),
                )
            ),
            parameters.product(self.ID, "report"),
        ]

    def complete(self, options: dict[str, object]) -> dict[str, object]:
        return {**options, "wheels": options.get("wheels") or ""}

    def run_stage(self, options: Mapping[str, object], feedback: QgsProcessingFeedback) -> EnvironmentResult:
        """In the engine's interpreter, which is the one that matters; in QGIS's where that one does not run."""
        feedback.pushInfo(self.tr("QGIS {version}").format(version=Qgis.version()))
        with engine.sigterm_cancels(feedback):
            installation.run(options, feedback)
            return self._report(options, feedback)

    def _report(self, options: Mapping[str, object], feedback: QgsProcessingFeedback) -> EnvironmentResult:
        options = {"report": options.get("report")}
        try:
            return engine.run_apart(ENVIRONMENT, options, feedback)
        except QgsProcessingException as error:
            if feedback.isCanceled():
                raise
            feedback.pushWarning(
                self.tr("The engine does not run, so the report describes QGIS's own Python: {reason}").format(
                    reason=error
                )
            )
            return engine.run_here(ENVIRONMENT, options, feedback)
