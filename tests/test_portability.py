"""What Windows, macOS and the oldest Python need, as far as it shows in the source."""

from __future__ import annotations

import ast
import pathlib
from typing import Iterator

import pytest

from tests.every_file import wrong

ROOT = pathlib.Path(__file__).resolve().parents[1]
SHIPPED = [ROOT / "__init__.py", ROOT / "plugin.py"]
for _folder in ("repm_qgis", "processing_provider", "desktop"):
    SHIPPED += sorted((ROOT / _folder).rglob("*.py"))
EVERYTHING = [*SHIPPED, *sorted((ROOT / "tests").rglob("*.py")), *sorted((ROOT / "benchmarks").rglob("*.py"))]
OLDEST = (3, 9)

# What Python has on POSIX systems alone (docs.python.org, "Availability: Unix").
POSIX = {
    "os": """killpg getpgrp getpgid setpgid setsid fork forkpty getuid geteuid getgid getegid getgroups uname statvfs
        fstatvfs mkfifo mknod nice chown lchown fchown wait wait3 wait4 waitid WNOHANG pread pwrite posix_fadvise
        posix_fallocate posix_spawn register_at_fork sched_getaffinity sched_setaffinity sched_yield sysconf confstr
        getloadavg getpriority setpriority openpty ttyname tcgetpgrp chroot lockf sync O_NOFOLLOW O_DIRECTORY O_CLOEXEC
        fchdir pipe2 sendfile""".split(),
    "signal": """SIGKILL SIGALRM SIGHUP SIGUSR1 SIGUSR2 SIGCHLD SIGPIPE SIGQUIT SIGSTOP SIGCONT SIGTSTP alarm setitimer
        getitimer pause pthread_kill pthread_sigmask sigwait siginterrupt""".split(),
    "time": ["tzset", "clock_gettime", "pthread_getcpuclockid"],
}
POSIX_MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog", "posix", "crypt", "readline"}
POSIX_ARGUMENTS = {"start_new_session", "preexec_fn", "pass_fds", "process_group"}
ASKED = ("sys.platform", "os.name", "_WINDOWS", "hasattr(", "get_all_start_methods()")


def posix_only(source: str) -> list[str]:
    """``line: name`` of what Windows lacks and what stands where Windows can come to.

    Guarded is what lies under a question for the system (``ASKED``) or after one that returns, in a ``try`` that takes
    AttributeError or ImportError, or in a function that the module calls from guarded places alone.
    """
    tree = ast.parse(source)
    parents = {child: parent for parent in ast.walk(tree) for child in ast.iter_child_nodes(parent)}
    functions = {node.name: node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    safe: set[str] = set()
    while True:
        found = {
            name
            for name, node in functions.items()
            if name.startswith("_")
            and (uses := _uses(tree, name))
            and all(_guarded(use, parents, safe - {name}) for use in uses)
        }
        if found == safe:
            break
        safe = found
    return [f"{node.lineno}: {name}" for node, name in _posix_names(tree) if not _guarded(node, parents, safe)]


def _uses(tree: ast.AST, name: str) -> list[ast.AST]:
    """Where a function or method is named, its definition aside."""
    return [
        node
        for node in ast.walk(tree)
        if (isinstance(node, ast.Name) and node.id == name) or (isinstance(node, ast.Attribute) and node.attr == name)
    ]


def _posix_names(tree: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.attr in POSIX.get(node.value.id, ()):
                yield node, f"{node.value.id}.{node.attr}"
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
            if node.module in POSIX_MODULES or (node.module == "multiprocessing" and "forkserver" in names):
                yield node, f"{node.module} {' '.join(names)}"
            for name in names:
                if name in POSIX.get(node.module or "", ()):
                    yield node, f"{node.module}.{name}"
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name in POSIX_MODULES:
                    yield node, alias.name
        elif isinstance(node, ast.keyword) and node.arg in POSIX_ARGUMENTS:
            yield node.value, node.arg
        elif isinstance(node, ast.Constant) and node.value in POSIX_ARGUMENTS:
            yield node, str(node.value)


def _guarded(node: ast.AST, parents: dict[ast.AST, ast.AST], safe: set[str]) -> bool:
    while node in parents:
        child, node = node, parents[node]
        if isinstance(node, (ast.If, ast.IfExp, ast.While)) and _asks(node.test):
            return True
        if isinstance(node, ast.BoolOp) and any(_asks(value) for value in node.values[: node.values.index(child)]):
            return True
        if isinstance(node, ast.Try) and child in node.body and any(_takes_absence(each) for each in node.handlers):
            return True
        for name in ("body", "orelse", "finalbody"):
            block = getattr(node, name, None)
            if isinstance(block, list) and child in block and any(map(_leaves, block[: block.index(child)])):
                return True
        if isinstance(node, ast.FunctionDef) and node.name in safe:
            return True
    return False


def _asks(test: ast.AST) -> bool:
    text = ast.unparse(test)
    return any(word in text for word in ASKED)


def _leaves(statement: ast.stmt) -> bool:
    """Whether a statement asks for the system and goes no further on the other one."""
    ends = (ast.Return, ast.Raise, ast.Continue)
    return isinstance(statement, ast.If) and _asks(statement.test) and isinstance(statement.body[-1], ends)


def _takes_absence(handler: ast.ExceptHandler) -> bool:
    text = ast.unparse(handler.type) if handler.type else "Exception"
    return any(word in text for word in ("AttributeError", "ImportError", "ModuleNotFoundError"))


@pytest.mark.long
def test_nothing_that_windows_lacks_is_used_unasked():
    assert wrong(SHIPPED, lambda path: posix_only(path.read_text(encoding="utf-8"))) == {}


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("import os\nos.killpg(1, 2)", ["2: os.killpg"]),
        ("import fcntl", ["1: fcntl"]),
        ("from os import fork", ["1: os.fork"]),
        ("from multiprocessing import forkserver", ["1: multiprocessing forkserver"]),
        ("subprocess.Popen(x, start_new_session=True)", ["1: start_new_session"]),
        ("more = {'preexec_fn': f}", ["1: preexec_fn"]),
        ("def f():\n    return signal.SIGKILL\nf()", ["2: signal.SIGKILL"]),
        ("if os.name == 'nt':\n    pass\nos.getuid()", ["3: os.getuid"]),
        ("def _f():\n    os.fork()\n_f()\nif sys.platform != 'win32':\n    _f()", ["2: os.fork"]),
        ("if hasattr(os, 'killpg'):\n    os.killpg(1, 2)", []),
        ("x = os.getuid() if hasattr(os, 'getuid') else 0", []),
        ("x = hasattr(os, 'getuid') and os.getuid() == 0", []),
        ("def f():\n    if sys.platform == 'win32':\n        return 1\n    import resource", []),
        ("try:\n    os.sysconf('A')\nexcept AttributeError:\n    pass", []),
        ("def _f():\n    os.fork()\nif os.name != 'nt':\n    _f()", []),
        ("def _g():\n    os.fork()\ndef _f():\n    _g()\nif os.name != 'nt':\n    _f()", []),
    ],
)
def test_the_rule_finds_what_it_is_for(code, found):
    assert posix_only(code) == found


def too_new(path: pathlib.Path) -> str:
    """Why the oldest Python cannot read a file, "" where it can."""
    try:
        ast.parse(path.read_text(encoding="utf-8"), feature_version=OLDEST)
    except SyntaxError as error:
        return str(error)
    return ""


@pytest.mark.long
def test_the_oldest_python_can_read_everything(tmp_path):
    assert wrong(EVERYTHING, too_new) == {}
    newer = tmp_path / "newer.py"
    newer.write_text("match x:\n    case 1:\n        pass\n", encoding="utf-8")
    assert too_new(newer)


def without_encoding(path: pathlib.Path) -> list[int]:
    """Lines in which text is read or written in the system's own encoding."""
    unnamed = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or any(keyword.arg in ("encoding", None) for keyword in node.keywords):
            continue
        function = ast.unparse(node.func)
        words = [each.value for each in node.args if isinstance(each, ast.Constant) and isinstance(each.value, str)]
        if function in ("open", "os.fdopen") and not any("b" in word for word in words[-1:]):
            unnamed.append(node.lineno)
        texts = [each for each in node.keywords if each.arg in ("text", "universal_newlines")]
        if function.startswith("subprocess.") and texts:
            unnamed.append(node.lineno)
        if (
            function.endswith(".read_text")
            and not node.args
            or function.endswith(".write_text")
            and len(node.args) == 1
        ):
            unnamed.append(node.lineno)
    return unnamed


def test_text_is_read_and_written_as_utf_8(tmp_path):
    """Windows takes its code page where none is named."""
    assert wrong(SHIPPED, without_encoding) == {}
    careless = tmp_path / "careless.py"
    careless.write_text("open('a')\nopen('b', 'rb')\np.read_text()\nopen('c', encoding='utf-8')\n", encoding="utf-8")
    assert without_encoding(careless) == [1, 3]


def test_no_two_files_differ_in_case_alone():
    """Windows and macOS would keep one of them."""
    folders = [
        ROOT / name for name in ("repm_qgis", "processing_provider", "resources", "docs", "i18n", "scripts", "tests")
    ]
    names = [path.relative_to(ROOT).as_posix() for folder in folders for path in folder.rglob("*")]
    assert len({name.casefold() for name in names}) == len(names)


def test_names_of_files_are_short_enough_for_a_profile_on_windows():
    """Windows ends paths at 260 characters; a profile's plugin folder takes about 100 of them."""
    names = [
        path.relative_to(ROOT).as_posix()
        for folder in ("repm_qgis", "processing_provider", "resources", "docs", "i18n")
        for path in (ROOT / folder).rglob("*")
    ]
    assert [name for name in names if len(name) > 120] == []
