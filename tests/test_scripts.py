"""Scripts and benchmarks that no other test runs: what they import from the project is there."""

from __future__ import annotations

import ast
import importlib.util
import pathlib

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
PROGRAMS = [*sorted((ROOT / "scripts").glob("*.py")), ROOT / "scripts" / "demo", ROOT / "scripts" / "package"]
PROGRAMS += sorted((ROOT / "benchmarks").glob("*.py"))


def missing(module, name):
    """Whether a module has neither this name nor a module of this name below it."""
    if hasattr(importlib.import_module(module), name):
        return False
    return importlib.util.find_spec(f"{module}.{name}") is None


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_what_a_program_imports_from_the_project_is_there(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    wanted = [
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ("repm_qgis", "benchmarks")
        for alias in node.names
    ]
    assert [f"{module}.{name}" for module, name in wanted if missing(module, name)] == []


def test_there_are_programs():
    assert len(PROGRAMS) > 20
