"""The stages: options in, products out. Each module has ``run(options, progress)``, which returns its result
(:mod:`repm_qgis.contracts.results`).

The names in :data:`STAGES` are those of the Processing algorithms and of ``python -m repm_qgis STAGE JOB.json``.
"""

from __future__ import annotations

import importlib
import os
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, Callable, ContextManager, Iterator, Mapping, Optional, Union, overload

from ..contracts.errors import MissingPackageError, OptionError
from ..contracts.formats import companions
from ..contracts.options import Options
from ..contracts.products import BUILT_FOLDER, FOLDER, PIPELINE, SCENE, paths_of, scene_files
from ..contracts.results import Result
from ..contracts.stages import STAGES, R, Stage
from ..runtime.imports import require_fitting_numpy, show_proj_its_data
from ..runtime.locks import exclusive
from ..runtime.progress import Progress, Recorder
from ..runtime.shortage import shortage_as_error
from ..runtime.spare_cores import spare_cores
from ..runtime.together import together
from ..runtime.workspace import following_links_of

if TYPE_CHECKING:  # QGIS needs the options only
    from .parameters import EngineParameters

__all__ = ["STAGES", "run_stage"]


@overload
def run_stage(
    stage: Stage[R], options: Mapping[str, object], progress: Progress, parameters: Optional[EngineParameters] = None
) -> R: ...
@overload
def run_stage(
    stage: str, options: Mapping[str, object], progress: Progress, parameters: Optional[EngineParameters] = None
) -> Result: ...
@shortage_as_error()
def run_stage(
    stage: Union[Stage[Any], str],
    options: Mapping[str, object],
    progress: Progress,
    parameters: Optional[EngineParameters] = None,
) -> Result:
    """Run a stage, or the one of a name, with options as a JSON object; returns its result.

    ``parameters`` are for studies of the pipeline and its stages, which keep what differs from the defaults in their
    fingerprints and scenes. Raises OptionError for an unknown stage or a bad option, OutOfMemoryError, and whatever
    RepmError the stage raises.
    """
    from ..runtime.parallel import require_main
    from ..runtime.process_limits import one_thread_for_loaded_sums

    require_main()
    name = stage if isinstance(stage, str) else stage.name
    show_proj_its_data()
    with following_links_of(_texts(options)), one_thread_for_loaded_sums():
        return _run(name, options, progress, parameters)


def _texts(options: object) -> Iterator[str]:
    """All texts of a job: some of them are paths that the user has named."""
    if isinstance(options, str):
        yield options
    elif isinstance(options, Mapping):
        for value in options.values():
            yield from _texts(value)
    elif isinstance(options, (list, tuple)):
        for value in options:
            yield from _texts(value)


def _run(
    name: str, options: Mapping[str, object], progress: Progress, parameters: Optional[EngineParameters]
) -> Result:
    if name not in STAGES:
        raise OptionError("stage", name, f"must be one of {', '.join(STAGES)}")
    checked = STAGES[name].options.from_json(options)
    if name != "environment":  # which reports it
        require_fitting_numpy()
    from .collisions import require_distinct, require_writable

    require_distinct(name, checked)
    require_writable(name, checked)
    from .early import require_sensible
    from .voids import name_voids

    if parameters is None:
        require_sensible(checked)
    else:
        require_sensible(checked, parameters)
    run: Callable[..., Result] = importlib.import_module(f"{__name__}.{name}").run
    folders, files = _written(name, checked)
    products, shared = provisional(name, checked)
    workers = _workers_for(name, checked, progress)
    with exclusive(name, progress, folders, files), together(products, shared), workers, _spare(checked):
        progress = Recorder(progress)
        name_voids(checked, progress)
        return run(checked, progress) if parameters is None else run(checked, progress, parameters)


def _spare(options: Options) -> ContextManager[None]:
    """The cores beside this one that a stage may use where it runs no tasks."""
    from ..runtime.parallel import cores

    named: list[int] = [getattr(part, "workers", 0) for part in options.parts()]
    return spare_cores((max(named) or cores()) - 1)


def _written(name: str, options: Options) -> tuple[list[str], list[str]]:
    """The folders and files that two runs of stages must not write at the same time: workspaces, scenes, outputs."""
    made = list(paths_of(name, options))
    folders = [path for product, path in made if product.option == "workspace"]
    folders += [os.path.dirname(path) or "." for product, path in made if product.form == SCENE]
    return folders, [path for product, path in made if product.option == "output"]


def provisional(name: str, options: Options) -> tuple[list[str], list[str]]:
    """What appears together at a run's end: files and folders, and folders of which what the run writes there does.
    They are all products with what belongs to them, and the scene; but none of the pipeline's scenes and their folders,
    where the next run continues."""
    scenes = [os.path.join(os.path.abspath(folder), "") for folder in _written(name, options)[0]]
    paths, folders = list(scene_files(name, options)), []
    if name == "refine":
        folders = [f"{os.path.splitext(paths[0])[0]}_refined"]
    for product, path in paths_of(name, options):
        early = product.stage in PIPELINE[:-1]
        kept = name == "pipeline" and early and os.path.abspath(path).startswith(tuple(scenes))
        if product.form == FOLDER:
            folders += [] if early else [path]
        elif product.form != SCENE and not kept:
            paths.append(path)
            if product.form != BUILT_FOLDER:
                paths += companions(product, path)
    return list(dict.fromkeys(paths)), folders


def _workers_for(name: str, options: Options, progress: Progress) -> ContextManager[None]:
    """The workers of the cluster that the options name; this machine's come by themselves."""
    named: list[str] = [getattr(part, "cluster", "") for part in options.parts()]
    address = next(filter(None, named), "")
    if not address:
        return nullcontext()
    try:
        from ..runtime.cluster import cluster_workers
    except ImportError as error:
        remedy = "run 'bash scripts/setup --cluster' in the plugin's folder, or leave CLUSTER empty"
        raise MissingPackageError(f"CLUSTER needs the Python package 'distributed' ({error}): {remedy}.") from error
    made = list(paths_of(name, options))
    for option, path in [*options.read_paths(), *((product.option, path) for product, path in made)]:
        if not os.path.isabs(path) and os.path.exists(os.path.dirname(path) or "."):
            reason = "must be an absolute path where CLUSTER is used: its workers have other working folders"
            raise OptionError(option.upper(), path, reason)
    folders = {path if product.form == FOLDER else os.path.dirname(path) for product, path in made}
    return cluster_workers(address, [path for _, path in options.read_paths()], sorted(folders), progress)
