"""Each command that stands in README, guide, tutorial, engine.md and the algorithms' pages is run as it stands.

The commands are read out of the pages, so that a new one is run too; docs/cookbook.md has a test of its own. The blocks
of a page run in one folder, each as soon as the files that it reads are there.
"""

from __future__ import annotations

import os
import pathlib
import re
import shutil
import subprocess
import sys
from typing import Dict, List, NamedTuple

import pytest

from repm_qgis.contracts.products import products_of
from repm_qgis.contracts.stages import STAGES

pytestmark = pytest.mark.long

ROOT = pathlib.Path(__file__).resolve().parents[2]
TOGETHER = [ROOT / "docs" / "algorithms" / f"{name}.md" for name in STAGES]
"""Pages whose examples lead to each other: one scene from the sample images to its buildings."""
ALONE = [
    *(ROOT / name for name in ("README.md", "docs/engine.md", "docs/guide.md", "docs/tutorial.md")),
    *(ROOT / "docs" / "de" / f"{name}.md" for name in ("guide", "tutorial")),
]
ELSEWHERE = {
    r"make (demo|test)( +#.*)?": "make demo|make .*test",
    r"(repm-env/bin/)?pip install \.( +#.*)?|python3 -m venv --system-site-packages repm-env( +#.*)?": "front-door",
}
"""Commands that '.ci/run' runs itself: what they look like, and what the script then has."""
NEED_MORE = {
    r"colmap \w+ .*|cd export/\w+|mkdir triangulated": "COLMAP's own program is not here",
    r"\.venv/bin/python -m pip (uninstall|install) .*pycolmap.*": "it exchanges a package, and needs a GPU",
    r"repm batch --table sites\.csv .*": "the table is an example, of folders that only a reader has",
}
"""Commands that do not run here, with the reason, which the test prints."""


_NO_COMMANDS = ("python", "json", "text", "csv")
"""Kinds of fenced blocks that show parts of programs or files."""


class Block(NamedTuple):
    """Lines of a page that are run together."""

    page: str
    text: str


def blocks(page: pathlib.Path) -> List[Block]:
    """The blocks of a page that hold commands."""
    return blocks_of(page.read_text(encoding="utf-8"), str(page.relative_to(ROOT)))


def blocks_of(text: str, name: str = "") -> List[Block]:
    """The indented blocks, and the fenced ones; raises ValueError for a fence whose kind nobody knows."""
    fenced = re.findall(r"(?ms)^```([^\n]*)\n(.*?)^```", text)
    for kind, _ in fenced:
        if kind not in ("", "sh", *_NO_COMMANDS):
            raise ValueError(f"a block of the kind '{kind}' is neither run nor known to hold no commands")
    if "~~~" in text:
        raise ValueError("a block between tildes is not read: put it between backticks")
    text = re.sub(r"(?ms)^```.*?^```", "", text)
    indented = re.findall(r"(?m)(?:^    .*\n)+(?:\n?(?:^    .*\n)+)*", text)
    found = [re.sub(r"(?m)^    ", "", each) for each in indented] + [
        each for kind, each in fenced if kind in ("", "sh")
    ]
    return [Block(name, each) for each in found]


def commands(block: Block) -> List[str]:
    """The commands of a block, each with its continued lines."""
    return [line for line in re.sub(r"\s*\\\n\s*", " ", block.text).splitlines() if line.strip()]


class Files(NamedTuple):
    """The relative paths that a command reads, and those that it writes."""

    read: List[str]
    written: List[str]


def files_of(command: str) -> Files:
    """The files of a command of Processing or of the engine; none of others."""
    match = re.search(r"(?:qgis_process|qgis-headless) run (\w+):(\w+) -- (.*)", command)
    if match:
        provider, name, values = match.groups()
        products = {each.option.upper() for each in products_of(name)} if provider == "repm" else {"OUTPUT"}
        given = [pair for pair in re.findall(r"(?:^| )\"?([A-Z_0-9]+)=([^ \"]+)", values)]
    else:
        match = re.match(r"repm (\w+) (.*)", command)
        words = [each.split() for each in re.split(r"(?:^| )--", match[2])[1:]] if match else []
        products = {each.option for each in products_of(match[1])} if match else set()
        given = [(option.replace("-", "_"), value) for option, *values in words for value in values]
    read = [value for option, value in given if option not in products and re.search(r"\.[a-z]\w{1,6}$|/", value)]
    return Files(read, [value for option, value in given if option in products])


def reason_of(command: str, reasons: Dict[str, str]) -> str:
    return next((reason for pattern, reason in reasons.items() if re.fullmatch(pattern, command)), "")


@pytest.fixture(scope="module")
def variables(tmp_path_factory):
    """The environment of a reader's shell: this checkout's qgis_process, repm and python."""
    programs = tmp_path_factory.mktemp("programs")
    lines = {
        "qgis_process": f"exec '{ROOT}/scripts/qgis-headless' \"$@\"",
        "repm": f"PYTHONPATH='{ROOT}' exec '{sys.executable}' -m repm_qgis.command_line \"$@\"",
        "python": f"PYTHONPATH='{ROOT}' exec '{sys.executable}' \"$@\"",
    }
    for name, line in lines.items():
        (programs / name).write_text(f"#!/bin/sh\n{line}\n")
        (programs / name).chmod(0o755)
    values = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "QGIS_"))}
    config = tmp_path_factory.mktemp("config")
    return {
        **values,
        "PATH": f"{programs}:/usr/bin:/bin",
        "REPM_QGIS_CONFIG": str(config),
        "REPM_ENGINE_PYTHON": sys.executable,
        "QT_QPA_PLATFORM": "offscreen",
    }


@pytest.fixture(scope="module")
def images(tmp_path_factory, variables):
    """Sample images, for pages that begin with a reader's own."""
    folder = tmp_path_factory.mktemp("own")
    sample = ["repm", "sampledata", "--size", "300", "--folder", str(folder)]
    subprocess.run(sample, env=variables, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return folder


def run(block: Block, folder: pathlib.Path, variables: Dict[str, str]) -> None:
    """Run a block in a shell, or as a program where it is Python; its last words are the test's where it fails."""
    if re.match(r"(from|import) ", block.text):
        (folder / "program.py").write_text(f"if __name__ == '__main__':\n{re.sub('(?m)^', '    ', block.text)}")
        text = "python program.py"
    else:
        text = "\n".join(each for each in commands(block) if not reason_of(each, {**ELSEWHERE, **NEED_MORE}))
        text = text.replace("scripts/qgis-headless", "qgis_process")
    done = subprocess.run(
        ["/bin/sh", "-e", "-c", text],
        cwd=folder,
        env=variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, f"{block.page}: {text}\n{done.stdout[-2000:]}"
    assert "Traceback" not in done.stdout, f"{block.page}: {text}\n{done.stdout[-2000:]}"


def run_all(found: List[Block], folder: pathlib.Path, variables: Dict[str, str]) -> int:
    """Run blocks as soon as what they read is there; gives the number of commands that ran."""
    count, left = 0, list(found)
    while left:
        ready = next((each for each in left if not missing(each, folder)), None)
        assert ready is not None, "\n".join(f"{each.page}: {missing(each, folder)} is not there" for each in left)
        run(ready, folder, variables)
        left.remove(ready)
        ran = [each for each in commands(ready) if not reason_of(each, {**ELSEWHERE, **NEED_MORE})]
        gone = [path for each in ran for path in files_of(each).written if not (folder / path).exists()]
        assert not gone, f"{ready.page}: {ready.text}\n{gone}"
        for each in commands(ready):
            reason = reason_of(each, NEED_MORE)
            print(f"{ready.page}: {each[:110]}{f'  [not run: {reason}]' if reason else ''}")
        count += len(ran)
    return count


def missing(block: Block, folder: pathlib.Path) -> List[str]:
    """What a block reads that neither is there nor is written by the commands before it in the block."""
    lacking: List[str] = []
    written: List[str] = []
    for files in (files_of(each) for each in commands(block) if not reason_of(each, NEED_MORE)):
        made = [path for path in files.read if path in written or any(path.startswith(f"{each}/") for each in written)]
        lacking += [path for path in files.read if path not in made and not (folder / path).exists()]
        written += files.written
    return lacking


def test_the_examples_of_the_algorithms_lead_to_each_other_from_the_zip(variables, unpacked_profile, tmp_path):
    """Word for word, but for smaller images."""
    found = [
        Block(block.page, block.text.replace("SIZE=800", "SIZE=500")) for page in TOGETHER for block in blocks(page)
    ]
    assert {block.page.split("/")[-1][:-3] for block in found if "qgis_process" in block.text} == set(STAGES)
    # The page of the sample images first: all others use them.
    found.sort(key=lambda block: "sampledata" not in block.page)
    folder = tmp_path / "work folder"
    folder.mkdir()
    assert run_all(found, folder, {**variables, "REPM_QGIS_CONFIG": str(unpacked_profile)}) >= 30


@pytest.mark.parametrize("page", ALONE, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_commands_of_a_page_run(page, variables, images, tmp_path):
    for number, name in enumerate("ab", start=1):
        shutil.copy(images / f"img_0{number}.tif", tmp_path / f"{name}.tif")
    found = blocks(page)
    count = run_all(found, tmp_path, variables)
    assert count or "tutorial" in page.name, f"{page.name} has no command that ran"


def test_what_runs_elsewhere_runs_there():
    """Commands that only '.ci/run' can run are in it."""
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for pattern in ELSEWHERE.values():
        assert re.search(pattern, script), pattern


def test_a_new_command_is_found():
    text = (
        "Words.\n\n    qgis_process run repm:dtm -- DSM=dsm.tif \\\n        OUTPUT=new.tif\n\n"
        "```\nrepm inspect --images a.tif\n```\n"
    )
    found = [command for block in blocks_of(text) for command in commands(block)]
    assert found == ["qgis_process run repm:dtm -- DSM=dsm.tif OUTPUT=new.tif", "repm inspect --images a.tif"]
    assert [files_of(each) for each in found] == [(["dsm.tif"], ["new.tif"]), (["a.tif"], [])]
