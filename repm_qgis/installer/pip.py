"""pip in a process of its own: its progress by package, its end with ours, and its failures as sentences."""

from __future__ import annotations

import collections
import glob
import os
import queue
import re
import subprocess  # nosec B404 # see its uses
import threading
import zipfile
import zlib
from typing import IO, Callable, Deque, Dict, List, Optional, Sequence

from ..contracts.errors import MissingPackageError, RepmError, WorkspaceError
from ..runtime.packages import name_of
from ..runtime.progress import Progress
from ..runtime.workspace import size_of
from .interpreter import variables

POLL_S = 0.3
_LOOK_S = 1.0
_OLDEST = (20, 3)  # the first with the resolver that keeps constraints
# Settings that would install elsewhere or in another way; the user's index, certificate and cache stay.
_REFUSED = ("TARGET", "PREFIX", "ROOT", "PYTHON", "NO_BINARY", "DRY_RUN", "CONSTRAINT", "REQUIREMENT", "LOG")
# pip ends at once when we are gone, however that happens: the pipe on its standard input closes then.
_RUN = """
import os, runpy, sys, threading
def watch():
    while os.read(0, 4096):
        pass
    os._exit(1)
threading.Thread(target=watch, daemon=True).start()
if sys.argv[1]:
    sys.path.insert(0, sys.argv[1])
sys.argv = ["pip", *sys.argv[2:]]
runpy.run_module("pip", run_name="__main__", alter_sys=True)
"""


def _found(python: str, code: str) -> str:
    """The last line that an interpreter prints for this code; "" where it fails."""
    try:
        done = subprocess.run(  # nosec B603 # no shell, and an argument list of our own
            [python, "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=variables(python),
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return "".join(done.stdout.decode("utf-8", "replace").strip().splitlines()[-1:])


def wheel_with_pip(python: str, wheels: str) -> str:
    """Where pip comes from in an environment: "" (it is there), or the wheel that holds it.

    Its Python's own is visible in it; else the wheel that Python carries, or one in the folder of wheels, serves.
    Raises MissingPackageError where there is none of them.
    """
    version = re.match(r"(\d+)\.(\d+)", _found(python, "import pip; print(pip.__version__)"))
    if version and (int(version.group(1)), int(version.group(2))) >= _OLDEST:
        return ""
    bundled = _found(
        python,
        "import ensurepip, glob, os\n"
        "folder = getattr(ensurepip, '_WHEEL_PKG_DIR', None) or os.path.join(ensurepip.__path__[0], '_bundled')\n"
        "print(sorted(glob.glob(os.path.join(folder, 'pip-*.whl')))[-1])",
    )
    found = (
        [bundled] if bundled else sorted(glob.glob(os.path.join(glob.escape(wheels), "pip-*.whl"))) if wheels else []
    )
    if not found:
        raise MissingPackageError(
            f"The Python of '{python}' has neither pip nor ensurepip: install them with your QGIS (on Debian and "
            "Ubuntu with 'sudo apt install python3-venv'), or put pip's own wheel into the folder of wheels."
        )
    return found[-1]


def settings(python: str, proxy: str, wheels: str, temporary: str) -> Dict[str, str]:
    """pip's variables: the user's settings, without those that would install elsewhere.

    The proxy is a variable and no argument: others could read an argument with its password in the list of processes.
    """
    values = {
        name: value
        for name, value in variables(python).items()
        if name not in {f"PIP_{each}" for each in _REFUSED} and not (wheels and name.startswith("PIP_FIND"))
    }
    values.update(PIP_USER="0", PYTHONNOUSERSITE="1", PYTHONIOENCODING="utf-8", PYTHONUNBUFFERED="1")
    values.update(TMPDIR=temporary, TEMP=temporary, TMP=temporary)
    if proxy:
        address = proxy if "://" in proxy else f"http://{proxy}"
        values.update({name: address for each in ("HTTP_PROXY", "HTTPS_PROXY") for name in (each, each.lower())})
        values.pop("PIP_PROXY", None)
    return values


def install(
    python: str,
    requirements: Sequence[str],
    constraints: str,
    progress: Progress,
    wheels: str = "",
    proxy: str = "",
    expected_bytes: float = 0.0,
    log: Optional[Callable[[str], None]] = None,
) -> None:
    """Install requirements into the environment of ``python``, from the index or a folder of wheels alone.

    ``constraints`` is pip's file of what to keep; ``expected_bytes`` what will be downloaded and unpacked, of which
    progress is a share. ``log`` gets every line. Raises a RepmError in one sentence, and Cancelled.
    """
    folder = os.path.dirname(os.path.dirname(python))
    temporary = os.path.join(folder, "tmp")
    os.makedirs(temporary, exist_ok=True)
    arguments = ["install", "--no-input", "--disable-pip-version-check", "--progress-bar", "off", "--retries", "2"]
    arguments += ["--only-binary", ":all:", "--no-warn-script-location", "--constraint", constraints]
    arguments += ["--no-index", "--find-links", wheels] if wheels else []
    pip = wheel_with_pip(python, wheels)
    with subprocess.Popen(  # nosec B603 # no shell, and an argument list of our own
        [python, "-c", _RUN, pip, *arguments, *requirements],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        cwd=folder,
        env=settings(python, proxy, wheels, temporary),
        creationflags=0x08000000 if os.name == "nt" else 0,  # no window of its own
    ) as process:
        try:
            last = _followed(process, folder, len(requirements), expected_bytes, progress, log or (lambda line: None))
            code = process.wait()
        finally:
            process.kill()
    if code:
        raise failure(last, code, proxy, wheels)


def _followed(
    process: "subprocess.Popen[bytes]",
    folder: str,
    count: int,
    expected_bytes: float,
    progress: Progress,
    log: Callable[[str], None],
) -> List[str]:
    """Report the progress of pip until it ends; gives its last lines."""
    lines: "queue.Queue[Optional[str]]" = queue.Queue()

    def read(stream: IO[bytes]) -> None:
        for line in stream:
            lines.put(without_password(line.decode("utf-8", "replace").rstrip()))
        lines.put(None)

    if process.stdout is not None:
        threading.Thread(target=read, args=(process.stdout,), daemon=True).start()
    last: Deque[str] = collections.deque(maxlen=60)
    began, quiet, doing = size_of(folder), 0.0, "asking for versions"
    while True:
        progress.check_cancelled()
        try:
            line = lines.get(timeout=POLL_S)
        except queue.Empty:
            quiet += POLL_S
            if quiet >= _LOOK_S and expected_bytes:
                quiet = 0.0
                progress.step(min(0.99, (size_of(folder) - began) / expected_bytes), doing)
            continue
        if line is None:
            return list(last)
        last.append(line)
        log(line)
        doing = _doing(line) or doing
        progress.step(0.0, doing)


def _doing(line: str) -> str:
    """The progress text for a line of pip; "" for none."""
    words = line.split()
    if line.lstrip().startswith(("Downloading ", "Using cached ", "Processing ")):
        name = os.path.basename(words[1] if words[0] != "Using" else words[2])
        name = "-".join(name.split("-")[:2])  # without the systems that a wheel is for
        size = " ".join(words[-2:]) if line.endswith(")") else ""
        return f"{'unpacking' if words[0] == 'Processing' else 'downloading'} '{name}' {size}".rstrip()
    if line.startswith("Collecting "):
        return f"looking for {words[1]}"
    return f"installing {' '.join(words[3:])}" if line.startswith("Installing collected packages") else ""


def without_password(text: str) -> str:
    """A line, or a proxy's address with or without its scheme, without users and passwords: ``http://***@host:80``."""
    return re.sub(r"://[^/@\s]+@|^[^/@\s]+@(?=[^/@\s]+$)", _hidden, text)


def _hidden(found: "re.Match[str]") -> str:
    return "://***@" if found[0].startswith("://") else "***@"


_NETWORK = re.compile(
    r"NewConnectionError|NameResolutionError|ConnectTimeout|ReadTimeout|Max retries exceeded|Network is unreachable|"
    r"RemoteDisconnected|ConnectionResetError|Connection aborted|getaddrinfo failed|Temporary failure in name"
)
_CERTIFICATE = re.compile(r"CERTIFICATE_VERIFY_FAILED|SSLCertVerificationError")
_PROXY = re.compile(r"ProxyError|Tunnel connection failed|407 Proxy|Cannot connect to proxy")
_FULL = re.compile(r"No space left on device|\[Errno (?:28|27|122)\]|Disk quota exceeded|\[WinError 112\]")
_LOCKED = re.compile(r"Permission denied|\[WinError (?:5|32)\]|Read-only file system")
_DAMAGED = re.compile(r"^(?:zipfile\.BadZipFile|zlib\.error|EOFError)|Wheel .* is invalid|is an invalid wheel")
_NONE = re.compile(r"No matching distribution found for (\S+)")


def failure(lines: Sequence[str], code: int, proxy: str, wheels: str) -> RepmError:
    """Why pip could not install, and the remedy, in a sentence."""
    text = "\n".join(lines)
    last = lines[-1] if lines else ""
    said = next((line for line in reversed(lines) if line.startswith("ERROR:") and line != "ERROR: Exception:"), last)
    said = " ".join(said.replace("ERROR:", "").split())[:300] or f"exit code {code}"
    if _FULL.search(text):
        return WorkspaceError(f"The disk is full ({said}): free some space, or choose a folder on another disk.")
    if _LOCKED.search(text):
        return WorkspaceError(f"A file cannot be written ({said}): end what runs in this folder, then install again.")
    if _PROXY.search(text):
        name = without_password(proxy) or "that is set"
        return MissingPackageError(
            f"The proxy {name} does not let the packages through ({_reason(_PROXY, lines)}): correct it, such as "
            "http://host:port, with user:password@ before the host where it asks for them, or choose a folder of "
            "wheels."
        )
    if _CERTIFICATE.search(text):
        return MissingPackageError(
            "The package index shows a certificate that is not trusted here: set the variable PIP_CERT to your "
            "organisation's certificate file, or choose a folder of wheels."
        )
    if _NETWORK.search(text):
        return MissingPackageError(
            f"The package index cannot be reached ({_reason(_NETWORK, lines)}): check the network, give your proxy, or "
            "choose a folder of wheels."
        )
    if any(_DAMAGED.search(line) for line in lines):
        name = _damaged_wheel(wheels) if wheels else ""
        if name:
            return MissingPackageError(f"The wheel '{name}' in '{wheels}' is damaged ({said}): get it again.")
        return MissingPackageError(f"A package came damaged over the network ({said}): install again.")
    absent = _NONE.search(text)
    if absent:
        name = name_of(absent.group(1))
        remedy = "add its wheel" if wheels else "choose a folder of wheels that has it"
        where = f"the folder '{wheels}'" if wheels else "the package index"
        return MissingPackageError(f"No wheel of {name} for this Python and system is in {where}: {remedy}.")
    return MissingPackageError(f"pip could not install the packages ({said}): the log says more.")


def _damaged_wheel(folder: str) -> str:
    """The first wheel of a folder that is cut or has other bits than its checksums say, "" for none.

    pip unpacks wheels long after it has named them, and its messages do not say of which a file is.
    """
    for path in sorted(glob.glob(os.path.join(glob.escape(folder), "*.whl"))):
        try:
            with zipfile.ZipFile(path) as wheel:
                if wheel.testzip() is None:
                    continue
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError):
            pass
        return os.path.basename(path)
    return ""


def _reason(pattern: "re.Pattern[str]", lines: Sequence[str]) -> str:
    """The words of the line that matches, short."""
    line = next((line for line in reversed(lines) if pattern.search(line)), "")
    inner = re.findall(r"(?:Tunnel connection failed: |Cannot connect to proxy|\[Errno -?\d+\] )[^'\")]*", line)
    found = pattern.search(line)
    return (inner[-1] if inner else found.group(0) if found else "").strip()
