"""The headline figures say which command measured them at which revision, and the documents stay short."""

from __future__ import annotations

import functools
import pathlib
import re
import shutil
import subprocess

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
README = ROOT / "README.md"
HEADLINES = DOCS / "benchmarks.md"
_REVISION = re.compile(r"\b(?=[0-9]*[a-f])(?=[a-f]*[0-9])[0-9a-f]{7,40}\b")


def sections(page: pathlib.Path) -> list[tuple[str, str]]:
    """The headings of the second level, each with the text below it."""
    parts = re.split(r"(?m)^## (.+)\n", page.read_text(encoding="utf-8"))[1:]
    return list(zip(parts[::2], parts[1::2]))


def rows(text: str) -> list[str]:
    """The rows of the tables of a text, without their heads."""
    lines = text.splitlines()
    heads = {at - 1 for at, line in enumerate(lines) if re.match(r"\|[-|]+$", line)}
    return [line for at, line in enumerate(lines) if line.startswith("|") and at not in heads and at - 1 not in heads]


@functools.lru_cache(maxsize=1)
def figures() -> dict[str, str]:
    """What must name a command and a revision: by where it stands, the text that does."""
    measured = next(text for title, text in sections(README) if title == "Measured, beside S2P and CARS")
    found = {f"README.md, row {number}: {row[:40]}": row for number, row in enumerate(rows(measured))}
    for place, (title, text) in enumerate(sections(HEADLINES)):
        if title.startswith("More"):
            found.update({f"benchmarks.md, {place}.{n}: {row[:60]}": row for n, row in enumerate(rows(text))})
        else:
            found[f"benchmarks.md, {place}: {title}"] = text.strip().split("\n\n")[0]
    for page in sorted((DOCS / "benchmarks").glob("*.md")):
        found[f"benchmarks/{page.name}"] = page.read_text(encoding="utf-8").split("\n\n")[1]
    return found


def commands(text: str) -> list[str]:
    """The commands that a text names."""
    return re.findall(r"`((?:make |scripts/|python benchmarks )[^`]+)`", text)


def exists(command: str) -> bool:
    """Whether a target of make, a benchmark or a script of this name is there."""
    words = command.split()
    name = words[-1] if words[:2] == ["python", "benchmarks"] else ""
    if words[0] == "make":
        targets = re.findall(r"(?m)^([a-z0-9-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"))
        if words[1] in targets:
            return True
        name = words[1].partition("bench-")[2]
    benchmark = ROOT / "benchmarks" / f"{name}.py"
    if name:
        return benchmark.is_file() and "\nSECTIONS = " in benchmark.read_text(encoding="utf-8")
    return words[0].startswith("scripts/") and (ROOT / words[0]).is_file()


def test_each_headline_names_a_command_that_exists():
    assert len(figures()) >= 40
    assert [where for where, text in figures().items() if not commands(text)] == []
    absent = {where: [name for name in commands(text) if not exists(name)] for where, text in figures().items()}
    assert {where: names for where, names in absent.items() if names} == {}


def test_a_command_that_is_not_there_is_noticed():
    for command in ("make bench", "make demo", "make bench-faults", "make bench-real", "python benchmarks real"):
        assert exists(command), command
    for command in ("make bench-nothing", "make nothing", "make bench-scenes", "python benchmarks no", "scripts/no"):
        assert not exists(command), command


def git(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)


def without_history() -> str:
    """Why revisions cannot be looked up here; "" where they can be."""
    if shutil.which("git") is None:
        return "git is not installed"
    shallow = git("rev-parse", "--is-shallow-repository")
    if shallow.returncode != 0:
        return f"this is no clone: {shallow.stderr.strip()}"
    return "this clone has no history (shallow)" if shallow.stdout.strip() == "true" else ""


def test_each_headline_names_a_revision():
    assert [where for where, text in figures().items() if not _REVISION.search(text)] == []


def test_the_revisions_of_the_headlines_are_in_this_history():
    if reason := without_history():
        pytest.skip(reason)
    revisions = sorted({revision for text in figures().values() for revision in _REVISION.findall(text)})
    unknown = {name for name in revisions if git("merge-base", "--is-ancestor", name, "HEAD").returncode != 0}
    wrong = {where: sorted(unknown & set(_REVISION.findall(text))) for where, text in figures().items()}
    assert {where: names for where, names in wrong.items() if names} == {}


def words_of(page: pathlib.Path) -> int:
    """As ``wc -w`` counts them."""
    return len(page.read_text(encoding="utf-8").split())


@pytest.mark.parametrize("page, most", ((README, 120), (HEADLINES, 300)), ids=("README.md", "benchmarks.md"))
def test_pages_for_a_reader_in_a_hurry_have_few_lines(page, most):
    assert len(page.read_text(encoding="utf-8").splitlines()) <= most


def test_the_method_and_all_documents_have_few_words():
    assert words_of(DOCS / "method.md") <= 12_000
    counts = {page.relative_to(ROOT).as_posix(): words_of(page) for page in (README, *DOCS.rglob("*.md"))}
    longest = sorted(counts.items(), key=lambda item: -item[1])[:8]
    assert sum(counts.values()) <= 80_000, longest
