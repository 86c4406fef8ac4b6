"""The stages: options in, products out. Each module has ``run(options, progress) -> dict`` with JSON-able results.

The names here are those of the Processing algorithms and of ``python -m repm_qgis STAGE JOB.json``.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any, Callable, Mapping, Optional

from .. import options as _options
from ..errors import OptionError
from ..locks import exclusive
from ..products import SCENE, paths_of
from ..progress import Progress
from ..shortage import said_in_a_sentence

if TYPE_CHECKING:  # QGIS asks for the options alone
    from .parameters import EngineParameters

STAGES: dict[str, type[_options.Options]] = {
    "epmfit": _options.EpmFitOptions,
    "errormap": _options.ErrorMapOptions,
    "refine": _options.RefineOptions,
    "exportcameras": _options.ExportCamerasOptions,
    "reconstruct": _options.ReconstructOptions,
    "dsmfuse": _options.DsmFuseOptions,
    "pipeline": _options.PipelineOptions,
    "comparedsm": _options.CompareDsmOptions,
    "checkgcps": _options.CheckGcpsOptions,
    "sampledata": _options.SampleDataOptions,
    "environment": _options.EnvironmentOptions,
}


@said_in_a_sentence()
def run_stage(
    name: str, options: Mapping[str, Any], progress: Progress, parameters: Optional[EngineParameters] = None
) -> dict[str, Any]:
    """Run a stage by name with options as a JSON object, and give its results as a JSON object.

    ``parameters`` are for studies of the pipeline and its stages, which keep what differs from the defaults in their
    fingerprints and scenes. Raises OptionError for an unknown stage or a bad option, OutOfMemoryError, and whatever
    RepmError the stage raises.
    """
    if name not in STAGES:
        raise OptionError("stage", name, f"must be one of {', '.join(STAGES)}")
    checked = STAGES[name].from_json(options)
    from .collisions import require_distinct

    require_distinct(name, checked)
    run: Callable[..., dict[str, Any]] = importlib.import_module(f"{__name__}.{name}").run
    with exclusive(name, progress, *_written(name, checked)):
        return run(checked, progress) if parameters is None else run(checked, progress, parameters)


def _written(name: str, options: _options.Options) -> tuple[list[str], list[str]]:
    """The folders and files that two runs of stages must not write at the same time: workspaces, scenes, outputs."""
    made = list(paths_of(name, options))
    folders = [path for product, path in made if product.option == "workspace"]
    folders += [os.path.dirname(path) or "." for product, path in made if product.form == SCENE]
    return folders, [path for product, path in made if product.option == "output"]
