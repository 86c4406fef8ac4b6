"""Scripts and benchmarks that no other test runs: what they import from the project is there."""

from __future__ import annotations

import ast
import importlib.machinery
import importlib.util
import pathlib
import re
import subprocess
import sys
import zipfile

import pytest

from tests.every_file import wrong

ROOT = pathlib.Path(__file__).resolve().parents[1]
PROGRAMS = [*sorted((ROOT / "scripts").glob("*.py")), ROOT / "scripts" / "demo", ROOT / "scripts" / "package"]
PROGRAMS += [ROOT / "scripts" / name for name in ("scan", "repm-cluster", "qgis-matrix", "windows-trial")]
PROGRAMS += [ROOT / "scripts" / name for name in ("workflow-trial", "release", "fresh", "check-subject")]
PROGRAMS += sorted((ROOT / "benchmarks").rglob("*.py"))


def missing(module, name):
    """Whether a module has neither this name nor a module of this name below it."""
    if hasattr(importlib.import_module(module), name):
        return False
    return importlib.util.find_spec(f"{module}.{name}") is None


def absent(path):
    """What a program imports from the project and what is not there."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    wanted = [
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ("repm_qgis", "benchmarks")
        for alias in node.names
    ]
    return [f"{module}.{name}" for module, name in wanted if missing(module, name)]


def test_what_programs_import_from_the_project_is_there():
    assert len(PROGRAMS) > 20 and wrong(PROGRAMS, absent) == {}


METADATA = """[general]
name=A
description=A plugin.
version=1
qgisMinimumVersion=3.22
author=A
email=a@example.org
about=A plugin.
tracker=https://example.org/issues
repository=https://example.org
icon=icon.svg
"""
CLEAN = {
    "__init__.py": "def classFactory(iface): ...\n",
    "LICENSE": "-",
    "icon.svg": "<svg/>",
    "metadata.txt": METADATA,
}


def scanned(folder, files, mode=0o644):
    """The exit code and the lines of scripts/scan for a zip of these files."""
    path = folder / "plugin.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            entry = zipfile.ZipInfo(f"plugin/{name}")
            entry.external_attr = mode << 16
            archive.writestr(entry, text)
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "scan"), str(path)], stdout=subprocess.PIPE, text=True, check=False
    )
    return done.returncode, done.stdout.splitlines()


def test_the_scan_passes_a_clean_zip(tmp_path):
    assert scanned(tmp_path, CLEAN) == (0, [])


def test_the_scan_names_every_planted_problem_on_a_line_of_its_own(tmp_path):
    planted = {
        **CLEAN,
        "shell.py": "import subprocess  # nosec B404\nsubprocess.call(input(), shell=True)\n",
        "key.py": f'where = "AKIA{"IOSFODNN7EXAMPLE"}"\n',
        ".bandit": "",
        "run.sh": "",
        "metadata.txt": METADATA.replace("about=A plugin.", "supportsQt6=True").replace("icon.svg", "gone.svg"),
    }
    del planted["LICENSE"]
    code, lines = scanned(tmp_path, planted, mode=0o755)
    assert code == 1
    for start, count in {
        "./plugin/shell.py:2: B602: ": 1,
        "plugin/key.py:1: detect-secrets: AWS Access Key": 1,
        "plugin/.bandit: name: ": 1,
        "plugin/run.sh: name: ": 1,
        "plugin/LICENSE: name: it is missing": 1,
        "plugin/metadata.txt: metadata: ": 3,
        "plugin/icon.svg: mode: ": 1,
    }.items():
        assert sum(line.startswith(start) for line in lines) == count, (start, lines)
    assert not [line for line in lines if "B404" in line]


def script(name):
    """A program of scripts/ as a module."""
    loader = importlib.machinery.SourceFileLoader(name.replace("-", "_"), str(ROOT / "scripts" / name))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def test_the_workflows_have_pinned_actions_and_steps_that_can_be_tried_here():
    yaml, trial = pytest.importorskip("yaml"), script("workflow-trial")
    steps = [
        step
        for path in (ROOT / ".github" / "workflows").glob("*.yml")
        for job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"].values()
        for step in job["steps"]
    ]
    used = {step["uses"] for step in steps if "uses" in step}
    assert not [each for each in used if not re.fullmatch(r"[\w./-]+@([0-9a-f]{40}|v\d+\.\d+\.\d+)", each)]
    assert {each.split("@")[0] for each in used} <= set(trial.ACTIONS)
    assert not [step["run"] for step in steps if "${{" in step.get("run", "")]


def test_a_trial_runs_steps_as_a_workflow_does_and_names_the_one_that_fails(tmp_path, monkeypatch):
    pytest.importorskip("yaml")
    trial = script("workflow-trial")
    monkeypatch.setenv("SECRET_OF_THIS_MACHINE", "1")
    steps = [
        {"name": "first", "run": "echo $WORD ${SECRET_OF_THIS_MACHINE:-hidden} > made; ls -A ~ | wc -l >> made"},
        {"name": "second", "run": "false | cat\ntest $WORD = two", "env": {"WORD": "two"}},
        {"name": "third", "run": "false | cat", "shell": "bash"},
    ]
    job = trial.Trial("job", {"steps": steps, "env": {"WORD": "one"}}, tmp_path, {"made": "written"})
    job.clone.mkdir()
    with pytest.raises(trial.Failure, match=r"job, step 3 \(third\): exit code 1"):
        job.run()
    assert (job.clone / "written").read_text().split() == ["one", "hidden", "0"]
    with pytest.raises(trial.Failure, match="no stand-in for someone/else"):
        trial.Trial("job", {"steps": [{"uses": "someone/else@v1.0.0"}]}, tmp_path / "other", {}).run()


def test_what_fresh_systems_print_is_judged():
    fresh = script("fresh")
    assert fresh.shares("share none 86.204\nshare 3d 87.9\n") == "within 1 m: 86.20 %, aligned 87.90 %"
    table = "  alignment           RMSE  COMPLETENESS\n  none          2.0   86.2\n  3d            1.9   87.9\n"
    assert fresh.demo_shares(table) == "within 1 m: 86.20 %, aligned 87.90 %"
    report = '<?xml version="1.0"?><testsuites><testsuite><testcase classname="a" name="b"/>{}</testsuite></testsuites>'
    assert fresh.counts(report.format("")) == "1 passed, 0 failed, 0 skipped"
    broken = '<testcase classname="a.test_c" name="d"><failure message="why&#10;more"/></testcase>'
    for judge, said, words in (
        (fresh.shares, "share none 86.2\n", "no figures"),
        (fresh.shares, "share none 12.0\nshare 3d 87.9\n", "at least"),
        (fresh.demo_shares, "KeyError: 'ME'", "no figures"),
        (fresh.installed, "warning", "were not installed"),
        (fresh.counts, "", "no test has passed"),
        (fresh.counts, report.format(broken), "(?s)1 passed, 1 failed.*test_c::d: why$"),
    ):
        with pytest.raises(fresh.Failure, match=words):
            judge(said)


PLAIN = ["Fix three wrong warnings", "Process empty tiles", "Embed the font", "Re-read the scene", "Merge branch 'a.'"]
REFUSED = {
    "": "Give the commit a subject",
    "Fix " + "x" * 69: "Shorten the subject from 73 to 72 characters",
    "Fix the warning.": "without a full stop",
    "Fix the warning; add a test": "one plain statement",
    "Demo: print MEDAE": "one plain statement",
    "fix the warning": "capitalised verb",
    "The warning is gone": "capitalised verb in the imperative, such as 'Fix', and not with 'The'",
    "It works": "capitalised verb",
    "3 warnings fewer": "capitalised verb",
    "Fixed the warning": "imperative: 'Fix' for 'Fixed'",
    "Fixing the warning": "into the imperative",
    "Adds a test": "into the imperative",
}


def test_subjects_of_commits_are_checked_by_the_hook(tmp_path):
    yaml, program = pytest.importorskip("yaml"), str(ROOT / "scripts" / "check-subject")
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    (hook,) = [each for each in hooks if each["id"] == "subject"]
    assert (hook["entry"], hook["stages"]) == ("scripts/check-subject", ["commit-msg"])
    message = tmp_path / "COMMIT_EDITMSG"
    for subject, words in {**dict.fromkeys(PLAIN, ""), **REFUSED}.items():
        message.write_text(f"{subject}\n\nIt was: wrong; now it is right.\n# a comment of git's\n", encoding="utf-8")
        if not subject:
            message.write_text("# a comment of git's\n", encoding="utf-8")
        done = subprocess.run([sys.executable, program, str(message)], capture_output=True, text=True, check=False)
        assert done.returncode == bool(words) and words in done.stderr, (subject, done.stderr)
        assert len(done.stderr.splitlines()) == bool(words)


def git(*words):
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.splitlines() if done.returncode == 0 else []


def test_the_commits_since_the_hook_came_have_plain_subjects():
    if git("rev-parse", "--is-shallow-repository") != ["false"]:
        pytest.skip("no checkout with its history")
    came = git("log", "--diff-filter=A", "--format=%H", "--", "scripts/check-subject")[-1:]
    # What others began before it came is not theirs to change: commits that have it among their ancestors.
    subjects = git("log", "--no-merges", "--ancestry-path", "--format=%s", f"{came[0]}..HEAD") if came else []
    fault = script("check-subject").fault
    assert {subject: told for subject in subjects if (told := fault(subject))} == {}


@pytest.fixture
def to_release(tmp_path, monkeypatch):
    """scripts/release in a checkout of its own, on main, whose addresses are real; its linters find nothing."""
    git = ["git", "-c", "user.name=A", "-c", "user.email=a@b.org"]
    folder = tmp_path / "checkout"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder)], check=True)
    subprocess.run(["git", "checkout", "--quiet", "-B", "main"], cwd=folder, check=True)
    for name, value in (("user.name", "A"), ("user.email", "a@b.org")):
        subprocess.run(["git", "config", name, value], cwd=folder, check=True)
    metadata = folder / "metadata.txt"
    text = re.sub(r"(?m)^email=.*$", "email=team@dsm.org", metadata.read_text(encoding="utf-8"))
    metadata.write_text(text, encoding="utf-8")
    subprocess.run([*git, "commit", "--quiet", "--all", "--message", "address"], cwd=folder, check=True)
    release = script("release")
    monkeypatch.setattr(release, "ROOT", folder)
    monkeypatch.setattr(release, "tried", lambda root, python: [])
    return release, folder


def state(folder):
    """The commit, the tags and the changes of a checkout."""
    words = (("rev-parse", "HEAD"), ("tag", "--list"), ("status", "--porcelain"))
    return [subprocess.run(["git", *each], cwd=folder, capture_output=True, text=True).stdout for each in words]


@pytest.mark.long
def test_a_release_is_only_tried_unless_one_says_do_it(to_release, capsys):
    release, folder = to_release
    before = state(folder)
    assert release.main(["9.8.7"]) == 0 and "run it again with --do-it" in capsys.readouterr().out
    assert state(folder) == before
    assert release.main(["9.8.7", "--do-it"]) == 0
    assert [part.strip() for part in state(folder)[1:]] == ["v9.8.7", ""]
    with zipfile.ZipFile(folder / "dist" / "repm-9.8.7.zip") as archive:
        metadata, engine, citation, changes = (
            archive.read(f"repm/{name}").decode("utf-8")
            for name in ("metadata.txt", "repm_qgis/__init__.py", "CITATION.cff", "CHANGELOG.md")
        )
    assert "\nversion=9.8.7\n" in metadata and "\nchangelog=9.8.7 (" in metadata
    assert '__version__ = "9.8.7"' in engine and "\nversion: 9.8.7\ndate-released: " in citation
    assert re.search(r"## Unreleased\n\n## 9\.8\.7 \(\d{4}-\d\d-\d\d\)\n", changes)
    assert release.main(["9.8.7"]) == 1
    assert capsys.readouterr().out.splitlines()[-2:] == [
        "The tag v9.8.7 is there already.",
        "CHANGELOG.md: nothing stands under Unreleased.",
    ]


@pytest.mark.long
def test_a_release_names_what_is_in_its_way(to_release, monkeypatch, capsys):
    release, folder = to_release
    monkeypatch.setattr(release, "tried", lambda root, python: ["mypy fails: 1"])
    metadata = folder / "metadata.txt"
    text = re.sub(r"(?m)^email=.*$", "email=who@team.example", metadata.read_text(encoding="utf-8"))
    metadata.write_text(text, encoding="utf-8")
    subprocess.run(["git", "checkout", "--quiet", "-b", "other"], cwd=folder, check=True)
    assert release.main(["0.0.1", "--do-it"]) == 1
    said = capsys.readouterr().out
    for part in (
        "has changes",
        "not on main",
        "is older",
        "'who@team.example', which leads to nobody",
        "mypy fails: 1",
    ):
        assert part in said
    assert release.main(["two"]) == 1 and "'two' is no version" in capsys.readouterr().out
    assert state(folder)[1] == ""


def test_every_file_has_a_name_that_windows_takes():
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode()
    names = [name for name in listing.split("\0") if name]
    assert len(names) > 1000
    assert [name for name in names if re.search(r'[<>:"|?*\\\x00-\x1f]|[ .](/|$)', name)] == []
