"""The engine's structure is the drawing in docs/architecture.md: imports go down only, and never in a circle."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ENGINE = ROOT / "repm_qgis"


def modules():
    """Each module's dotted name below the engine's package and its file; a package's own module has its name."""
    for path in sorted(ENGINE.rglob("*.py")):
        parts = path.relative_to(ENGINE).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def imports():
    """The modules of the engine that each module imports, wherever in the file it does."""
    names = {name for name, _ in modules()}
    found = {}
    for name, path in modules():
        package = path.relative_to(ENGINE).with_suffix("").parts[:-1]
        targets = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = [*package[: len(package) - node.level + 1], *(node.module or "").split(".")]
                base = ".".join(part for part in base if part)
                for alias in node.names:
                    full = f"{base}.{alias.name}" if base else alias.name
                    targets.add(full if full in names else base)
        found[name] = targets - {name}
    return found


def layers():
    """The lines of the drawing, from the top: sets of packages and modules."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    drawing = re.search(r"```layers\n(.*?)```", page, flags=re.S)
    assert drawing, "docs/architecture.md has no block ```layers"
    return [line.split() for line in drawing.group(1).splitlines() if line.strip()]


def entry(name):
    return name.split(".")[0]


def test_the_drawing_names_every_package_and_module_once():
    drawn = [name for line in layers() for name in line]
    assert sorted(drawn) == sorted({entry(name) for name, _ in modules() if name})


def test_imports_go_down_only():
    rank = {name: number for number, line in enumerate(layers()) for name in line}
    up = [
        f"{name} imports {target}"
        for name, targets in imports().items()
        for target in targets
        if name and target and entry(name) != entry(target) and rank[entry(target)] <= rank[entry(name)]
    ]
    assert up == []


def test_no_modules_import_each_other_in_a_circle():
    graph, done, circles = imports(), set(), []

    def visit(name, path):
        if name in path:
            circles.append(" -> ".join([*path[path.index(name) :], name]))
        elif name not in done:
            for target in sorted(graph.get(name, ())):
                visit(target, [*path, name])
            done.add(name)

    for name in sorted(graph):
        visit(name, [])
    assert circles == []


def test_the_analysis_sees_imports():
    """A test of imports that finds none would pass on anything."""
    graph = imports()
    assert "scene" in graph["stages.pipeline"] and sum(map(len, graph.values())) > 300
