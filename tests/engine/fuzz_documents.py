"""Damaged scenes, jobs and tables of points: each must be refused in one sentence, or work.

``campaign`` is run in small by a test, and in full by ``make bench-faults``.
"""

from __future__ import annotations

import copy
import json
import os
import random
import signal
import string
import traceback
from pathlib import Path

from osgeo import ogr

from repm_qgis.contracts.errors import RepmError
from repm_qgis.contracts.options import PipelineOptions
from repm_qgis.files.vector import write_layer
from repm_qgis.pointing.ground_control import read_gcps
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.simulation.scene import SceneSpec, make_scene
from repm_qgis.stages import STAGES, run_stage

HANG_S = 20
VALUES = (
    None, True, False, 0, -1, 1, 2, 7, 0.5, -0.0, 1e-300, 1e9, -1e9, 1e308, 10**30, 10**400, float("nan"), float("inf"),
    -float("inf"), "", "x", "NaN", "../../x", "..\\..\\x", "/", "C:\\x", "CON", ".", "..", "\0", "a\nb", "é" * 300,
    "x" * 5000, "\ud800", "<VRTDataset/>", [], [[]], {}, [None], [1, 2], [1, 2, 3, 4], [2, 1], ["a", 1], {"a": 1},
    {"": None}, [[[[1]]]], [[1, 0, 0], [0, 1, 0]],
)  # fmt: skip
LIGHT = ("epmfit", "errormap", "exportrpc", "checkgcps", "comparedsm", "environment")
SCENE_STAGES = (*["errormap"] * 5, "dsmfuse", "refine", "exportcameras", "exportrpc", "checkgcps")


class Hang(Exception):
    """A document that keeps its reader busy."""


def places(document, path=()):
    """The paths of all nodes of a JSON document."""
    yield path
    items = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    for key, value in items:
        yield from places(value, (*path, key))


def mutated(document, chance):
    """A copy of a JSON document with one to three nodes replaced, removed, doubled, renamed or moved."""
    result = copy.deepcopy(document)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        paths = [path for path in places(result) if path]
        if not paths:
            break
        # By depth first: coefficients, which are most of a scene's nodes, would else be nearly all that is changed.
        depth = chance.choice(sorted({len(path) for path in paths}))
        path = chance.choice([path for path in paths if len(path) == depth])
        parent = result
        for key in path[:-1]:
            parent = parent[key]
        last, kind = path[-1], chance.randrange(6)
        if kind < 3:
            parent[last] = copy.deepcopy(chance.choice(VALUES))
        elif kind == 3:
            del parent[last]
        elif kind == 4 and isinstance(parent[last], (int, float)) and not isinstance(parent[last], bool):
            parent[last] = parent[last] * chance.choice((-1, 0, 2, 10, 1e6, 1e-6)) if abs(parent[last]) < 1e200 else 0
        elif isinstance(parent, list):
            parent.insert(last, copy.deepcopy(parent[last]))
        else:
            parent[chance.choice((str(last) + "x", "../../x", "CON", "a\\b"))] = parent.pop(last)
    return result


def damaged_text(text, chance):
    """A table with some characters replaced, removed or inserted, or lines doubled or dropped."""
    for _ in range(chance.choice((1, 1, 2, 5))):
        at = chance.randrange(len(text) + 1)
        kind = chance.randrange(5)
        if kind == 0:
            text = text[:at] + chance.choice(string.printable + "é\0;,\"'") + text[at + 1 :]
        elif kind == 1:
            text = text[:at] + text[at + chance.choice((1, 5, 40)) :]
        elif kind == 2:
            text = text[:at] + chance.choice((",", "\n", '"', "nan", "1e400", "-", "9" * 400, "\ufeff")) + text[at:]
        else:
            lines = text.splitlines(True) or [""]
            line = chance.randrange(len(lines))
            text = "".join(lines[:line] + lines[line : line + 1] * chance.choice((0, 2)) + lines[line + 1 :])
    return text


def damaged_bytes(data, chance):
    """A binary file with some bytes changed, or cut short."""
    result = bytearray(data)
    for _ in range(chance.choice((1, 4, 40))):
        result[chance.randrange(len(result))] = chance.randrange(256)
    return bytes(result[: chance.choice((len(result), len(result), chance.randrange(len(result))))])


def outcome(work):
    """What is wrong with how a piece of work ended; "" where nothing is."""

    def ring(number, frame):
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(HANG_S)
    try:
        work()
    except RepmError as error:
        return "" if str(error) and "\n" not in str(error) else f"no single sentence: {error!r:.200}"
    except Hang as hang:
        return f"no end after {HANG_S} s ({_where(hang)})"
    except Exception as error:  # noqa: BLE001 - that is what is looked for
        return f"traceback: {type(error).__name__}: {error!s:.100} ({_where(error)})"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    return ""


def _where(error):
    ours = [part for part in traceback.extract_tb(error.__traceback__) if "repm_qgis" in part.filename]
    return ", ".join(f"{Path(part.filename).name}:{part.lineno}" for part in ours[-3:])


def campaign(folder, count, seed):
    """Yield the name and the outcome of ``count`` mutations, a half of scenes, a quarter each of jobs and tables.

    The last one says whether a file was written outside of the folders that the options name.
    """
    chance = random.Random(seed)  # noqa: S311 - reproducible
    place = Path(folder) / "documents" / "deep" / "down"
    made = make_scene(SceneSpec.default("urban", 256, 5), str(place / "images"), Silent())
    job = {"images": made.images[:2], "output": str(place / "dsm.tif"), "workspace": str(place / "w")}
    job.update(tile_size=256, workers=1)
    run_stage("pipeline", job, Silent())
    scene = json.loads((place / "w" / "reconstructed.json").read_text())
    tables, views = _tables(place, made.gcps), Scene.load(str(place / "w" / "scene.json")).views
    before, here = _files(folder), os.getcwd()
    jobs = place / "jobs" / "a" / "b"
    jobs.mkdir(parents=True)
    os.chdir(jobs)  # where jobs write whose outputs are relative
    try:
        for number in range(count):
            kind = ("scene", "job", "scene", "table")[number % 4]
            if kind == "scene":
                work = _scene(place, mutated(scene, chance), chance)
            elif kind == "job":
                work = _job(place, job, made, chance)
            else:
                work = _table(place, tables, views, chance)
            yield f"{kind} {number}", outcome(work)
    finally:
        os.chdir(here)
    allowed = [place / name for name in ("w", "out", "jobs")]
    new = sorted(path for path in _files(folder) - before if not any(part in path.parents for part in allowed))
    yield "files outside", f"written: {', '.join(map(str, new))}" if new else ""


def _files(folder):
    return {path for path in Path(folder).rglob("*") if path.is_file()}


def _scene(place, document, chance):
    path = place / "w" / "mutated.json"
    path.write_text(json.dumps(document))
    stage = chance.choice(SCENE_STAGES)
    out = place / "out"
    options = {
        "errormap": {"output": str(out / "error.tif")},
        "dsmfuse": {"output": str(out / "dsm.tif"), "view_heights": str(out / "views"), "workers": 1},
        "refine": {"output_scene": str(out / "refined.json")},
        "exportcameras": {"folder": str(out / "cameras")},
        "exportrpc": {"rpc_folder": str(out / "rpcs"), "report": str(out / "rpcs.html")},
        "checkgcps": {"gcps": str(place / "images" / "gcps.csv")},
    }

    def work():
        Scene.load(str(path))
        run_stage(stage, {"scene": str(path), **options[stage]}, Silent())

    return work


def _job(place, pipeline, made, chance):
    """Options alone for heavy stages; those that the light ones accept are run."""
    stage = chance.choice((*sorted(STAGES), *LIGHT))
    scene, out = str(place / "w" / "reconstructed.json"), str(place / "out")
    options = {
        "epmfit": {name: pipeline[name] for name in ("images", "workspace", "tile_size")},
        "errormap": {"scene": scene, "output": f"{out}/error.tif", "view": "img_01", "altitude": 200.0},
        "exportrpc": {"scene": scene, "rpc_folder": f"{out}/rpcs"},
        "checkgcps": {"scene": scene, "gcps": made.gcps, "dsm": pipeline["output"], "gcp_datum": ""},
        "comparedsm": {"dsm": pipeline["output"], "reference": made.truth, "thresholds": [1.0], "others": []},
        "environment": {"report": f"{out}/environment.html"},
        "pipeline": {**pipeline, "extent": [0, 0, 1, 1], "extent_crs": "EPSG:4326", "dem": None, "masks": []},
    }
    if stage == "epmfit":
        options[stage].update(workspace=f"{out}/w", altitude_min=150.0, altitude_max=260.0, error_budget=0.1)
    document = mutated(options.get(stage, {"scene": scene, "output": f"{out}/o.tif"}), chance)

    def work():
        checked = STAGES[stage].options.from_json(document)
        if stage in LIGHT and not any(value == "/" for value in document.values()):  # where a test must not write
            run_stage(stage, document, Silent())
        assert stage != "pipeline" or isinstance(checked, PipelineOptions)

    return work


def _tables(place, gcps):
    """The points as CSV, GeoJSON and GeoPackage: names and bytes."""
    rows = [line.split(",") for line in Path(gcps).read_text().splitlines()]
    fields = {name: str if name in ("id", "view", "role") else float for name in rows[0]}
    kinds = list(fields.values())
    values = [[kind(cell) if cell else None for kind, cell in zip(kinds, row)] for row in rows[1:]]
    found = {"csv": Path(gcps).read_bytes()}
    for ending in ("geojson", "gpkg"):
        path = place / f"points.{ending}"
        features = ((_point(row, list(fields)), row) for row in values)
        write_layer(str(path), "EPSG:4326", ogr.wkbPoint, fields, features)
        found[ending] = path.read_bytes()
    return found


def _point(row, names):
    point = ogr.Geometry(ogr.wkbPoint)
    point.AddPoint_2D(row[names.index("lon")], row[names.index("lat")])
    return point


def _table(place, tables, views, chance):
    ending = chance.choice(("csv", "csv", "geojson", "gpkg"))
    path = place / "out" / f"mutated.{ending}"
    path.parent.mkdir(exist_ok=True)
    if ending == "gpkg":
        path.write_bytes(damaged_bytes(tables[ending], chance))
    else:
        path.write_bytes(damaged_text(tables[ending].decode(), chance).encode("utf-8", "surrogatepass"))
    return lambda: read_gcps(str(path), views)
