"""Calls say which value goes to which parameter.

A record that a star unpacks into positions is the exception that nobody sees: of ``Facts(name, *counts)`` no reader and
no checker of types knows that two counts were exchanged. Records are passed whole or by name.
"""

from __future__ import annotations

import ast
from collections import Counter
from functools import lru_cache
from pathlib import Path
from typing import Dict, Iterator, List, Set

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("repm_qgis", "processing_provider", "desktop")

PLACES = {
    "Bounds",
    "EnuFrame",
    "Number",
    "Window",
    "around_ground",
    "colour_bar",
    "colour_map",
    "heights",
    "monomials",
    "moved",
    "on_grid",
    "on_lattice",
    "patch",
    "projected_crs_at",
    "resampled",
    "shaded_relief",
    "shifted",
    "spanning",
    "ticks",
    "to_ground",
    "translation",
    "utm_crs",
    "_map",
    "_moved",
    "_name",
}
"""What takes a place, a size, a rectangle or a range of numbers: these have one order everywhere, x before y before
height, columns before rows, the least before the largest."""


@lru_cache(maxsize=1)
def modules() -> Dict[str, ast.Module]:
    paths = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    return {str(path.relative_to(ROOT)): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def own_names(trees: Dict[str, ast.Module]) -> Dict[str, bool]:
    """The functions and classes of this project, and whether one of that name takes any number of values."""
    names: Dict[str, bool] = {}
    for node in (node for tree in trees.values() for node in ast.walk(tree)):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            variadic = isinstance(node, ast.FunctionDef) and node.args.vararg is not None
            names[node.name] = names.get(node.name, False) or variadic
    return names


def passed_on(tree: ast.Module) -> Set[ast.Starred]:
    """Stars on a function's own ``*arguments``."""
    found: Set[ast.Starred] = set()
    for function in ast.walk(tree):
        if isinstance(function, (ast.FunctionDef, ast.Lambda)) and function.args.vararg:
            name = function.args.vararg.arg
            stars = (node for node in ast.walk(function) if isinstance(node, ast.Starred))
            found |= {star for star in stars if isinstance(star.value, ast.Name) and star.value.id == name}
    return found


def starred_calls(tree: ast.Module) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and any(isinstance(each, ast.Starred) for each in node.args):
            yield node


def kinds_of_stars(trees: Dict[str, ast.Module]) -> Dict[str, List[str]]:
    """The calls with a star among their positions, by what the star unpacks."""
    names, found = own_names(trees), {"records": [], "places": [], "any number": [], "passed on": [], "others'": []}
    for path, tree in trees.items():
        through = passed_on(tree)
        for call in starred_calls(tree):
            name = getattr(call.func, "id", getattr(call.func, "attr", ""))
            outside = ast.unparse(call.func).split(".")[0] in ("cv2", "gdal", "math", "np", "os", "osr", "pyproj")
            if all(star in through for star in call.args if isinstance(star, ast.Starred)):
                kind = "passed on"
            elif outside or (name not in names and name != "cls"):
                kind = "others'"
            elif names.get(name):
                kind = "any number"
            else:
                kind = "places" if name in PLACES else "records"
            found[kind].append(f"{path}:{call.lineno}: {ast.unparse(call)[:80]}")
    return found


@pytest.mark.long
def test_no_record_is_unpacked_into_positions():
    found = kinds_of_stars(modules())
    assert not found["records"], "\n".join(found["records"])
    assert len(found["places"]) > 30 and len(found["others'"]) > 50  # the lint sees the calls


def test_the_list_of_places_has_none_that_nobody_unpacks_into():
    used = Counter()
    for tree in modules().values():
        used.update(getattr(call.func, "id", getattr(call.func, "attr", "")) for call in starred_calls(tree))
    assert {name for name in PLACES if not used[name]} == set()


def test_the_lint_finds_a_record():
    tree = ast.parse(
        "class Facts: ...\n"
        "def fixed(*values): return Facts(*values)\n"
        "Facts(name, *counts)\nfixed(*counts)\nnp.hypot(*counts)\nBounds(*box)\nclass Bounds: ...\n"
    )
    found = kinds_of_stars({"a.py": tree})
    assert [len(found[kind]) for kind in ("records", "places", "any number", "passed on", "others'")] == [1, 1, 1, 1, 1]
