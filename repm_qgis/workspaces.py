"""What a workspace holds, as plain data for people who look at it: images, runs, products.

Scenes, reports and files are read as they lie there, and nothing is kept elsewhere. A workspace may come from anybody:
what does not fit is left out, paths that lead out of it or to the network are shown as they are and never opened, and
nothing outside is ever removed.
"""

from __future__ import annotations

import html
import os
import re
import shlex
import shutil
import stat
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from . import names
from .contracts.checks import INLINE
from .contracts.errors import OptionError, SceneError, WorkspaceError, reason_of
from .contracts.formats import companions
from .contracts.options import PRESETS, PipelineOptions
from .contracts.paths import real_path
from .contracts.products import (
    BUILT_FOLDER,
    FOLDER,
    OF_SCENES,
    POINTS,
    POLYGONS,
    PRODUCTS,
    RASTER,
    SCENE,
    Product,
    products_of,
    stem_of,
)
from .contracts.records import StageRecord
from .contracts.stages import STAGES
from .files.untrusted import refusal_of
from .geometry.footprints import bounds_of_wkt
from .geometry.sun import sun_position
from .runtime.locks import exclusive, owner_of
from .runtime.progress import Silent
from .scene import SceneFacts, View, facts_of

SCENES = ("registered.json", "reconstructed.json", "refined.json", "scene.json")
"""The scenes of a workspace, the most advanced first."""
_MOST_ENTRIES = 2000  # of a folder that are looked at
_MOST_FILES = 50_000  # of a product's folder that are counted
_HEAD_BYTES, _TAIL_BYTES = (
    64 << 10,
    512 << 10,
)  # of a report that are read: its verdict, and the command behind pictures
_MOST_WORDS = 20_000  # of a command
_OWN_PAGES = ("equivalent_error.html", "refinement.html", "reconstruction.html")  # of the stages of a whole run
_NOT_TAKEN = ("cluster", "workers", "memory", "command")  # of a record: where a run computes is this user's choice
_NUMBER = re.compile(r"_\d{1,4}$")
_RASTERS = (".tif", ".tiff", ".vrt", ".img", ".jp2", ".asc")
_SHAPES = (".gpkg", ".shp", ".geojson", ".fgb")
_VERDICT = re.compile(
    r'<div class="warning( good)?" role="note"><strong>([^<]{1,200})</strong>(.{0,20000}?)</div>', re.DOTALL
)
_OF_SCENE = re.compile(r"^tiles\.|_tie_points\.")  # which stages to come read, and the report links
_WORD = re.compile(r'(?:[^\s"]|"[^"]*")+')
_REMOTE = re.compile(r"\s*(?:/vsi|[\\/]{2}|\w[\w+.-]+:(?:/|\w{2}))", re.IGNORECASE)

Value = Union[str, float, bool, Tuple[str, ...]]


class ImageFacts(NamedTuple):
    """An image of a scene: when it was taken (ISO 8601, UTC; "" unknown), the sun's azimuth and elevation in degrees
    (None: unknown), and whether its file is there; of a ``remote`` one nobody has looked."""

    name: str
    path: str
    acquired: str
    sun: Optional[Tuple[float, float]]
    there: bool
    remote: bool


class ProductFacts(NamedTuple):
    """A product with the bytes that it and what belongs to it take; ``removable``: the workspace holds it itself,
    without a link that leads out of it, and the scene does not need it."""

    product: Product
    path: str
    size: int
    there: bool
    removable: bool


@dataclass(frozen=True)
class RunFacts:
    """A run, by its report: when that was written (seconds since 1970), the heading of its ``verdict`` in the report's
    language ("" where it has none), whether that is ``good``, what it says, and the values of the run's options where
    they are recorded; ``differing``: the options that are not the defaults, in words."""

    title: str
    report: str
    time: float
    verdict: str = ""
    good: bool = False
    text: str = ""
    stage: str = ""
    options: Mapping[str, Value] = field(default_factory=dict)
    differing: Tuple[str, ...] = ()


@dataclass(frozen=True)
class Workspace:
    """A folder with a scene; ``problem`` says why its scene cannot be read, ``writer`` who is writing in it now."""

    folder: str
    title: str
    scene: str = ""
    bounds: Optional[Tuple[float, float, float, float]] = None
    crs: str = ""
    registered: bool = False
    images: Tuple[ImageFacts, ...] = ()
    runs: Tuple[RunFacts, ...] = ()
    products: Tuple[ProductFacts, ...] = ()
    problem: str = ""
    writer: str = ""

    def product(self, stage: str, option: str = "output") -> Optional[ProductFacts]:
        """The first product of a kind that is there."""
        return next((each for each in self.products if _is(each, stage, option) and each.there), None)


def _is(made: ProductFacts, stage: str, option: str) -> bool:
    return (made.product.stage, made.product.option) == (stage, option)


def is_workspace(folder: str) -> bool:
    """Whether a folder of this machine holds a scene under one of the names of a run."""
    return not is_remote(folder) and any(os.path.isfile(os.path.join(folder, name)) for name in SCENES)


def is_remote(path: str) -> bool:
    """Whether a path may lead to the network, or is no plain path: nobody looks there before the user asks for it."""
    return bool(_REMOTE.match(path)) or path.lstrip().startswith(INLINE)


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
    runs = tuple(_runs(folder, facts))
    commanded = next((run.options for run in runs if run.stage == "pipeline" and run.options), {})
    products = _products(folder, commanded, {real_path(image.path) for image in images if not image.remote})
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


# --- runs ---


def _runs(folder: str, facts: Optional[SceneFacts]) -> Iterator[RunFacts]:
    """The runs of a workspace, the newest first; without a report of a whole run, the scene's own record."""
    pages = [entry for entry in _entries(folder) if entry.name.lower().endswith(".html") and entry.is_file()]
    names_there = {entry.name for entry in pages}
    found = []
    for entry in pages:
        if entry.name in _OWN_PAGES and "report.html" in names_there:
            continue
        run = _run_of_report(entry.path, folder, facts)
        if run is not None:
            found.append(run)
    if "report.html" not in names_there and facts is not None and facts.history:
        options = _recorded(facts, folder)
        time = max((os.path.getmtime(path) for path in _existing(folder)), default=0.0)
        found.append(RunFacts("", "", time, stage="pipeline", options=options, differing=_differing(options)))
    yield from sorted(found, key=lambda run: -run.time)


def _existing(folder: str) -> List[str]:
    return [path for path in (os.path.join(folder, name) for name in SCENES) if os.path.exists(path)]


def _run_of_report(path: str, folder: str, facts: Optional[SceneFacts]) -> Optional[RunFacts]:
    """A run by its report; None for a page that is no report of ours."""
    try:
        with open(path, "rb") as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                return None
            head = stream.read(_HEAD_BYTES).decode("utf-8", "replace")
            size = os.fstat(stream.fileno()).st_size
            stream.seek(max(0, size - _TAIL_BYTES))
            tail, time = stream.read(_TAIL_BYTES).decode("utf-8", "replace"), os.fstat(stream.fileno()).st_mtime
    except OSError:
        return None
    title = re.search(r"<h1>([^<]{1,400})</h1>", head)
    if title is None or "<footer>REPM" not in tail:
        return None
    said = _VERDICT.search(head)
    commanded = _commanded(tail, "pipeline")
    whole = os.path.basename(path) == "report.html" or bool(commanded)
    options: Dict[str, Value] = {}
    if whole:
        recorded = _recorded(facts, folder) if facts is not None else {}
        options = {**recorded, **_moved(commanded, folder)}
    return RunFacts(
        title=html.unescape(title.group(1)).strip(),
        report=path,
        time=time,
        verdict=html.unescape(said.group(2)).strip() if said else "",
        good=bool(said and said.group(1)),
        text=_as_text(said.group(3)) if said else "",
        stage="pipeline" if whole else "",
        options=options,
        differing=_differing(options),
    )


def _as_text(part: str) -> str:
    """The text of a piece of a page, one line for each of its items."""
    lines = html.unescape(re.sub(r"<[^>]*>", "", part.replace("</li>", "\n"))).splitlines()
    return "\n".join(filter(None, (" ".join(line.split()) for line in lines)))


def _commanded(page: str, stage: str) -> Dict[str, Value]:
    """The options of the command that a report shows, as texts; empty where it shows none of this stage."""
    shown = re.search(r"<pre>(qgis_process [^<]{1,300000})</pre>", page)
    return options_of_command(html.unescape(shown.group(1)), stage) if shown else {}


def options_of_command(command: str, stage: str) -> Dict[str, Value]:
    """The options of a ``qgis_process`` command of a stage, as texts; empty for any other text. Nothing is run."""
    try:
        if "\\" in command and "'" not in command:  # as Windows quotes
            words = [word.replace('"', "") for word in _WORD.findall(command)]
        else:
            words = shlex.split(command)
    except ValueError:
        return {}
    if words[:4] != ["qgis_process", "run", f"repm:{stage}", "--"] or len(words) > _MOST_WORDS:
        return {}
    known = set(STAGES[stage].options.names())
    values: Dict[str, List[str]] = {}
    for word in words[4:]:
        name, mark, value = word.partition("=")
        if mark and name.lower() in known and name.lower() not in _NOT_TAKEN:
            values.setdefault(name.lower(), []).append(value)
    return {name: tuple(each) if len(each) > 1 else each[0] for name, each in values.items()}


def _recorded(facts: SceneFacts, folder: str) -> Dict[str, Value]:
    """The options of the stages in a scene's history, as those of a whole run: what differs from the defaults."""
    known = {*PipelineOptions.names()} - {*_NOT_TAKEN, "workspace"}
    values: Dict[str, Value] = {}
    for entry in facts.history:
        for name, value in _plain_options(entry).items():
            if name in known and name not in ("report", "tiles", "tie_points") and not _is_default(name, value):
                values[name] = value
        extent, crs = entry.options.get("extent"), entry.options.get("extent_crs")
        if isinstance(extent, (list, tuple)) and len(extent) == 4:  # as commands have it
            values["extent"] = "{0},{2},{1},{3} [{4}]".format(*extent, crs)
    values.pop("extent_crs", None)
    values["images"] = tuple(view.image for view in facts.views)
    return _moved(values, folder, facts.folder)


def _plain_options(entry: StageRecord) -> Dict[str, Value]:
    """Those options of a record that are texts, numbers, switches or lists of them, which is all that there are."""
    found: Dict[str, Value] = {}
    for name, value in entry.options.items():
        if isinstance(value, (str, int, float)):
            found[name] = value
        elif isinstance(value, (list, tuple)) and value and all(isinstance(each, (str, int, float)) for each in value):
            found[name] = tuple(map(str, value))
    return found


def _moved(values: Mapping[str, Value], folder: str, before: str = "") -> Dict[str, Value]:
    """The options of a run in a workspace that may have been elsewhere ``before``; without products that would lie
    outside, and without whatever leads to the network."""
    before = before or str(values.get("workspace") or "")
    outputs = {each.option for each in products_of("pipeline")} - {"workspace"}
    found: Dict[str, Value] = {}
    for name, value in values.items():
        given = (value,) if isinstance(value, str) else value if isinstance(value, tuple) else ()
        texts = [_relocated(each, before, folder) for each in given]
        if any(map(is_remote, texts)):
            continue
        if name in outputs and not all(_lies_in(folder, each) for each in texts):
            continue
        found[name] = value if not texts else tuple(texts) if isinstance(value, tuple) else texts[0]
    if found:
        found["workspace"] = folder
    return found


def _relocated(path: str, before: str, folder: str) -> str:
    """A path that lay in a folder ``before``, where the folder is now."""
    text, old = path.replace("\\", "/"), before.replace("\\", "/").rstrip("/")
    if old and (text == old or text.startswith(f"{old}/")):
        return os.path.join(folder, *filter(None, text[len(old) :].split("/")))
    return path


def safe_inputs(options: Mapping[str, Value]) -> Dict[str, Value]:
    """The options of a recorded run without files that must not be opened: those that lead to the network, are no
    absolute paths, or are refused by :func:`~repm_qgis.files.untrusted.refusal_of`."""
    read = {name for name in PipelineOptions.names() if PipelineOptions.option(name).metadata.get("read")}
    found: Dict[str, Value] = {}
    for name, value in options.items():
        if name in read and isinstance(value, (str, tuple)):
            files = (value,) if isinstance(value, str) else value
            kept = tuple(each for each in files if os.path.isabs(each) and not is_remote(each) and not refusal_of(each))
            if name == "images" or len(kept) == len(files):
                found[name] = kept if isinstance(value, tuple) or name == "images" else kept[0]
        else:
            found[name] = value
    return found


def _default(name: str) -> object:
    try:
        return PipelineOptions.default_of(name)
    except StopIteration:
        return None


def _is_default(name: str, value: object) -> bool:
    """Whether a value is an option's default, as a number or as text."""
    default = _default(name)
    if value in (default, None, "", "None") or (value == () and not default):
        return True
    if isinstance(default, bool):
        return str(value).lower() == str(default).lower()
    if isinstance(default, (int, float)):
        with suppress(ValueError, TypeError):
            return float(value) == float(default)  # type: ignore[arg-type]
    return bool(name == "extent_crs" or (default is None and value in (0, "0")))


def _differing(options: Mapping[str, Value]) -> Tuple[str, ...]:
    """The options that are not the defaults, but for images and products."""
    left_out = {each.option for each in products_of("pipeline")} | {"images", "workspace", "extent_crs"}
    preset = PRESETS.get(str(options.get("preset", "none")), {})
    found = []
    for name, value in options.items():
        if name in left_out or _is_default(name, value) or str(preset.get(name, "")) == str(value):
            continue
        text = ", ".join(map(os.path.basename, value)) if isinstance(value, tuple) else str(value)
        if os.path.isabs(text):
            text = os.path.basename(text)
        found.append(f"{name.upper()} {text}"[:200])
    return tuple(found)


# --- products ---


def _products(folder: str, commanded: Mapping[str, Value], images: set[str]) -> List[ProductFacts]:
    """The products of a workspace, in the order of ``PRODUCTS``: those that a run was asked for, and those with their
    usual names."""
    found: Dict[str, ProductFacts] = {}
    for each in products_of("pipeline"):
        path = commanded.get(each.option)
        if isinstance(path, str) and each.option not in ("workspace", "report") and os.path.isabs(path):
            found[real_path(path)] = _facts(folder, each, path)
    for entry in _entries(folder):
        product = _product_of(entry)
        real = real_path(entry.path)
        if product is not None and real not in found and real not in images:
            found[real] = _facts(folder, product, entry.path)
    order = {(each.stage, each.option): number for number, each in enumerate(PRODUCTS)}
    first = order["dsmfuse", "output"]

    def place(made: ProductFacts) -> Tuple[bool, int, str]:
        number = order[made.product.stage, made.product.option]
        return number < first, number, made.path

    return sorted(found.values(), key=place)


def _entries(folder: str) -> List[os.DirEntry[str]]:
    """What lies in a folder, by names, without hidden files, links out of it, pipes and devices."""
    try:
        with os.scandir(folder) as listed:
            some = [entry for _, entry in zip(range(_MOST_ENTRIES), listed)]
    except OSError:
        return []
    plain = (entry for entry in some if not entry.name.startswith(".") and not entry.is_symlink())
    return sorted((entry for entry in plain if entry.is_file() or entry.is_dir()), key=lambda entry: entry.name)


def _product_of(entry: os.DirEntry[str]) -> Optional[Product]:
    """The product that has the name of a file or folder; None where that is no product's."""
    name, end = os.path.splitext(entry.name) if entry.is_file() else (entry.name, "")
    name, end = _NUMBER.sub("", name).lower(), end.lower()
    best: Tuple[int, Optional[Product]] = (0, None)
    for each in PRODUCTS:
        if each.option in ("workspace", "report", "heights" if each.stage == "reconstruct" else ""):
            continue
        own = each.option if each.option in ("tiles", "tie_points") else stem_of(each.stage, each)
        if not _has_form(each, end, entry.is_dir()):
            continue
        if name == own or name.endswith(f"_{own}"):
            length = len(own)
        else:  # such as dsm_registered
            length = 1 if each.stage in OF_SCENES and name.startswith(f"{own}_") else 0
        if length > best[0]:
            best = (length, each)
    return best[1]


def _has_form(product: Product, end: str, is_folder: bool) -> bool:
    if product.form in (FOLDER, BUILT_FOLDER) or is_folder:
        return is_folder and product.form in (FOLDER, BUILT_FOLDER) and product.stage != "sampledata"
    if product.form == SCENE:
        return False
    if product.form == RASTER:
        return end in _RASTERS
    if product.form in (POINTS, POLYGONS):
        return end in _SHAPES
    return end in re.findall(r"\*(\.\w+)", product.filter)


def _facts(folder: str, product: Product, path: str) -> ProductFacts:
    removable = _lies_in(folder, path) and not _OF_SCENE.search(os.path.basename(path))
    there = not is_remote(path) and os.path.lexists(path)
    size = sum(map(_size, _belonging(product, path))) if there else 0
    return ProductFacts(product, path, size, there, removable)


def _belonging(product: Product, path: str) -> List[str]:
    """The files of a product: its own, and those beside it."""
    beside: List[str] = []
    if product.form not in (FOLDER, BUILT_FOLDER):
        with suppress(KeyError, OptionError):  # a format that this product is not written in
            beside = companions(product, path)
    return [each for each in dict.fromkeys((path, *beside)) if os.path.lexists(each)]


def _size(path: str) -> int:
    """The bytes of a file, or of all files in a folder."""
    total = 0
    with suppress(OSError):
        if os.path.islink(path) or not os.path.isdir(path):
            return os.lstat(path).st_size
        count = 0
        for place, _, files in os.walk(path):
            for name in files:
                count += 1
                if count > _MOST_FILES:
                    return total
                with suppress(OSError):
                    total += os.lstat(os.path.join(place, name)).st_size
    return total


def _lies_in(folder: str, path: str) -> bool:
    """Whether a path is below a folder, links followed, and is no link itself."""
    if is_remote(path) or not os.path.isabs(path) or os.path.islink(path):
        return False
    return real_path(path).startswith(os.path.join(real_path(folder), ""))


class _Impatient(Silent):
    """Does not wait for a lock."""

    def check_cancelled(self) -> None:
        raise WorkspaceError("The workspace is in use by another run: remove products when that has ended.")


def remove_products(folder: str, products: Sequence[ProductFacts]) -> List[str]:
    """Remove products with what belongs to them; gives the paths removed.

    Raises WorkspaceError where another run writes in the workspace, where something else than a product in it is
    named, and where a file cannot be removed.
    """
    removed = []
    with exclusive("remove", _Impatient(), [folder]):
        for made in products:
            if not (made.removable and _lies_in(folder, made.path)):
                raise WorkspaceError(
                    f"'{made.path}' is not a product in the workspace '{folder}': it is not removed here."
                )
            for path in _belonging(made.product, made.path):
                if not _lies_in(folder, path):
                    continue
                try:
                    if os.path.isdir(path):
                        shutil.rmtree(path)
                    else:
                        os.unlink(path)
                except OSError as error:
                    raise WorkspaceError(
                        f"Cannot remove '{path}' ({reason_of(error)}): close what has it open."
                    ) from error
                removed.append(path)
    return removed
