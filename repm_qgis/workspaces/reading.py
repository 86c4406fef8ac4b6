"""A workspace as it lies there."""

from __future__ import annotations

import os

from .. import names
from ..contracts.errors import SceneError
from ..contracts.paths import real_path
from ..geometry.footprints import bounds_of_wkt
from ..geometry.sun import sun_position
from ..runtime.locks import owner_of
from ..scene import View, facts_of
from .facts import SCENES, ImageFacts, Workspace
from .places import is_remote
from .products import products_in
from .runs import runs_of


def is_workspace(folder: str) -> bool:
    """Whether a folder of this machine holds a scene under one of the names of a run."""
    return not is_remote(folder) and any(os.path.isfile(os.path.join(folder, name)) for name in SCENES)


def read_workspace(folder: str) -> Workspace:
    """What a workspace holds; of one that cannot be read, why that is."""
    folder = os.path.abspath(folder)
    title = names.folder_name(folder) or os.path.basename(folder)
    if is_remote(folder) or not os.path.isdir(folder):
        return Workspace(folder, title, problem=f"'{folder}' is not there: it was moved or removed.")
    writer = owner_of(folder)
    known = [os.path.join(folder, name) for name in SCENES]
    scene, problem, facts = "", "", None
    for path in known:
        if os.path.isfile(path):
            try:
                facts, scene, problem = facts_of(path), path, ""
                break
            except (SceneError, OSError) as error:
                problem = problem or str(error)
    if facts is None:
        problem = problem or f"'{folder}' holds no scene: its files were removed."
    images = tuple(map(_image, facts.views)) if facts else ()
    runs = tuple(runs_of(folder, facts))
    commanded = next((run.options for run in runs if run.stage == "pipeline" and run.options), {})
    products = products_in(folder, commanded, {real_path(image.path) for image in images if not image.remote})
    outline = bounds_of_wkt(facts.area) if facts else None
    return Workspace(
        folder=folder,
        title=title,
        scene=scene,
        bounds=(outline.xmin, outline.ymin, outline.xmax, outline.ymax) if outline else None,
        crs=facts.crs if facts else "",
        registered=bool(facts and any(entry.stage == "register" for entry in facts.history)),
        images=images,
        runs=runs,
        products=tuple(products),
        problem=problem,
        writer=writer,
    )


def _image(view: View) -> ImageFacts:
    remote = is_remote(view.image)
    sun = sun_position(view.time, view.rpc.lon_off, view.rpc.lat_off) if view.time is not None else None
    there = remote or os.path.exists(view.image)
    return ImageFacts(view.name, view.image, view.acquired, sun, there, remote)
