"""Make a truth scene: simulated satellite images of a known surface, its DSM and control points."""

from __future__ import annotations

from ..contracts.documents import JsonObject
from ..contracts.options import SampleDataOptions
from ..runtime.progress import Progress
from ..simulation.scene import SceneSpec, make_scene


def run(options: SampleDataOptions, progress: Progress) -> JsonObject:
    """Write the scene into ``options.folder``.

    Returns ``folder``, ``images`` (paths), ``truth`` (GeoTIFF), ``gcps`` (CSV) and ``rpc_fit_max_px``, how far the
    RPCs are from the simulated sensor before their pointing errors are added. Raises WorkspaceError if the folder
    cannot be written.
    """
    spec = SceneSpec.default(options.kind, options.size, options.seed)
    result: JsonObject = make_scene(spec, options.folder, progress)
    images = f"{len(result['images'])} images of {options.size} x {options.size} px"
    progress.info(f"{images}; the RPCs are within {result['rpc_fit_max_px']:.1e} px of the simulated sensor.")
    return result
