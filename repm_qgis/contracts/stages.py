"""The stages: the name of each, its options and its result. A name is that of the Processing algorithm, too.

``run_stage(COMPAREDSM, ...)`` returns what :class:`Stage` says, so that a checker of types follows each figure from the
stage that computes it to whoever reads it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Generic, Type, TypeVar

from . import options, results

R = TypeVar("R", bound=results.Result)


@dataclass(frozen=True)
class Stage(Generic[R]):
    """A stage: its name, and the classes of its options and of its result."""

    name: str
    options: Type[options.Options]
    result: Type[R]


INSPECT = Stage("inspect", options.InspectOptions, results.InspectResult)
EPMFIT = Stage("epmfit", options.EpmFitOptions, results.EpmFitResult)
ERRORMAP = Stage("errormap", options.ErrorMapOptions, results.ErrorMapResult)
REFINE = Stage("refine", options.RefineOptions, results.RefineResult)
EXPORTCAMERAS = Stage("exportcameras", options.ExportCamerasOptions, results.ExportCamerasResult)
EXPORTRPC = Stage("exportrpc", options.ExportRpcOptions, results.ExportRpcResult)
RECONSTRUCT = Stage("reconstruct", options.ReconstructOptions, results.ReconstructResult)
REGISTER = Stage("register", options.RegisterOptions, results.RegisterResult)
DSMFUSE = Stage("dsmfuse", options.DsmFuseOptions, results.DsmFuseResult)
PIPELINE = Stage("pipeline", options.PipelineOptions, results.PipelineResult)
BATCH = Stage("batch", options.BatchOptions, results.BatchResult)
MOSAIC = Stage("mosaic", options.MosaicOptions, results.MosaicResult)
DTM = Stage("dtm", options.DtmOptions, results.DtmResult)
BUILDINGS = Stage("buildings", options.BuildingsOptions, results.BuildingsResult)
EDITDSM = Stage("editdsm", options.EditDsmOptions, results.EditDsmResult)
COMPAREDSM = Stage("comparedsm", options.CompareDsmOptions, results.CompareDsmResult)
CHANGE = Stage("change", options.ChangeOptions, results.ChangeResult)
SERIES = Stage("series", options.SeriesOptions, results.SeriesResult)
CHECKGCPS = Stage("checkgcps", options.CheckGcpsOptions, results.CheckGcpsResult)
VIEWER = Stage("viewer", options.ViewerOptions, results.ViewerResult)
TILES3D = Stage("tiles3d", options.Tiles3dOptions, results.Tiles3dResult)
SAMPLEDATA = Stage("sampledata", options.SampleDataOptions, results.SampleDataResult)
ENVIRONMENT = Stage("environment", options.EnvironmentOptions, results.EnvironmentResult)

STAGES: Dict[str, Stage[Any]] = {
    stage.name: stage
    for stage in (
        INSPECT,
        EPMFIT,
        ERRORMAP,
        REFINE,
        EXPORTCAMERAS,
        EXPORTRPC,
        RECONSTRUCT,
        REGISTER,
        DSMFUSE,
        PIPELINE,
        BATCH,
        MOSAIC,
        DTM,
        BUILDINGS,
        EDITDSM,
        COMPAREDSM,
        CHANGE,
        SERIES,
        CHECKGCPS,
        VIEWER,
        TILES3D,
        SAMPLEDATA,
        ENVIRONMENT,
    )
}
"""All stages by their names, in the order of the toolbox."""
