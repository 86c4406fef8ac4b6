"""Damaged scenes, jobs and tables of points: each must be refused in one sentence, or work.

``campaign`` is run in small by a test, and in full by ``make bench-faults``.
"""

from __future__ import annotations

import copy
import json
import random
import signal
import string
import traceback
from pathlib import Path

from repm_qgis.errors import RepmError
from repm_qgis.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.sfm.ground_control import read_gcps
from repm_qgis.simulation.scene import SceneSpec, make_scene
from repm_qgis.stages import STAGES, run_stage

HANG_S = 20
VALUES = (
    None, True, False, 0, -1, 1, 2, 7, 0.5, -0.0, 1e-300, 1e9, -1e9, 1e308, 10**30, float("nan"), float("inf"),
    -float("inf"), "", "x", "NaN", "../../x", "/", "\0", "a\nb", "é" * 300, "x" * 5000, [], [[]], {}, [None], [1, 2],
    [1, 2, 3, 4], ["a", 1], {"a": 1}, {"": None},
)  # fmt: skip


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
        path = chance.choice(paths)
        parent = result
        for key in path[:-1]:
            parent = parent[key]
        last, kind = path[-1], chance.randrange(6)
        if kind < 3:
            parent[last] = copy.deepcopy(chance.choice(VALUES))
        elif kind == 3:
            del parent[last]
        elif kind == 4 and isinstance(parent[last], (int, float)) and not isinstance(parent[last], bool):
            parent[last] = parent[last] * chance.choice((-1, 0, 2, 10, 1e6, 1e-6))
        elif isinstance(parent, list):
            parent.insert(last, copy.deepcopy(parent[last]))
        else:
            parent[str(last) + "x"] = parent.pop(last)
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
    except Hang:
        return f"no end after {HANG_S} s"
    except Exception as error:  # noqa: BLE001 - that is what is looked for
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"traceback: {type(error).__name__}: {error!s:.100} ({Path(where.filename).name}:{where.lineno})"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    return ""


def campaign(folder, count, seed):
    """Yield the name and the outcome of ``count`` mutations, a half of scenes, a quarter each of jobs and tables."""
    chance = random.Random(seed)  # noqa: S311 - reproducible
    place = Path(folder) / "documents"
    made = make_scene(SceneSpec.default("urban", 256, 5), str(place / "images"), Silent())
    products = {"output": str(place / "dsm.tif"), "workspace": str(place / "w")}
    job = {"images": made["images"][:2], **products, "tile_size": 256, "workers": 1}
    run_stage("pipeline", job, Silent())
    scene = json.loads((place / "w" / "reconstructed.json").read_text())
    table, views = Path(made["gcps"]).read_text(), Scene.load(str(place / "w" / "scene.json")).views
    for number in range(count):
        kind = ("scene", "job", "scene", "table")[number % 4]
        if kind == "scene":
            yield f"scene {number}", outcome(_scene(place, mutated(scene, chance), number))
        elif kind == "job":
            yield f"job {number}", outcome(_job(mutated(job, chance), chance))
        else:
            yield f"table {number}", outcome(_table(place, damaged_text(table, chance), views))


def _scene(place, document, number):
    path = place / "w" / "mutated.json"
    path.write_text(json.dumps(document))

    def work():
        Scene.load(str(path))
        stage = ("errormap", "dsmfuse")[number % 8 == 0]
        run_stage(stage, {"scene": str(path), "output": str(place / "out.tif")}, Silent())

    return work


def _job(document, chance):
    """Options alone: what they refuse never starts, and what they accept is the business of the stages' own tests."""
    stage = chance.choice(sorted(STAGES))
    return lambda: STAGES[stage].from_json(document if stage == "pipeline" else {"scene": "s", **document})


def _table(place, text, views):
    path = place / "mutated.csv"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return lambda: read_gcps(str(path), views)
