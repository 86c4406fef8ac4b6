"""A page for the client: map, orthophoto, figures and verdict of a scene as a print layout of QGIS, and as PDF.

The template is ``resources/layouts/client_page.qpt``, whose items are found by their ids; it can be changed in QGIS.
"""

from __future__ import annotations

import os
from typing import Optional, Sequence

from qgis.core import (
    Qgis,
    QgsCoordinateTransform,
    QgsLayerTreeLayer,
    QgsLayoutExporter,
    QgsLayoutItem,
    QgsLayoutItemLabel,
    QgsLayoutItemLegend,
    QgsLayoutItemMap,
    QgsLayoutItemScaleBar,
    QgsMapLayer,
    QgsMapLayerLegendUtils,
    QgsPrintLayout,
    QgsProject,
    QgsRasterLayer,
    QgsReadWriteContext,
    QgsRectangle,
)
from qgis.PyQt.QtCore import QCoreApplication, QLocale
from qgis.PyQt.QtXml import QDomDocument

from ..processing_provider.base import resource
from ..repm_qgis import __version__
from ..repm_qgis.names import period
from ..repm_qgis.workspaces.facts import RunFacts, Workspace
from .hillshades import shade_of
from .next_step import free_path

_EDGE = 1.03  # of the map around the DSM
_VERDICT = 420  # characters


def _tr(text: str) -> str:
    return QCoreApplication.translate("ClientPage", text)


def make_page(
    scene: Workspace, run: Optional[RunFacts], dsm: QgsRasterLayer, ortho: Optional[QgsRasterLayer]
) -> QgsPrintLayout:
    """A layout of the project that shows a scene's DSM, with its orthophoto where there is one, and the verdict of a
    ``run``. Raises LookupError where the template cannot be read."""
    project = QgsProject.instance()
    layout = QgsPrintLayout(project)
    layout.initializeDefaults()
    document = QDomDocument()
    with open(resource("layouts", "client_page.qpt"), encoding="utf-8") as stream:
        document.setContent(stream.read())
    if not layout.loadFromTemplate(document, QgsReadWriteContext())[1]:
        raise LookupError("client_page.qpt")
    name, taken = scene.title, {each.name() for each in project.layoutManager().layouts()}
    number = 1
    while name in taken:
        number += 1
        name = f"{scene.title} ({number})"
    layout.setName(name)
    items = {each.id(): each for each in layout.items() if isinstance(each, QgsLayoutItem) and each.id()}
    _show(items["map"], [*shade_of(dsm), dsm], dsm)
    _show(items["inset"], [ortho] if ortho is not None else [], dsm)
    for each in ("inset", "inset_title"):
        items[each].setVisibility(ortho is not None)
    _fill_legend(items["legend"], dsm)
    _fit_bar(items["scale"], items["map"])
    texts = {
        "title": scene.title,
        "subtitle": _tr("Digital surface model from satellite images"),
        "inset_title": _tr("Orthophoto"),
        "figures": "\n".join(f"{what}: {value}" for what, value in figures_of(scene, dsm)),
        "verdict": _verdict(run),
        "credits": _tr("Images: their providers. Surface model: REPM {version}.").format(version=__version__),
    }
    for key, text in texts.items():
        label = items[key]
        if isinstance(label, QgsLayoutItemLabel):
            label.setText(text)
    project.layoutManager().addLayout(layout)
    return layout


def write_pdf(layout: QgsPrintLayout, path: str) -> bool:
    """Write a layout as PDF, with texts that can be searched; whether that succeeded."""
    settings = QgsLayoutExporter.PdfExportSettings()
    settings.textRenderFormat = Qgis.TextRenderFormat.AlwaysText
    return QgsLayoutExporter(layout).exportToPdf(path, settings) == QgsLayoutExporter.ExportResult.Success


def figures_of(scene: Workspace, dsm: QgsRasterLayer) -> list[tuple[str, str]]:
    """What the page says about a DSM: its images, cells, CRS, datum of heights and position."""
    from ..repm_qgis.geometry.vertical import PLACED, PLACED_TAG, TAG
    from ..repm_qgis.imagery.raster import opened

    with opened(dsm.source().split("|")[0]) as dataset:
        tags = dataset.GetMetadata()
    placed = tags.get(PLACED_TAG) in PLACED
    metres = QLocale().toString(dsm.rasterUnitsPerPixelX(), "g", 3)
    size = QLocale().toString(dsm.extent().width() * dsm.extent().height() / 1e6, "f", 2)
    span = period(scene.days) or _tr("date unknown")
    return [
        (_tr("Images"), f"{len(scene.images)}, {span}"),
        (_tr("Cells"), f"{metres} m"),
        (_tr("Extent"), f"{size} km²"),
        (_tr("CRS"), f"{dsm.crs().description()} ({dsm.crs().authid()})"),
        (_tr("Heights above"), tags.get(TAG) or dsm.crs().description()),
        (_tr("Position"), _tr("by control or a reference") if placed else _tr("as the images' RPCs have it")),
    ]


def _verdict(run: Optional[RunFacts]) -> str:
    """A run's verdict with its first sentences; "" where it has none."""
    if run is None or not run.verdict:
        return ""
    text = " ".join((run.verdict, run.text)).strip()
    return text if len(text) <= _VERDICT else f"{text[:_VERDICT].rsplit('. ', 1)[0]}. …"


def _show(item: QgsLayoutItem, layers: Sequence[QgsMapLayer], around: QgsRasterLayer) -> None:
    """Have a map show only these layers, and the whole of one."""
    if not isinstance(item, QgsLayoutItemMap):
        return
    crs, place = around.crs(), QgsRectangle(around.extent())
    if crs.isGeographic():
        crs = QgsProject.instance().crs()
        place = QgsCoordinateTransform(around.crs(), crs, QgsProject.instance()).transformBoundingBox(place)
    place.scale(_EDGE)
    item.setCrs(crs)
    item.setKeepLayerSet(True)
    item.setLayers(list(layers))
    item.zoomToExtent(place)


def _fill_legend(item: QgsLayoutItem, dsm: QgsRasterLayer) -> None:
    if isinstance(item, QgsLayoutItemLegend):
        root = item.model().rootGroup()
        root.clear()
        node: QgsLayerTreeLayer = root.addLayer(dsm)
        node.setUseLayerName(False)
        node.setName(_tr("Heights"))
        QgsMapLayerLegendUtils.setLegendNodeOrder(node, [1])  # without the name of the band
        item.model().refreshLayerLegend(node)
        item.adjustBoxSize()


def _fit_bar(item: QgsLayoutItem, shown: QgsLayoutItem) -> None:
    """A scale bar of two segments of a round length, about a third of the map's width."""
    if isinstance(item, QgsLayoutItemScaleBar) and isinstance(shown, QgsLayoutItemMap):
        item.setLinkedMap(shown)
        length = shown.extent().width() / 6.0
        power = 10.0 ** len(str(int(length))) / 10.0
        item.setUnitsPerSegment(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= max(length, power)))


def page_path(dsm: str) -> str:
    """Where a DSM's page is written: beside it, under a name that is free."""
    return free_path(f"{os.path.splitext(dsm)[0]}_page.pdf")
