"""The base of all our algorithms: identity, help, early checks, running a stage, and styling its results.

An algorithm's parameters carry the names of the stage's options in upper case (repm_qgis/contracts/options.py), so a
subclass only declares itself: it reads nothing and computes nothing.
"""

from __future__ import annotations

import difflib
import os
from contextlib import suppress
from typing import Any, Callable

from qgis.core import (
    QgsApplication,
    QgsMapLayer,
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProcessingOutputFile,
    QgsProcessingOutputHtml,
    QgsProcessingOutputMultipleLayers,
    QgsProcessingOutputNumber,
    QgsProcessingOutputRasterLayer,
    QgsProcessingOutputVectorLayer,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterFile,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QCoreApplication, QUrl
from qgis.PyQt.QtGui import QIcon

from ..repm_qgis.contracts import results
from ..repm_qgis.contracts.documents import JsonMapping, JsonObject
from ..repm_qgis.contracts.options import PREVIEW
from ..repm_qgis.contracts.products import products_of
from ..repm_qgis.contracts.results import PipelineResult, Result
from ..repm_qgis.contracts.stages import STAGES, Stage
from ..repm_qgis.runtime.translation import written_in
from . import engine, helppages, last_scene, settings, styles
from .helptext import to_html
from .json_errors import errors_as_json, failure, write_error
from .kept import in_workspace
from .language import dialog_words, language, said
from .parameters import tr
from .values import absolute, checked_value, destination, input_options, is_empty, raster_items

PLUGIN_FOLDER = engine.PLUGIN_FOLDER
GROUPS = {
    "tools": "Preparation",
    "whole": "Images to DSM",
    "evaluation": "Evaluation",
    "derived": "Edits and terrain",
    "mosaic": "Mosaic",
    "cameras": "Stage by stage: pinhole cameras",
    "surface": "Stage by stage: surface",
}
"""The groups of the toolbox by their ids, in the order of the work."""
_OUTPUTS = {
    results.NUMBER: QgsProcessingOutputNumber,
    results.FILE: QgsProcessingOutputFile,
    results.PAGE: QgsProcessingOutputHtml,
    results.RASTER: QgsProcessingOutputRasterLayer,
    results.VECTOR: QgsProcessingOutputVectorLayer,
    results.LAYERS: QgsProcessingOutputMultipleLayers,
}


def group_title(group: str) -> str:
    """A group's title with its number: QGIS sorts groups by their titles, and algorithms by their names."""
    return f"{_place(group)} {QCoreApplication.translate(RepmAlgorithm.__name__, GROUPS[group])}"


def numbered(group: str, step: int, title: str) -> str:
    """An algorithm's name with its place in the order of the work."""
    return f"{_place(group)}.{step} {title}"


def _place(group: str) -> int:
    return list(GROUPS).index(group)


def resource(*parts: str) -> str:
    """The path of a file in resources/."""
    return os.path.join(PLUGIN_FOLDER, "resources", *parts)


def _taken_kinds(definition: QgsProcessingParameterDefinition) -> list[QgsProcessing.SourceType]:
    """The kinds of layers that a parameter takes; ``TypeMapLayer`` is any."""
    kinds = QgsProcessing.SourceType
    if definition.type() == "layer":
        return list(definition.dataTypes()) or [kinds.TypeMapLayer]
    return [definition.layerType() if definition.type() == "multilayer" else kinds.TypeRaster]


def _is_raster(path: str) -> bool:
    """Whether GDAL opens it; asked without QGIS, which would write statistics beside the file."""
    from ..repm_qgis.contracts.errors import ImageError
    from ..repm_qgis.imagery.raster import opened

    try:
        with opened(path):
            return True
    except ImageError:
        return False


class RepmAlgorithm(QgsProcessingAlgorithm):
    """One stage as a Processing algorithm. Subclasses fill in the constants and ``parameters``."""

    ID = ""  # also the stage's name and the help page's
    GROUP = "tools"
    STEP = 0  # the place in the group
    TAGS = ""
    HEAVY = True  # in a process of its own; also what other stages' bytes depend on
    USES_WORKERS = False

    def name(self) -> str:
        return self.ID

    def title(self) -> str:
        """The name without its number."""
        raise NotImplementedError

    def displayName(self) -> str:
        return numbered(self.GROUP, self.STEP, self.title())

    def group(self) -> str:
        return group_title(self.GROUP)

    def groupId(self) -> str:
        return self.GROUP

    def tags(self) -> list[str]:
        words = "DSM,DEM,stereo,satellite,RPC,photogrammetry,Pleiades,WorldView,pinhole," + self.TAGS
        return [word for word in words.split(",") if word]

    def icon(self) -> QIcon:
        return QIcon(self.svgIconPath())

    def svgIconPath(self) -> str:
        path = resource("icons", f"{self.ID}.svg")
        return path if os.path.exists(path) else resource("icons", "repm.svg")

    def shortHelpString(self) -> str:
        """The page in QGIS's language where there is one, else the English one."""
        for place in (resource("help", language()), resource("help")):
            with suppress(OSError), open(os.path.join(place, f"{self.ID}.md"), encoding="utf-8") as stream:
                return to_html(stream.read(), resource("help"))
        return self.shortDescription()

    def helpUrl(self) -> str:
        from ..repm_qgis.contracts.errors import WorkspaceError

        entries = [*self.parameterDefinitions(), *self.outputDefinitions()]
        more = {entry.name(): entry.help() for entry in self.parameterDefinitions()}
        labels = {each.name(): each.description() for each in entries}
        try:
            return helppages.page(self.ID, QgsApplication.locale() or "en", labels, more, self.title())
        except WorkspaceError:  # a profile where nothing can be written
            return QUrl.fromLocalFile(os.path.join(PLUGIN_FOLDER, "docs", "algorithms", f"{self.ID}.md")).toString()

    def createCustomParametersWidget(self, parent: object = None) -> Any:
        """Our dialog; QGIS's own where the Processing plugin's is not to be had."""
        try:
            from ..desktop.dialog import Dialog
        except ImportError:
            return None
        return Dialog(self, parent=parent)

    def createInstance(self) -> RepmAlgorithm:
        return type(self)()

    def tr(self, text: str) -> str:
        """The text in the user's language: as this algorithm has it, else as all have it."""
        own = QCoreApplication.translate(type(self).__name__, text)
        return own if own != text else QCoreApplication.translate(RepmAlgorithm.__name__, text)

    def stage(self) -> Stage[Any]:
        """The engine's stage: its options and its result."""
        return STAGES[self.ID]

    def parameters(self) -> list[QgsProcessingParameterDefinition]:
        """The parameters in the dialog's order; every call makes new ones."""
        raise NotImplementedError

    def initAlgorithm(self, configuration: object = None) -> None:  # noqa: N803
        self._words: Callable[[str], str] = str  # the dialog's, once a run is prepared
        for parameter in self.parameters():
            self.addParameter(parameter)
        for output in self.extra_outputs():
            self.addOutput(output)

    def extra_outputs(self) -> list:
        """Outputs that are no destination parameters: the fields of the stage's result that have a label."""
        fields = self.stage().result.outputs()
        return [_OUTPUTS[each.kind](name.upper(), tr(each.label)) for name, each in fields.items()]

    def checkParameterValues(self, parameters: JsonMapping, context: QgsProcessingContext) -> tuple[bool, str]:
        """Files and layers as QGIS knows them are checked here, all values by the engine's options."""
        problem = self._problem(parameters, context)
        fit = (False, dialog_words(self.ID)(problem)) if problem else super().checkParameterValues(parameters, context)
        if not fit[0]:
            write_error(fit[1], "OptionError")
        return fit

    def _problem(self, parameters: JsonMapping, context: QgsProcessingContext) -> str:
        """What is wrong with the parameters, "" where nothing is."""
        for definition in self.parameterDefinitions():
            problem = self._input_problem(definition, parameters.get(definition.name()), context)
            if problem:
                return problem
        from ..repm_qgis.contracts.errors import RepmError
        from ..repm_qgis.stages.collisions import require_writable
        from ..repm_qgis.stages.early import require_sensible

        given = {
            definition.name().lower(): checked_value(self, definition, parameters, context)
            for definition in self.parameterDefinitions()
            if definition.name().lower() not in self.left_to_engine(parameters)
        }
        given.update(self._area(parameters, context))
        try:
            options = self.stage().options.from_json(self.complete(given))
            require_writable(self.ID, options)
            engine.in_python_thread(lambda: require_sensible(options))
        except RepmError as error:
            write_error(said(str(error)), type(error).__name__)
            return said(str(error))
        return ""

    def _area(self, parameters: JsonMapping, context: QgsProcessingContext) -> JsonObject:
        """EXTENT as the engine takes it, where there is one: it says which part of the images will be read. QGIS itself
        refuses one that is no extent."""
        definition = self.parameterDefinition("EXTENT")
        value = None if definition is None else parameters.get("EXTENT")
        if is_empty(value) or not definition.checkValueIsAcceptable(value, context):
            return {}
        return input_options(self, definition, parameters, context)

    def _input_problem(
        self, definition: QgsProcessingParameterDefinition, value: object, context: QgsProcessingContext
    ) -> str:
        name = definition.name()
        if definition.isDestination():  # TABLE is an input of one algorithm, and a product of another
            return ""
        if name in ("RPCS", "MASKS", "CONFIDENCES", "GCPS", "PROFILES", "SCENES", "EDITS", "AREAS", "TABLE"):
            return self._check_files(name, value, context)
        if name in ("IMAGES", "XS"):
            return self._check_images(name, value, context)
        if name == "BACKEND":
            return self._check_backend(definition, value)
        if definition.type() == "file" and definition.behavior() == QgsProcessingParameterFile.Behavior.File:
            return self._check_file(definition, value)
        if definition.type() in ("raster", "multilayer", "layer") and not is_empty(value):
            return self._check_raster(definition, value, context)
        return ""

    def validateInputCrs(self, parameters: JsonMapping, context: QgsProcessingContext) -> bool:
        # Images in sensor geometry have no CRS to match, and QGIS would load each (and write statistics beside it).
        return True

    def _check_images(self, name: str, value: object, context: QgsProcessingContext) -> str:
        for item in raster_items(value, context):
            if isinstance(item, QgsMapLayer) and item.providerType() != "gdal":
                return self.tr(
                    "The layer '{layer}' of {name} comes from '{provider}': choose raster files, only they have RPCs."
                ).format(layer=item.name(), name=name, provider=item.providerType())
        return ""

    def _check_backend(self, definition: QgsProcessingParameterDefinition, value: object) -> str:
        """Whether a backend that was chosen by name can run: only the engine's interpreter can answer."""
        remedy = "" if is_empty(value) or value == definition.defaultValue() else engine.backend_remedy(str(value))
        if not remedy:
            return ""
        return self.tr("BACKEND is '{name}', which {remedy}; or choose auto.").format(name=value, remedy=said(remedy))

    def _check_file(self, definition: QgsProcessingParameterDefinition, value: object) -> str:
        if is_empty(value) or not isinstance(value, str):
            return ""
        if not os.path.exists(value):
            return self.tr("{name} '{path}' is not there: check its path.").format(name=definition.name(), path=value)
        if not value.lower().endswith(".json"):
            return self.tr(
                "{name} '{path}' is not a scene: choose the scene.json that the previous stage wrote."
            ).format(name=definition.name(), path=value)
        return ""

    def _check_files(self, name: str, value: object, context: QgsProcessingContext) -> str:
        from ..repm_qgis.files.vector import file_and_layer

        for item in raster_items(value, context):
            if isinstance(item, str) and not os.path.exists(file_and_layer(item)[0]):
                return self.tr("{name} '{path}' is not there: check its path.").format(name=name, path=item)
            if isinstance(item, QgsMapLayer) and not isinstance(item, QgsVectorLayer):
                return self.tr("The layer '{layer}' of {name} is a raster: choose a vector layer or a table.").format(
                    layer=item.name(), name=name
                )
        return ""

    def _check_raster(
        self, definition: QgsProcessingParameterDefinition, value: object, context: QgsProcessingContext
    ) -> str:
        """Files must be there, and be rasters where nothing else is taken; the engine reports errors of others."""
        from ..repm_qgis.contracts.file_kinds import is_cloud
        from ..repm_qgis.files.vector import file_and_layer

        name, kinds = definition.name(), _taken_kinds(definition)
        for item in (each for each in raster_items(value, context) if isinstance(each, str)):
            path = item if kinds == [QgsProcessing.SourceType.TypeRaster] else file_and_layer(item)[0]
            if not os.path.exists(path):
                return self.tr("{name} '{path}' is not there: check its path.").format(name=name, path=item)
            scene = name == "FIXED" and item.lower().endswith(".json")
            cloud = QgsProcessing.SourceType.TypePointCloud in kinds and is_cloud(item)
            if QgsProcessing.SourceType.TypeRaster in kinds and not (scene or cloud or _is_raster(item)):
                return self.tr("{name} '{path}' cannot be read as a raster: check that the file is complete.").format(
                    name=name, path=item
                )
        return ""

    @errors_as_json()
    def prepareAlgorithm(
        self, parameters: JsonMapping, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        known = [definition.name() for definition in self.parameterDefinitions()]
        for name in parameters:  # QGIS silently ignores a misspelt name in a command
            near = difflib.get_close_matches(name.upper(), known, 1)
            if name not in known and near:
                feedback.pushWarning(
                    self.tr("{name} is not a parameter of {id} and has no effect: do you mean {near}?").format(
                        name=name, id=self.id(), near=near[0]
                    )
                )
        self._inputs: JsonObject = {}
        self._words = dialog_words(self.ID)
        for definition in self.parameterDefinitions():
            if not definition.isDestination():
                self._inputs.update(input_options(self, definition, parameters, context))
        for name in self.left_to_engine(parameters):
            del self._inputs[name]
        if self.USES_WORKERS:
            self._inputs.update(workers=settings.workers(), memory=settings.memory())
        if "cluster" in self._inputs:
            self._inputs["cluster"] = self._inputs["cluster"] or settings.cluster()
        return True

    @errors_as_json()
    def processAlgorithm(
        self, parameters: JsonMapping, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> JsonObject:
        def processed() -> JsonObject:
            with in_workspace(self, parameters, self._inputs, context) as placed:
                return self._processed(placed, context, feedback)

        return engine.in_python_thread(processed)

    def _processed(
        self, parameters: JsonMapping, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> JsonObject:
        kept_as = {
            definition.name(): destination(self, definition, parameters, context)
            for definition in self.destinationParameterDefinitions()
        }
        options = dict(self._inputs)
        options.update({name.lower(): absolute(path) if path else None for name, path in kept_as.items()})
        result = self.run_stage(self.complete(options), feedback)
        fields = result.to_mapping()
        made = {output.name(): fields[output.name().lower()] for output in self.outputDefinitions()}
        # QGIS takes a product that was not made, and a figure that is unknown, for what is not in the results.
        outputs = {name: value for name, value in made.items() if value is not None}
        run = styles.Run(self._scene_name(options), self._days(options, fields))
        for product in products_of(self.ID):
            name = product.option.upper()
            if product.style and outputs.get(name):
                styles.style_layer(
                    context,
                    feedback,
                    kept_as=kept_as.get(name, ""),
                    path=outputs[name],
                    kind=product.style,
                    run=run,
                    title=tr(product.layer or product.title),
                    more=said(self._more(product.style, outputs[name], fields)),
                )
        self.show_more(context, outputs, kept_as, run)
        if isinstance(result, PipelineResult):
            feedback.pushInfo(
                self.tr("Seconds: {stages}").format(
                    stages=", ".join(f"{stage} {seconds:.1f}" for stage, seconds in result.seconds.items())
                )
            )
        lasts = options.get("preset") != PREVIEW  # the next stages take up the scene of a run
        self._scene = (outputs.get("OUTPUT_SCENE") or outputs.get("SCENE")) if lasts else None
        return outputs

    def show_more(
        self, context: QgsProcessingContext, outputs: JsonMapping, kept_as: dict[str, str], run: styles.Run
    ) -> None:
        """Have layers loaded that are no products; ``kept_as`` is QGIS's word for each product."""

    def _more(self, style: str, path: str, fields: JsonMapping) -> str:
        """What a layer's name has behind its scene: the datum of heights; of an error map the view, the altitude, and
        whether that is before or after the refinement."""
        if style == "error":
            from ..repm_qgis.stages.errormap import map_title

            return map_title(path)
        return str(fields.get("vertical_datum") or "") if style == "dsm" else ""

    def postProcessAlgorithm(self, context: QgsProcessingContext, feedback: QgsProcessingFeedback) -> JsonObject:
        if self._scene:
            last_scene.remember(self._scene)
        return super().postProcessAlgorithm(context, feedback)

    def left_to_engine(self, parameters: JsonMapping) -> set[str]:
        """The names of options whose values the engine chooses, as the user gave none."""
        return set()

    def complete(self, options: JsonObject) -> JsonObject:
        """The engine's options out of the parameters' values, where these are not the same."""
        return options

    def runs_apart(self, options: JsonMapping) -> bool:
        """Whether a run takes a process of its own, with the engine's own packages."""
        return self.HEAVY or bool(options.get("cluster"))

    def run_stage(self, options: JsonMapping, feedback: QgsProcessingFeedback) -> Result:
        run = engine.run_apart if self.runs_apart(options) else engine.run_here
        try:
            with engine.sigterm_cancels(feedback):
                return run(self.stage(), options, feedback, self._words)
        except QgsProcessingException as error:
            raise failure(self._words(str(error)), getattr(error, "kind", "Error")) from None

    def _scene_name(self, options: JsonMapping) -> str:
        """The scene that a run belongs to, "" where its files and folders do not name it."""
        from ..repm_qgis import names
        from ..repm_qgis.scene import is_registered

        preset = ""
        scene, images, dsm = (options.get(name) for name in ("scene", "images", "dsm"))
        if scene:
            name, registered = names.scene_name(scene), is_registered(scene)
        elif images:
            name = names.run_name(options.get("workspace") or "", options.get("output") or "", images)
            registered, preset = bool(options.get("reference")), str(options.get("preset", ""))
        elif dsm:
            name, registered = names.surface_name(dsm), names.is_of_registered(dsm)
        else:
            return ""
        with written_in(language()):
            return names.marked(name, registered, preset)

    def _days(self, options: JsonMapping, result: JsonMapping) -> list[str]:
        """The days on which the images of a run were taken, as far as they are known."""
        from ..repm_qgis.names import surface_days
        from ..repm_qgis.scene import days

        scene = result.get("scene") or result.get("output_scene") or options.get("scene")
        if scene:
            return days(scene)
        return surface_days(options["dsm"]) if options.get("dsm") else []
