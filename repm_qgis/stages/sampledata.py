"""Make a truth scene: simulated satellite images of a known surface, its DSM and control points."""

from __future__ import annotations

from ..contracts.options import SampleDataOptions
from ..contracts.results import SampleDataResult
from ..runtime.progress import Progress
from ..simulation.scene import SceneSpec, make_scene


def run(options: SampleDataOptions, progress: Progress) -> SampleDataResult:
    """Write the scene into ``options.folder``.

    Raises WorkspaceError if the folder cannot be written.
    """
    spec = SceneSpec.default(options.kind, options.size, options.seed)
    result = make_scene(spec, options.folder, progress)
    images = f"{len(result.images)} images of {options.size} x {options.size} px"
    progress.info(f"{images}; the RPCs are within {result.rpc_fit_max_px:.1e} px of the simulated sensor.")
    return result
