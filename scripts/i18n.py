#!/usr/bin/env python3
"""Bring i18n/*.ts and i18n/engine_*.json up to date with the source ('make i18n'): ``scripts/i18n.py [LANGUAGE ...]``.

The dialogs' texts (.ts, compiled to .qm) are found in the syntax tree: self.tr("...") in a class, tr("...") and
_tr("...") of a module, and the names of groups; those of products and of results in their tables. The engine's (.json)
are all others that a person may read, see engine_texts. Translations are kept as long as their text is in the source. A
new language starts empty. Ends with 1 where a translation is missing.
"""

from __future__ import annotations

import ast
import fnmatch
import html
import json
import pathlib
import re
import shutil
import subprocess
import sys
from xml.sax.saxutils import escape

ROOT = pathlib.Path(__file__).resolve().parent.parent
FOLDERS = ROOT / "processing_provider", ROOT / "desktop"
BASE = "RepmAlgorithm"  # the context of texts that all algorithms share; base.py looks there second
PARAMETERS = "RepmParameters"  # the context of parameters.py, and of what products and results are called


def own_context(tree: ast.Module) -> str:
    """The context in which a module's own tr or _tr looks its texts up, "" where it has none."""
    for function in tree.body:
        if isinstance(function, ast.FunctionDef) and function.name in ("tr", "_tr"):
            calls = (node for node in ast.walk(function) if isinstance(node, ast.Call) and len(node.args) == 2)
            return next(str(call.args[0].value) for call in calls if isinstance(call.args[0], ast.Constant))
    return ""


def texts_of(path: pathlib.Path) -> dict[str, list[str]]:
    """Translatable texts of a module by context, in the order of the source."""
    found: dict[str, list[str]] = {}
    tree = ast.parse(path.read_text(encoding="utf-8"))
    own = own_context(tree)

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
                add((own or context) if function else context, node.args[0])
        for target in getattr(node, "targets", []) + [getattr(node, "target", None)]:
            if isinstance(target, ast.Name) and target.id == "GROUPS":
                for value in getattr(getattr(node, "value", None), "values", []):
                    add(BASE, value)
        for child in ast.iter_child_nodes(node):
            walk(child, context)

    walk(tree, BASE)
    return found


def texts_of_products() -> list[str]:
    sys.path.insert(0, str(ROOT))
    from repm_qgis.contracts.products import PRODUCTS

    return [text for product in PRODUCTS for text in (product.title, product.layer, product.help) if text]


def labels_of_results() -> list[str]:
    sys.path.insert(0, str(ROOT))
    from repm_qgis.contracts.stages import STAGES

    return [meaning.label for stage in STAGES.values() for meaning in stage.result.outputs().values()]


def source() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    modules = [texts_of(path) for folder in FOLDERS for path in sorted(folder.glob("*.py"))]
    for texts_by_context in (*modules, {PARAMETERS: [*texts_of_products(), *labels_of_results()]}):
        for context, texts in texts_by_context.items():
            known = found.setdefault(context, [])
            known += [text for text in dict.fromkeys(texts) if text not in known]
    return dict(sorted(found.items()))


def translations(path: pathlib.Path) -> dict[tuple[str, str], str]:
    """The translations in a .ts file, by context and text."""
    if not path.exists():
        return {}
    import xml.dom.minidom as minidom  # our own file

    def text(node: minidom.Element, name: str) -> str:
        inside = node.getElementsByTagName(name)[0].firstChild
        return inside.data if isinstance(inside, minidom.Text) else ""

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


# What follows is for the engine, whose texts are found without a mark.

# Calls whose texts nobody reads: patterns, names of variables, and what Qt's translator has.
_CODE_CALLS = set(
    "tr _tr translate compile sub match search split rsplit partition fullmatch finditer findall find startswith "
    "endswith get getenv getattr hasattr setattr replace strip lstrip rstrip TypeVar field add_argument setObjectName "
    "setProperty value setValue encode fromstring strftime".split()
)
_BUGS = {"ValueError", "TypeError", "AssertionError", "KeyError", "NotImplementedError", "RuntimeError"}
WORDS = (
    "area before after begins fusion matching refinement contradicted control check done maps no none point points "
    "unknown yes DSM wrong Report Tiles images parameters "
    "uncorrected corrected horizontally determined east west north south height north-west north-east south-west "
    "south-east middle CRS registered preview"
).split()
"""Words of one small letter or of a name's form that stand alone in texts: all others of that kind are codes."""
_MOST_FORMS = 16
_PASSED_OVER = {
    ROOT / "repm_qgis" / "contracts" / "products.py",  # the dialogs have its texts; pages show titles only
    ROOT / "repm_qgis" / "contracts" / "results.py",  # the dialogs have its labels; the rest is for English documents
    ROOT / "repm_qgis" / "command_line.py",  # a terminal's help, whose options are English words
    ROOT / "repm_qgis" / "imagery" / "sensors.py",  # names, patterns and citations, the same in every language
}
SYSTEM = (
    "File exists",
    "Is a directory",
    "No space left on device",
    "No such file or directory",
    "Not a directory",
    "Permission denied",
    "Read-only file system",
    "Too many open files",
)
"""What the system says of files, which messages quote. What GDAL and PROJ say stays in their English."""


def _forms(node: ast.AST) -> list[list[str | None]]:
    """The forms that a text can have, each as literals and None for what is filled in; [] where it is no text."""
    if isinstance(node, ast.Constant):
        return [[node.value]] if isinstance(node.value, str) else []
    if isinstance(node, ast.JoinedStr):
        forms: list[list[str | None]] = [[]]
        for value in node.values:
            forms = [form + more for form in forms for more in _filled(value)][:_MOST_FORMS]
        return forms
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return [left + right for left in _forms(node.left) for right in _forms(node.right)]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "format":
        whole = node.func.value
        if isinstance(whole, ast.Constant) and isinstance(whole.value, str):
            pieces = re.split(r"\{[^{}]*\}", whole.value)
            return [[part for piece in pieces for part in (None, piece)][1:]]
    return []


def _filled(value: ast.expr) -> list[list[str | None]]:
    """The forms of a part of an f-string: {'s' if many else ''} has two, which are two sentences."""
    inner = value.value if isinstance(value, ast.FormattedValue) else value
    if isinstance(inner, ast.IfExp):
        branches = [_forms(inner.body), _forms(inner.orelse)]
        if all(branches):
            return [form for branch in branches for form in branch]
    return _forms(inner) or [[None]]


def template(form: list[str | None]) -> str:
    """Literals with numbered fields between them; fields that touch are one."""
    text, count = "", 0
    for part in form:
        if part is not None:
            text += part
        elif not re.search(r"\{\d+\}$", text):
            text, count = f"{text}{{{count}}}", count + 1
    return text


def _is_read(text: str) -> bool:
    """Whether a text looks like one that people read: words with spaces, or a capitalised word."""
    literal = re.sub(r"\{\d+\}", "\0", text)
    if re.fullmatch(r"[A-Z][a-z]+", literal) or literal in WORDS:
        return True
    return " " in literal.strip("\0") and bool(re.search(r"(^|[\s\0(])[A-Za-z]{2,}", literal))


def _pieces(text: str) -> list[str]:
    """The columns of a table's headers, which are one text; else the text."""
    if " | " in text:
        return [column for column in text.split(" | ") if re.search("[A-Za-z]{2}", column)]
    return [text] if _is_read(text) else []


def _read_in(tree: ast.AST) -> list[str]:
    """The texts of a module that people read, in the order of the source."""
    found: list[str] = []
    passed_over = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings

    def children(node: ast.AST) -> None:
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns", "decorator_list", "format_spec"):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        walk(child)

    def walk(node: ast.AST) -> None:
        if isinstance(node, ast.Constant) and id(node) in passed_over or isinstance(node, ast.Compare):
            return
        if isinstance(node, ast.Subscript):
            return walk(node.value)
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "TAGS":
            return None  # words to search for in the toolbox, in every language at once
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            if getattr(node.exc.func, "id", "") in _BUGS:
                return None
        if isinstance(node, ast.Call):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called in _CODE_CALLS:
                return walk(node.func)
            if called == "counted":
                nouns = [form[0] for form in _filled(node.args[1]) if form[0]]
                found.extend(text for noun in nouns for text in (f"1 {noun}", f"{{0}} {noun}s"))
                return walk(node.args[0])
        found.extend(piece for form in _forms(node) for piece in _pieces(template(form)))
        if isinstance(node, ast.JoinedStr):
            for value in node.values:
                if isinstance(value, ast.FormattedValue) and not _forms(value.value):
                    walk(value.value)
        elif isinstance(node, ast.BinOp) and _forms(node):
            for side in (node.left, node.right):
                inner = [value.value for value in getattr(side, "values", []) if isinstance(value, ast.FormattedValue)]
                for value in inner:
                    walk(value)
        elif isinstance(node, ast.Call) and _forms(node):
            for argument in [*node.args, *(keyword.value for keyword in node.keywords)]:
                walk(argument)
        else:
            children(node)

    walk(tree)
    return found


def _read_in_templates() -> list[str]:
    """Texts in quotation marks of the pages' templates, labels of legends, and what models say."""
    sys.path.insert(0, str(ROOT))
    from repm_qgis.contracts.products import STYLES

    found: list[str] = []
    for path in sorted((ROOT / "resources" / "templates").iterdir()):
        found += re.findall(r'"([^"]*)"(?=\|said)', path.read_text(encoding="utf-8"))
    for path in sorted((ROOT / "resources" / "styles").glob("*.qml")):
        for label in re.findall(r' label="([^"]*)"', path.read_text(encoding="utf-8")):
            parts = [part for piece in re.split("@[a-z]+@", html.unescape(label)) for part in (None, piece)][1:]
            found += [template(parts)]
    found += [text for style in STYLES for text in (*style.classes, style.title)]
    found += _read_in_models()
    return [text for text in found if re.search("[A-Za-z]{2}", text)]


def _read_in_models() -> list[str]:
    """What the models say, without what they take from our dialogs."""
    keys = "ALG_DESC|SHORT_DESCRIPTION|component_description|description"
    texts = [path.read_text("utf-8") for path in sorted((ROOT / "resources" / "models").glob("*.model3"))]
    read = [html.unescape(found) for text in texts for found in re.findall(f'name="(?:{keys})" value="([^"]*)"', text)]
    ours = source()[PARAMETERS]
    return [text for text in read if text not in ours]


def stays() -> dict[str, str]:
    """The texts that are not translated, with the reason: patterns of fnmatch."""
    reasons = json.loads((ROOT / "i18n" / "stays_english.json").read_text(encoding="utf-8"))
    return {text: reason for reason, texts in reasons.items() for text in texts}


def engine_texts() -> list[str]:
    """Every text outside the dialogs' .ts that a person may read, as a template with numbered fields.

    These are the literals and f-strings of the engine, and of the QGIS side where Qt's translator has them not, with
    words or a capital: taken generously, without those of i18n/stays_english.json.
    """
    found: list[str] = []
    dialogs = {text for texts in source().values() for text in texts}
    for folder in ("repm_qgis", "processing_provider", "desktop"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if path not in _PASSED_OVER:
                texts = _read_in(ast.parse(path.read_text(encoding="utf-8")))
                found += [text for text in texts if folder == "repm_qgis" or text not in dialogs]
    found += [*_read_in_templates(), *titles_of_products(), *SYSTEM]
    left_out = list(stays())
    exact = set(left_out)
    patterns = [re.compile(fnmatch.translate(text)) for text in left_out if "*" in text]
    return [
        text
        for text in sorted(dict.fromkeys(found))
        if text not in exact and not any(pattern.match(text) for pattern in patterns)
    ]


def titles_of_products() -> list[str]:
    sys.path.insert(0, str(ROOT))
    from repm_qgis.contracts.products import PRODUCTS

    return [text for product in PRODUCTS for text in (product.title, product.layer) if text]


def engine_catalogue(language: str) -> dict[str, str]:
    """The engine's texts with their translations, "" where there is none; titles of products are the dialogs'."""
    path = ROOT / "i18n" / f"engine_{language}.json"
    done = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    dialogs = translations(ROOT / "i18n" / f"repm_{language}.ts")
    titles = {text: dialogs.get((PARAMETERS, text), "") for text in titles_of_products()}
    return {text: titles.get(text) or done.get(text, "") for text in engine_texts()}


def write_engine(language: str) -> list[str]:
    """Write what the engine's catalogue of a language has; gives the texts that it lacks."""
    catalogue = engine_catalogue(language)
    path = ROOT / "i18n" / f"engine_{language}.json"
    known = {text: word for text, word in catalogue.items() if word}
    path.write_text(json.dumps(known, ensure_ascii=False, indent=0) + "\n", encoding="utf-8")
    return [text for text, word in catalogue.items() if not word]


def main(languages: list[str]) -> int:
    names = languages or sorted(path.stem.split("_", 1)[1] for path in (ROOT / "i18n").glob("repm_*.ts"))
    complete = True
    compiler = shutil.which("lrelease") or shutil.which("lrelease", path="/usr/lib/qt5/bin:/usr/lib/qt6/bin")
    for name in names:
        path = ROOT / "i18n" / f"repm_{name}.ts"
        count, translated = write(path, name)
        sys.stdout.write(f"{path.name}: {count - translated} of {count} texts untranslated\n")
        missing = write_engine(name)
        sys.stdout.write(f"engine_{name}.json: {len(missing)} untranslated\n")
        sys.stdout.writelines(f"  {text!r}\n" for text in missing[:20])
        complete = complete and count == translated and not missing
        if compiler:
            subprocess.run([compiler, "-silent", str(path), "-qm", str(path.with_suffix(".qm"))], check=True)
    if not compiler:
        sys.stderr.write("i18n: no .qm files were written: lrelease is missing (Debian: qttools5-dev-tools).\n")
    return 0 if compiler and complete else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
