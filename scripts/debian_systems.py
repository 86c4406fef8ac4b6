"""Debian systems in folders, for trials of this project on machines that have nothing: 'qgis-matrix' and 'fresh'.

A system is made by mmdebstrap, from the mirror that this machine's own apt uses; certificates, proxies and pip's
settings are this machine's too. Commands run in it in namespaces of their own: what is mounted there vanishes with
them, however they end, so no clean-up can forget a mount or remove what lies behind one. Standard library only.
"""

from __future__ import annotations

import os
import pathlib
import shlex
import shutil
import subprocess
import tempfile
import xml.etree.ElementTree as ElementTree
from typing import IO, Sequence, Union

ROOT = pathlib.Path(__file__).resolve().parent.parent
AUTHORITIES = pathlib.Path("/usr/local/share/ca-certificates")
PIP_SETTINGS = ("INDEX_URL", "EXTRA_INDEX_URL", "TRUSTED_HOST", "DEFAULT_TIMEOUT", "RETRIES")

INSIDE = """
system=$1
mount --make-rprivate /
mount -t proc proc "$system/proc"
mount --rbind /dev "$system/dev"
mount -t tmpfs tmpfs "$system/dev/shm" 2>/dev/null || true
if [ -n "$2" ]; then
    mkdir -p "$system/srv/shared"
    mount --bind "$2" "$system/srv/shared"
    mount -o remount,ro,bind "$system/srv/shared"
fi
shift 2
exec chroot "$system" /usr/bin/env -i "$@"
"""


class Failure(Exception):
    """What cannot be tried; the message says why and what to do."""


def host_mirror() -> str:
    """The mirror of Debian that this machine's apt uses; raises Failure where it uses none."""
    words = ["apt-get", "indextargets", "--format", "$(ORIGIN) $(LABEL) $(REPO_URI)", "Created-By: Packages"]
    try:
        lines = subprocess.run(words, stdout=subprocess.PIPE, check=True).stdout.decode().splitlines()
    except (OSError, subprocess.CalledProcessError):
        lines = []
    found = [line.split()[2] for line in lines if line.startswith("Debian Debian ")]
    if not found:
        raise Failure("apt uses no mirror of Debian here: run 'apt-get update' on Debian, or name one with --mirror.")
    return found[0]


def lacking(programs: Sequence[str] = ("mmdebstrap", "unshare", "git")) -> str:
    """What has to be installed first, as a sentence; "" where nothing is missing."""
    missing = [name for name in programs if not shutil.which(name)]
    if not missing:
        return ""
    install = "'apt-get install mmdebstrap uidmap util-linux git' installs it"
    return f"{', '.join(missing)} is missing: on Debian and Ubuntu {install}."


class System:
    """A system in a folder, and commands in it."""

    def __init__(self, folder: pathlib.Path, log: pathlib.Path, shared: bool = False) -> None:
        """``shared`` has the folder beside the checkout appear in it, read-only, where there is one."""
        self.folder, self.log = folder, log
        data = ROOT.parent / "shared"
        self.shared = str(data) if shared and data.is_dir() else ""
        # Who is not root gets a user namespace in which the system's owner is root.
        self.as_root = [] if os.geteuid() == 0 else ["mmdebstrap", "--unshare-helper"]

    def make(self, suites: Sequence[str], mirror: str, need_mb: float, options: Sequence[str] = ()) -> bool:
        """Make the system where it is not there yet; a half-made one is never left under its name.

        False where it is there. ``need_mb`` is what must be free, ``options`` are further ones of mmdebstrap.
        """
        if self.folder.is_dir():
            return False
        free = shutil.disk_usage(self.folder.parent).free / 1e6
        if free < need_mb:
            raise Failure(
                f"{self.folder.parent} has {free:.0f} MB free and a system takes {need_mb:.0f}: name another folder."
            )
        part = System(self.folder.with_name(f"{self.folder.name}.part"), self.log)
        part.remove()
        words = ["mmdebstrap", f"--mode={'root' if os.geteuid() == 0 else 'unshare'}", "--variant=minbase"]
        words += ["--include=ca-certificates,git,make", "--format=directory", *options]
        words += [f"--aptopt={line}" for line in _apt_settings()]
        lines = [f"deb {mirror} {suite} main" for suite in suites]
        if self.run([*words, suites[0], str(part.folder), *lines]) != 0:
            part.remove()
            raise Failure(f"mmdebstrap could not make {self.folder.name}: see {self.log}.")
        os.replace(part.folder, self.folder)
        return True

    def copy_to(self, folder: pathlib.Path) -> "System":
        """A copy of this system in another folder, in place of what is there."""
        other = System(folder, self.log)
        other.shared = self.shared
        other.remove()
        folder.mkdir()
        folder.chmod(0o777 if self.as_root else 0o755)  # who is root in the system alone is a stranger to this folder
        copy = f"cp -a --reflink=auto {shlex.quote(str(self.folder))}/* {shlex.quote(str(folder))}"
        if self.run([*self.as_root, "sh", "-c", copy]) != 0:
            raise Failure(f"{self.folder} could not be copied to {folder}: see the end of {self.log}.")
        return other

    def connect(self) -> None:
        """Give the system this machine's names, certificates and settings of pip."""
        for name in ("resolv.conf", "hosts"):
            self.put(pathlib.Path("/etc") / name, f"etc/{name}")
        certificates = sorted(AUTHORITIES.rglob("*.crt")) if AUTHORITIES.is_dir() else []
        for number, path in enumerate(certificates):
            self.put(path, f"usr/local/share/ca-certificates/host-{number}.crt")
        if certificates and self.inside("update-ca-certificates") != 0:
            raise Failure(f"the certificates could not be taken into {self.folder}: see the end of {self.log}.")
        if os.environ.get("PIP_CERT"):
            self.put(pathlib.Path(os.environ["PIP_CERT"]), "etc/repm-ca.pem")
        home = pathlib.Path.home()
        for path in (pathlib.Path("/etc/pip.conf"), home / ".pip" / "pip.conf", home / ".config" / "pip" / "pip.conf"):
            if path.is_file():
                self.put(path, "etc/pip.conf")

    def take(self, keep: str = "") -> str:
        """Make the system's project a clean clone of HEAD, whose name it gives; ``keep`` stays in it."""
        with tempfile.TemporaryDirectory() as place:
            bundle = pathlib.Path(place) / "project.bundle"
            if self.run(["git", "-C", str(ROOT), "bundle", "create", str(bundle), "HEAD"]) != 0:
                raise Failure(f"the commits of {ROOT} could not be packed: see the end of {self.log}.")
            self.put(bundle, "srv/project.bundle")
        clone = "git init -q . && git fetch -q ../project.bundle HEAD && git checkout -q -f --detach FETCH_HEAD"
        kept = f" -e {shlex.quote(keep)}" if keep else ""
        if self.inside(f"{clone} && git clean -q -f -d -x{kept}") != 0:
            raise Failure(f"the commits could not be checked out in {self.folder}: see the end of {self.log}.")
        return self.said("git rev-parse --short HEAD")[1].strip()

    def inside(self, command: str) -> int:
        """Run a shell command in the system's project; gives its exit code."""
        return self.run(self._words(command))

    def said(self, command: str) -> tuple[int, str]:
        """Run a shell command in the system's project; gives its exit code and what it prints, which is logged too."""
        with self.log.open("ab") as log:
            done = subprocess.run(
                self._words(command), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, check=False
            )
            log.write(done.stdout)
        return done.returncode, done.stdout.decode("utf-8", "replace")

    def _words(self, command: str) -> list[str]:
        variables = {name: value for name, value in os.environ.items() if name.lower().endswith("_proxy")}
        for name in filter(os.environ.get, (f"PIP_{each}" for each in PIP_SETTINGS)):
            variables[name] = os.environ[name]
        variables.update(HOME="/root", LANG="C.UTF-8", PATH="/usr/sbin:/usr/bin:/sbin:/bin", LC_ALL="C.UTF-8")
        if os.environ.get("PIP_CERT"):
            variables["PIP_CERT"] = "/etc/repm-ca.pem"
        words = [*self.as_root, "unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-ec", INSIDE, "sh"]
        words += [str(self.folder), self.shared, *(f"{name}={value}" for name, value in variables.items())]
        return [*words, "sh", "-c", f"mkdir -p /srv/project && cd /srv/project && {command}"]

    def put(self, source: pathlib.Path, name: str) -> None:
        """Copy a file of this machine into the system."""
        target = shlex.quote(str(self.folder / name))
        with source.open("rb") as opened:
            if self.run([*self.as_root, "sh", "-c", f"rm -f {target}; cat >{target}"], stdin=opened) != 0:
                raise Failure(f"{source} could not be copied into {self.folder}: see {self.log}.")

    def remove(self) -> None:
        """Remove the system, on its own file system alone."""
        if self.folder.exists():
            self.run([*self.as_root, "find", str(self.folder), "-xdev", "-mindepth", "1", "-delete"])
            self.folder.rmdir()  # its entry in the folder above is the user's own

    def run(self, words: Sequence[str], stdin: Union[int, IO[bytes]] = subprocess.DEVNULL) -> int:
        """Run a program of this machine, with its output in the log."""
        with self.log.open("ab") as log:
            return subprocess.run(words, stdin=stdin, stdout=log, stderr=subprocess.STDOUT, check=False).returncode


def _apt_settings() -> list[str]:
    """Proxies and certificates of this machine's apt."""
    try:
        said = subprocess.run(["apt-config", "dump"], stdout=subprocess.PIPE, check=True).stdout.decode()
    except (OSError, subprocess.CalledProcessError):
        return []
    wanted = ("proxy", "cainfo", "verify-peer", "verify-host", "check-valid-until")
    lines = [line.rstrip(";") for line in said.splitlines() if line.startswith("Acquire::")]
    return [line for line in lines if line.split()[0].lower().endswith(wanted) and line.split()[-1] != '""']


def figures(report: str) -> dict:
    """Counts and what failed, from a JUnit file: the test's name and the first line of its message."""
    suite = next(ElementTree.fromstring(report).iter("testsuite"))  # noqa: S314 - our own pytest wrote it
    failed, skipped = {}, {}
    for case in suite.iter("testcase"):
        # A test that fails and then fails to clean up has two entries, and is one test.
        name = f"{case.get('classname', '').split('.')[-1]}::{case.get('name')}"
        for entry in case:
            if entry.tag in ("failure", "error"):
                failed.setdefault(name, (entry.get("message") or "").strip().split("\n")[0][:200])
            elif entry.tag == "skipped":
                skipped[name] = (entry.get("message") or "").strip().split("\n")[0][:200]
    tests = {f"{case.get('classname')}::{case.get('name')}" for case in suite.iter("testcase")}
    return {"passed": len(tests) - len(failed) - len(skipped), "failed": failed, "skipped": skipped}
