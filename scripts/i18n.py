#!/usr/bin/env python3
"""Bring i18n/*.ts up to date with the source, and compile them ('make i18n'): ``scripts/i18n.py [LANGUAGE ...]``.

Texts are found in the syntax tree: self.tr("...") in a class, tr("...") and _tr("...") of a module, and the names of
groups; those of products in their table. Translations are kept as long as their text is in the source. A new language
starts empty.
"""

from __future__ import annotations

import ast
import pathlib
import shutil
import subprocess
import sys
from xml.sax.saxutils import escape

ROOT = pathlib.Path(__file__).resolve().parent.parent
FOLDERS = ROOT / "processing_provider", ROOT / "desktop"
BASE = "RepmAlgorithm"  # the context of texts that all algorithms share; base.py looks there second
MODULES = {"parameters.py": "RepmParameters", "settings.py": "RepmSettings", "styles.py": "RepmStyles"}


def texts_of(path: pathlib.Path) -> dict[str, list[str]]:
    """Translatable texts of a module by context, in the order of the source."""
    found: dict[str, list[str]] = {}
    tree = ast.parse(path.read_text(encoding="utf-8"))

    def add(context: str, node: ast.AST) -> None:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            known = found.setdefault(context, [])
            known += [node.value] if node.value not in known else []

    def walk(node: ast.AST, context: str) -> None:
        if isinstance(node, ast.ClassDef):
            context = node.name
        if isinstance(node, ast.Call) and node.args:
            called = node.func
            method = isinstance(called, ast.Attribute) and called.attr == "tr"
            function = isinstance(called, ast.Name) and called.id in ("tr", "_tr")
            if method or function:
                add(MODULES.get(path.name, context) if function else context, node.args[0])
        for target in getattr(node, "targets", []) + [getattr(node, "target", None)]:
            if isinstance(target, ast.Name) and target.id == "GROUPS":
                for value in node.value.values:
                    add(BASE, value)
        for child in ast.iter_child_nodes(node):
            walk(child, context)

    walk(tree, BASE)
    return found


def texts_of_products() -> list[str]:
    sys.path.insert(0, str(ROOT))
    from repm_qgis.products import PRODUCTS

    return [text for product in PRODUCTS for text in (product.title, product.layer, product.help) if text]


def source() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    modules = [texts_of(path) for folder in FOLDERS for path in sorted(folder.glob("*.py"))]
    for texts_by_context in (*modules, {MODULES["parameters.py"]: texts_of_products()}):
        for context, texts in texts_by_context.items():
            known = found.setdefault(context, [])
            known += [text for text in dict.fromkeys(texts) if text not in known]
    return dict(sorted(found.items()))


def translations(path: pathlib.Path) -> dict[tuple[str, str], str]:
    """The translations in a .ts file, by context and text."""
    if not path.exists():
        return {}
    import xml.dom.minidom as minidom  # our own file

    def text(node, name: str) -> str:
        inside = node.getElementsByTagName(name)[0].firstChild
        return inside.data if inside else ""

    document = minidom.parse(str(path))  # noqa: S318
    return {
        (text(context, "name"), text(message, "source")): text(message, "translation")
        for context in document.getElementsByTagName("context")
        for message in context.getElementsByTagName("message")
    }


def write(path: pathlib.Path, language: str) -> tuple[int, int]:
    """Write the .ts file of a language; gives the number of texts, and how many are translated."""
    done, lines, count, translated = translations(path), [], 0, 0
    for context, texts in source().items():
        lines += ["<context>", f"    <name>{context}</name>"]
        for text in texts:
            word = done.get((context, text), "")
            count, translated = count + 1, translated + bool(word)
            mark = "" if word else ' type="unfinished"'
            lines += [
                "    <message>",
                f"        <source>{escape(text)}</source>",
                f"        <translation{mark}>{escape(word)}</translation>",
                "    </message>",
            ]
        lines += ["</context>"]
    path.write_text(
        '<?xml version="1.0" encoding="utf-8"?>\n<!DOCTYPE TS>\n'
        f'<TS version="2.1" language="{language}" sourcelanguage="en">\n' + "\n".join(lines) + "\n</TS>\n",
        encoding="utf-8",
    )
    return count, translated


def main(languages: list[str]) -> int:
    names = languages or sorted(path.stem.split("_", 1)[1] for path in (ROOT / "i18n").glob("repm_*.ts"))
    compiler = shutil.which("lrelease") or shutil.which("lrelease", path="/usr/lib/qt5/bin:/usr/lib/qt6/bin")
    for name in names:
        path = ROOT / "i18n" / f"repm_{name}.ts"
        count, translated = write(path, name)
        sys.stdout.write(f"{path.name}: {translated} of {count} texts translated\n")
        if compiler:
            subprocess.run([compiler, "-silent", str(path), "-qm", str(path.with_suffix(".qm"))], check=True)
    if not compiler:
        sys.stderr.write("i18n: no .qm files were written: lrelease is missing (Debian: qttools5-dev-tools).\n")
    return 0 if compiler else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
