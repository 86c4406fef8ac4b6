"""One test for all files of a kind: what is wrong in which of them."""

from __future__ import annotations

import pathlib
from typing import Any, Callable, Dict, Sequence

ROOT = pathlib.Path(__file__).resolve().parents[1]


def wrong(paths: Sequence[pathlib.Path], check: Callable[[pathlib.Path], Any]) -> Dict[str, Any]:
    """What ``check`` finds, by the file's name in the project; files in which it finds nothing are left out."""
    assert len(paths) > 5, "a rule without files would pass on anything"
    found = {path.relative_to(ROOT).as_posix(): check(path) for path in paths}
    return {name: finding for name, finding in found.items() if finding}
