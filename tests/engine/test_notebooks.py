"""The notebooks of docs/: their code runs as it stands, and nothing that a run leaves is stored in them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.slow
def test_a_notebook_runs_and_has_no_outputs(path, tmp_path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert notebook["nbformat"] == 4 and len(cells) >= 3
    assert not [cell for cell in cells if cell["outputs"] or cell["execution_count"] is not None]
    script = tmp_path / "notebook.py"
    found = "\n\nimport json\nprint(json.dumps([compared.nmad, made.valid_percent, list(heights.shape)]))\n"
    script.write_text("\n\n".join("".join(cell["source"]) for cell in cells) + found, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, str(script)], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    nmad, valid, shape = json.loads(done.stdout.splitlines()[-1])
    assert nmad < 0.3 and valid > 95 and len(shape) == 2


def test_there_is_one():
    assert [path.name for path in NOTEBOOKS] == ["first_dsm.ipynb"]
