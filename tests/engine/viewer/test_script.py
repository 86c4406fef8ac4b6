"""The modules of the viewer's page, joined as one script; that the script works, test_viewer_browser.py shows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from repm_qgis.viewer.script import joined

MODULES = Path(__file__).resolve().parents[3] / "resources" / "viewer"


def test_each_module_is_there_once_after_those_that_it_imports():
    order = re.findall(r"^// (\w+\.js)$", joined(MODULES / "page.js"), re.MULTILINE)
    assert sorted(order) == sorted(path.name for path in MODULES.glob("*.js") if path.name != "twgl.js")
    for path in MODULES.glob("*.js"):
        for other in re.findall(r'^import .* from "\./(.*)";$', path.read_text(encoding="utf-8"), re.MULTILINE):
            assert order.index(other) < order.index(path.name), f"{other} in {path.name}"


def write(folder, **modules):
    for name, text in modules.items():
        (folder / f"{name}.js").write_text(text, encoding="utf-8")
    return folder / "page.js"


def test_joined_modules_are_their_texts_without_imports_and_exports(tmp_path):
    page = write(
        tmp_path,
        page='import {\n  one,\n  two,\n} from "./a.js";\nimport {B} from "./b.js";\n\nnew B(one, two);\n',
        a='export const one = 1;\n/** Of "export". */\nexport async function two() {}\n',
        b='import {one} from "./a.js";\n\nexport class B {\n  c = one;\n}\n',
    )
    assert joined(page) == (
        '// a.js\nconst one = 1;\n/** Of "export". */\nasync function two() {}\n\n'
        "// b.js\nclass B {\n  c = one;\n}\n\n"
        "// page.js\nnew B(one, two);\n"
    )


@pytest.mark.parametrize(
    ("modules", "words"),
    [
        ({"page": 'import {a} from "./page.js";\n'}, r"circle: page\.js > page\.js"),
        ({"page": 'import {a} from "./a.js";\n', "a": 'import {b} from "./page.js";\n'}, "page.js > a.js > page.js"),
        ({"page": 'import a from "./a.js";\n'}, "page.js has a line .* import a from"),
        ({"page": 'import {a} from "elsewhere";\n'}, "page.js has a line .* import"),
        ({"page": 'import {a as b} from "./a.js";\n', "a": "export const a = 1;\n"}, "page.js has a line .*{a as b}"),
        ({"page": "export default 1;\n"}, "page.js has a line .* export default"),
        ({"page": "export {a};\n"}, "page.js has a line .* export {a}"),
        (
            {"page": 'import {a} from "./a.js";\nconst {b, c} = a;\n', "a": "export const a = 1;\nfunction c() {}\n"},
            "a.js and page.js both declare 'c'",
        ),
    ],
)
def test_modules_that_cannot_be_joined_are_refused(tmp_path, modules, words):
    with pytest.raises(ValueError, match=words):
        joined(write(tmp_path, **modules))


def test_a_missing_module_is_no_empty_one(tmp_path):
    with pytest.raises(FileNotFoundError):
        joined(write(tmp_path, page='import {a} from "./gone.js";\n'))
