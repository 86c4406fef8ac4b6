#!/usr/bin/env python3
"""Mutation testing ('make mutation'): what share of small faults in the code makes a test fail.

Cosmic Ray makes the faults (mutants), one at a time, in a copy of the checkout, and runs the fast tests of the mutated
module that run the mutated statement (Coverage.py says which do), until one fails: those of the module's own file
first, then the others of its folder. Statements that only an import or a fixture runs have all of them. Of the tool's
mutations of an operator those that a person might write are taken (``_TAKEN``); the others, such as a shift of floats,
fail at once and would only flatter the share.

Every mutant belongs to a rule or to none. *Platform* rules name code that Linux never runs: such mutants are not made.
*Equivalent* rules name code in which a mutation changes nothing that a caller can rely on; these mutants are tried, and
the share is given with them and without.

``dist/mutation/survivors.diff`` shows the mutants that no test noticed; ``--again`` tries only these.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from difflib import unified_diff
from multiprocessing import Queue, get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, Iterator, List, Sequence, Tuple

Mutant = Dict[str, Any]
ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / "dist" / "mutation"
PYTHON = str(ROOT / ".venv" / "bin" / "python")
PACKAGES = ("geometry", "rpc", "planning", "ties", "pointing", "registration")
MODULES = ("runtime/workspace.py", "runtime/parallel.py", "reports/verdict.py")
SLOW = ("test_fuzz.py", "test_gridding_of_truth.py")  # whole campaigns and scenes
ALSO = {  # tests of stages, for what has no test of its own
    "planning": ("stages/test_early.py",),
    "pointing": ("stages/test_early.py",),
    "registration": ("stages/test_register.py", "stages/test_dem_offset.py"),
}
MEMORY_BYTES = 8 << 30  # of one test process: a mutant may ask for any size

_BINARY = "Add_Sub Sub_Add Mul_Div Div_Mul FloorDiv_Div Mod_Mul Pow_Mul BitAnd_BitOr BitOr_BitAnd LShift_RShift"
_COMPARISON = "Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq Is_IsNot IsNot_Is"
_SIDES = ("_Lt_LtE", "_LtE_Lt", "_Gt_GtE", "_GtE_Gt")  # of a limit
_TAKEN = {
    *(f"ReplaceBinaryOperator_{pair}" for pair in _BINARY.split()),
    *(f"ReplaceComparisonOperator_{pair}" for pair in _COMPARISON.split()),
    *(f"ReplaceUnaryOperator_Delete_{name}" for name in ("USub", "Not", "Invert")),
    *("AddNot", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "NumberReplacer", "ZeroIterationForLoop"),
    *("ExceptionReplacer", "RemoveDecorator"),
}

# --- rules ----------------------------------------------------------------------------------------------------------

PLATFORM = "platform: branches for Windows and macOS"
MESSAGE = "equivalent: what a message says"
LIMIT = "equivalent: limits of iterations, and of what hostile files may have"
SPEED = "equivalent: speed only"
VALUE = "equivalent: values that benchmarks have chosen (parameters.py)"
TYPING = "equivalent: types, and that objects are frozen"
EQUALITY = "equivalent: which side of a limit its very value, a float, belongs to"
ROUNDING = "equivalent: clamps against rounding, and the start of a maximum"
_LIMITS = re.compile(r"_?(MAX_\w+|STEPS|\w+_STEPS|\w*TOLERANCE\w*)")
_SPEED = re.compile(r"_CHUNK|_POLL_S|_FEW|\w+_THRESHOLD|keep_freed_memory|lru_cache")
_FLOAT = re.compile(r"\b\d+\.\d|\de-|\bnp\.(abs|median|linalg)|_(px|m|PX|weight|score)\b|\bbox(es)?\b|\.bounds\b")
_OTHER_SYSTEM = re.compile(r"(sys\.platform|os\.name) [!=]= '(win32|darwin|nt)'|'forkserver' not in")

Span = Tuple[Tuple[int, int], Tuple[int, int], str]


def spans(source: str) -> List[Span]:
    """The parts of a module that belong to a rule: first and last place (line, column), and the rule."""
    return [_span(node, rule) for node, rule in _ruled(ast.parse(source))]


def _span(node: Any, rule: str) -> Span:
    return (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset), rule


def _between(comparison: ast.Compare) -> Iterator[Any]:
    """The places of a comparison's operators: from the end of one side to the start of the next."""
    sides: List[Any] = [comparison.left, *comparison.comparators]
    for first, second in zip(sides, sides[1:]):
        start, end = (first.end_lineno, first.end_col_offset), (second.lineno, second.col_offset)
        yield SimpleNamespace(lineno=start[0], col_offset=start[1] + 1, end_lineno=end[0], end_col_offset=end[1])


def _ruled(tree: ast.Module) -> Iterator[Tuple[Any, str]]:
    for node in ast.walk(tree):
        if isinstance(node, (ast.If, ast.IfExp)) and _OTHER_SYSTEM.search(ast.unparse(node.test)):
            parts: Sequence[ast.AST] = [node]
            if isinstance(node, ast.If):
                parts = node.body
            yield from ((part, PLATFORM) for part in parts)
        elif isinstance(node, ast.FunctionDef):
            if node.name.startswith("_windows"):
                yield node, PLATFORM
            elif _SPEED.fullmatch(node.name):
                yield node, SPEED
            yield from ((one, SPEED) for one in node.decorator_list if _SPEED.search(ast.unparse(one)))
            arguments = [*node.args.args, *node.args.kwonlyargs]
            yield from ((one, TYPING) for one in [node.returns, *(a.annotation for a in arguments)] if one is not None)
        elif isinstance(node, ast.ClassDef):
            yield from ((word, TYPING) for one in node.decorator_list for word in getattr(one, "keywords", ()))
        elif isinstance(node, ast.Compare) and _FLOAT.search(ast.unparse(node)):
            yield from ((one, EQUALITY) for one in _between(node))
        elif isinstance(node, ast.Raise) and node.exc is not None:
            yield node.exc, MESSAGE
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Error"):
            yield node, MESSAGE
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("max", "min"):
            yield from ((one, ROUNDING) for one in node.args if re.fullmatch(r"-?1\.0", ast.unparse(one)))
        elif isinstance(node, ast.keyword) and node.arg == "initial":
            yield node.value, ROUNDING
        elif isinstance(node, ast.Assign):
            names = " ".join(ast.unparse(target) for target in node.targets)
            for pattern, rule in ((_LIMITS, LIMIT), (_SPEED, SPEED)):
                if any(pattern.fullmatch(name) for name in re.findall(r"\w+", names)):
                    yield node.value, rule
        elif isinstance(node, ast.For) and re.fullmatch(r"range\(\d+\)", ast.unparse(node.iter)):
            yield node.iter, LIMIT


def rule_of(start: Tuple[int, int], parts: Sequence[Span]) -> str:
    """The rule that a place belongs to, "" for none; a platform's before all others."""
    found = sorted(rule for first, last, rule in parts if (first[0], max(first[1] - 1, 0)) <= start < last)
    return next((rule for rule in found if rule == PLATFORM), found[0] if found else "")


# --- mutants --------------------------------------------------------------------------------------------------------


def modules(only: str) -> List[Path]:
    """The modules to mutate, relative to the checkout, in whose paths a pattern is found."""
    engine = ROOT / "repm_qgis"
    every = [path for package in PACKAGES for path in sorted((engine / package).glob("*.py"))]
    every += [engine / name for name in MODULES]
    return [path.relative_to(ROOT) for path in every if re.search(only, path.as_posix()) and path.name != "__init__.py"]


def mutants_of(module: Path) -> List[Mutant]:
    """All mutants of a module that are taken, each with the rule that it belongs to."""
    from cosmic_ray.commands import init
    from cosmic_ray.work_db import WorkDB, use_db

    path = str(PLACE / "session.sqlite")
    parts = spans((ROOT / module).read_text(encoding="utf-8"))
    if module.name == "parameters.py":
        parts = [((1, 0), (sys.maxsize, 0), VALUE)]
    found = []
    with use_db(path, WorkDB.Mode.create) as session:
        init([ROOT / module], session, {})
        for item in session.work_items:
            (mutation,) = item.mutations
            operator = mutation.operator_name
            if operator.split("/")[-1] in _TAKEN:
                place = {"operator": operator, "occurrence": mutation.occurrence, "line": mutation.start_pos[0]}
                rule = rule_of(mutation.start_pos, parts)
                if rule == EQUALITY and not operator.endswith(_SIDES):
                    rule = ""
                found.append({"module": str(module), **place, "rule": rule})
    return sorted(found, key=lambda one: (one["line"], one["operator"], one["occurrence"]))


def drawn(mutants: Sequence[Mutant], sample: int, seed: int) -> List[Mutant]:
    """A sample of about so many (0: all), of each module in proportion to its mutants."""
    share, result = (sample / len(mutants) if 0 < sample < len(mutants) else 1.0), []
    for module in sorted({one["module"] for one in mutants}):
        own = [one for one in mutants if one["module"] == module]
        chance = random.Random(f"{seed} {module}")  # noqa: S311
        result += chance.sample(own, max(1, round(share * len(own))))
    return result


def tests_of(module: str) -> Tuple[str, ...]:
    """The fast tests of a module: its own file, then the others of the folder, then those of stages."""
    path = Path(module)
    folder = Path("tests/engine", *path.parts[1:-1])
    own = [folder / f"test_{before}{path.name}" for before in ("", f"{path.parts[1][:4]}_")]
    every = own[:1] if len(path.parts) == 2 else sorted(one.relative_to(ROOT) for one in (ROOT / folder).glob("test_*"))
    ordered = sorted(every, key=lambda one: (one not in own, one))
    ordered += [Path("tests/engine", name) for name in ALSO.get(path.parts[1], ())]
    return tuple(str(one) for one in ordered if one.name not in SLOW)


# --- trying them ----------------------------------------------------------------------------------------------------


def copy_checkout(number: int) -> Path:
    """A copy of the files that git knows or would add, for one worker; and the shared data beside it."""
    copy = PLACE / f"copy{number}" / "checkout"
    shutil.rmtree(copy.parent, ignore_errors=True)
    listed = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(listed, stdout=subprocess.PIPE, check=True, text=True).stdout.split("\0"):
        if name and (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
    (copy.parent / "shared").symlink_to(ROOT.parent / "shared")
    # Compiled by content: times of two mutants may be the same.
    compile_all = [PYTHON, "-m", "compileall", "-q", "--invalidation-mode", "checked-hash", "repm_qgis"]
    subprocess.run(compile_all, cwd=copy, check=True)
    return copy


_SERVER = """
import os, resource, signal, sys, time
sys.path.insert(0, os.getcwd())
sys.path.append(os.environ["REPM_TOOLS"])
import cv2, numpy, pyproj, pytest, scipy.interpolate, scipy.ndimage
from osgeo import gdal, gdal_array, ogr, osr
class Durations:
    def __init__(self):
        self.seconds = {}
    def pytest_runtest_logreport(self, report):
        name = report.nodeid.split("[")[0]
        for each in (name, name.split("::")[0]):
            self.seconds[each] = self.seconds.get(each, 0.0) + report.duration
def covered(path, tests):
    import json, coverage
    durations = Durations()
    measured = coverage.Coverage(data_file=None, source=["repm_qgis"], config_file=False)
    measured.set_option("run:dynamic_context", "test_function")
    measured.start()
    code = pytest.main(tests, plugins=[durations])
    measured.stop()
    data = measured.get_data()
    found = {os.path.relpath(file): data.contexts_by_lineno(file) for file in data.measured_files()}
    with open(path, "w") as stream:
        json.dump([durations.seconds, found], stream)
    return code
for line in sys.stdin:
    limit, coverage_file, *files = line.split()
    child = os.fork()
    if not child:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (int(float(limit)),) * 2)
        quiet = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(quiet, stream)
        tests = ["-q", "-x", "-p", "no:pytest_qgis", "-p", "no:cacheprovider", *files]
        os._exit(pytest.main(tests) if coverage_file == "-" else covered(coverage_file, tests))
    end = time.monotonic() + 8 * float(limit)  # for what waits and does nothing, however many share the cores
    status = None
    while status is None and time.monotonic() < end:
        time.sleep(0.02)
        number, code = os.waitpid(child, os.WNOHANG)
        status = os.waitstatus_to_exitcode(code) if number else None
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:
        pass
    if status is None:
        os.waitpid(child, 0)
    print(124 if status is None else status, flush=True)
"""
"""What runs tests in a copy of itself for each mutant: to import numpy, OpenCV, GDAL and pytest takes a second."""


class Tests:
    """Runs tests in the folder that is the current one; after a limit of CPU seconds they count as failed."""

    def __init__(self) -> None:
        tools = next(iter((PLACE / "tool").glob("lib/python*/site-packages")), "")
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "REPM_TOOLS": str(tools)}
        command, pipe = [PYTHON, "-c", _SERVER], subprocess.PIPE
        self._server = subprocess.Popen(command, text=True, env=environment, stdin=pipe, stdout=pipe)

    def code(self, tests: Sequence[str], limit_s: float, coverage: str = "-") -> int:
        """pytest's exit code, 0 where all passed; negative or 124 after the limit. A file for ``coverage`` gets the
        tests that run each line of each module."""
        if self._server.stdin is None or self._server.stdout is None:
            raise RuntimeError("the server of tests has no pipes")
        self._server.stdin.write(f"{limit_s} {coverage} {' '.join(tests)}\n")
        self._server.stdin.flush()
        return int(self._server.stdout.readline())


_tests: List[Tests] = []


def _enter(copies: "Queue[str]") -> None:
    """Begin a worker in a copy of its own."""
    os.chdir(copies.get())
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # a mutant of kill(number, 0) sends it
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    _tests.append(Tests())


def _try(mutant: Mutant, tests: Sequence[str], limit_s: float) -> Mutant:
    from cosmic_ray.mutating import use_mutation
    from cosmic_ray.plugins import get_operator

    with use_mutation(Path(mutant["module"]), get_operator(mutant["operator"])(), mutant["occurrence"]) as (old, new):
        code = _tests[0].code(tests, limit_s)
    changed = "\n".join(line for line in unified_diff(old.splitlines(), new.splitlines(), n=1, lineterm=""))
    return {**mutant, "outcome": "killed" if code else "survived", "diff": changed}


def _measured(files: Sequence[str]) -> Tuple[Dict[str, float], Dict[str, Dict[str, List[str]]]]:
    """How long each test and file of tests takes without a mutant, s, and those that run each line of each module;
    raises RuntimeError where they fail."""
    path = Path("coverage.json").resolve()
    if _tests[0].code(files, 1200.0, str(path)):
        raise RuntimeError(f"these tests fail without any mutant, make them pass first: {' '.join(files)}")
    seconds, lines = json.loads(path.read_text(encoding="utf-8"))
    return seconds, lines


def chosen_tests(mutant: Mutant, files: Sequence[str], lines: Dict[str, List[str]]) -> Sequence[str]:
    """Of these files the tests that run the mutated statement; all files where only an import or a fixture does."""
    tree = ast.parse((ROOT / mutant["module"]).read_text(encoding="utf-8"))
    around = [node for node in ast.walk(tree) if isinstance(node, ast.stmt) and _holds(node, mutant["line"])]
    inner = max(around, key=lambda node: node.lineno, default=None)
    first, last = (inner.lineno, _end_of(inner)) if inner else (mutant["line"], mutant["line"])
    names = {name for line in range(first, last + 1) for name in lines.get(str(line), ()) if name}
    places = {(Path(file).stem, file) for file in files}
    found = [
        (files.index(file), f"{file}::{name.split('.')[-1]}")
        for name in names
        for stem, file in places
        if stem == name.split(".")[-2]
    ]
    return [test for _, test in sorted(found)] or files


def _holds(node: ast.stmt, line: int) -> bool:
    return node.lineno <= line <= (node.end_lineno or node.lineno)


def _end_of(node: ast.stmt) -> int:
    """The last line of a statement itself, without the statements in it."""
    inside = [each.lineno for each in getattr(node, "body", ()) if isinstance(each, ast.stmt)]
    return max(node.lineno, min(inside) - 1) if inside else node.end_lineno or node.lineno


def try_all(mutants: Sequence[Mutant], jobs: int, before: Sequence[Mutant]) -> List[Mutant]:
    """Earlier results, and each mutant with its outcome, "killed" or "survived"; kept as they come."""
    copies = [copy_checkout(number) for number in range(jobs)]
    tests = {module: tests_of(module) for module in sorted({one["module"] for one in mutants})}
    context = get_context("fork")
    places = context.Queue()
    for copy in copies:
        places.put(str(copy))
    results, count = list(before), len(before) + len(mutants)
    with ProcessPoolExecutor(jobs, context, _enter, (places,)) as pool:
        # The order of the files differs from module to module, the time does not.
        groups = {module: tuple(sorted(files)) for module, files in tests.items()}
        runs = {group: pool.submit(_measured, group) for group in sorted(set(groups.values()))}
        measured = {module: runs[group].result() for module, group in groups.items()}
        futures = []
        for one in mutants:
            seconds, lines = measured[one["module"]]
            chosen = chosen_tests(one, tests[one["module"]], lines.get(one["module"], {}))
            limit_s = 15 + 4 * sum(seconds.get(test, 0.0) for test in chosen)
            futures.append(pool.submit(_try, one, chosen, limit_s))
        for future in futures:
            results.append(future.result())
            if len(results) % 25 == 0 or len(results) == count:
                sys.stderr.write(f"mutation: {len(results)} of {count} tried, {len(alive(results))} not noticed\n")
                keep(results)
    for copy in copies:
        shutil.rmtree(copy.parent, ignore_errors=True)
    return results


# --- what came of it ------------------------------------------------------------------------------------------------


def alive(results: Sequence[Mutant]) -> List[Mutant]:
    """Those that no test noticed."""
    return [one for one in results if one["outcome"] != "killed"]


def keep(results: Sequence[Mutant]) -> None:
    """Write the results, and the changes that no test noticed, where a person or the next run finds them."""
    (PLACE / "results.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    titles = [
        f"# {one['module']}:{one['line']} {one['operator']} {one['rule']}\n{one['diff']}\n" for one in alive(results)
    ]
    (PLACE / "survivors.diff").write_text("\n".join(titles), encoding="utf-8")


def _share(results: Sequence[Mutant]) -> str:
    killed = sum(one["outcome"] == "killed" for one in results)
    return f"{killed} of {len(results)} ({100 * killed / max(len(results), 1):.1f} %)"


def report(mutants: Sequence[Mutant], results: Sequence[Mutant]) -> str:
    """The table by module and the shares with and without the mutants of equivalent rules, in Markdown."""
    ours = [one for one in results if not one["rule"]]
    lines = [
        "| module | mutants | tried | killed, of those without a rule | killed, of all tried |",
        "|---|---|---|---|---|",
    ]
    for module in sorted({one["module"] for one in results}):
        every = sum(one["module"] == module for one in mutants)
        tried, free = ([one for one in part if one["module"] == module] for part in (results, ours))
        lines.append(f"| `{module[len('repm_qgis/') :]}` | {every} | {len(tried)} | {_share(free)} | {_share(tried)} |")
    lines.append(f"| all | {len(mutants)} | {len(results)} | {_share(ours)} | {_share(results)} |")
    for rule, count in sorted(Counter(one["rule"] for one in results if one["rule"]).items()):
        killed = sum(one["outcome"] == "killed" for one in results if one["rule"] == rule)
        lines.append(f"- {rule}: {count} tried, {killed} killed.")
    return "\n".join(lines)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--sample", type=int, default=600, help="how many mutants to try; 0 for all")
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--jobs", type=int, default=max(1, (os.cpu_count() or 2) // 2))
    options.add_argument("--only", default="", help="only modules in whose paths this pattern is found")
    options.add_argument("--again", action="store_true", help="only what survived the last time; the table is of all")
    asked = options.parse_args()
    try:
        import cosmic_ray  # noqa: F401
    except ImportError:
        sys.exit("mutation: this Python has no Cosmic Ray: run 'make mutation', which makes an environment for it.")
    PLACE.mkdir(parents=True, exist_ok=True)
    if not modules(asked.only):
        sys.exit(f"mutation: '{asked.only}' is in the path of no module: give a part of one, such as pointing/.")
    start = time.monotonic()
    mutants = [one for module in modules(asked.only) for one in mutants_of(module) if one["rule"] != PLATFORM]
    last: List[Mutant] = []
    if asked.again:
        last = json.loads((PLACE / "results.json").read_text(encoding="utf-8"))
    chosen = alive(last) if asked.again else drawn(mutants, asked.sample, asked.seed)
    try:
        results = try_all(chosen, asked.jobs, [one for one in last if one["outcome"] == "killed"])
    except RuntimeError as error:
        sys.exit(f"mutation: {error}")
    sys.stdout.write(f"{report(mutants, results)}\n\n")
    sys.stdout.write(f"Seed {asked.seed}, {(time.monotonic() - start) / 60:.0f} min with {asked.jobs} jobs. ")
    sys.stdout.write(f"What no test noticed is in {PLACE / 'survivors.diff'}.\n")


if __name__ == "__main__":
    main()
