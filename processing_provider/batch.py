"""Reports of a batch run, which QGIS's own batch dialog cannot show.

It hands an HTML output to the results viewer without a time, which the viewer of QGIS 3.22 requires: the run ends in a
Python error when all is made. So in a batch such outputs go to the viewer from here, and QGIS does not hear of them.
"""

from __future__ import annotations

import time
from typing import Any

from qgis.core import QgsProcessingAlgorithm, QgsProcessingFeedback, QgsProcessingOutputHtml


def is_batch(feedback: QgsProcessingFeedback) -> bool:
    """Whether this is the feedback of QGIS's batch dialog."""
    return type(feedback).__name__ == "BatchFeedback"


def without_pages(algorithm: QgsProcessingAlgorithm, outputs: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """The outputs without HTML pages, and the pages by their titles."""
    titles = {
        each.name(): each.description()
        for each in algorithm.outputDefinitions()
        if isinstance(each, QgsProcessingOutputHtml)
    }
    pages = {titles[name]: str(path) for name, path in outputs.items() if name in titles and path}
    return {name: value for name, value in outputs.items() if name not in titles}, pages


def show(algorithm: QgsProcessingAlgorithm, pages: dict[str, str]) -> None:
    """Add pages to the results viewer."""
    from processing.core.ProcessingResults import resultsList

    for title, path in pages.items():
        resultsList.addResult(icon=algorithm.icon(), name=title, timestamp=time.localtime(), result=path)
