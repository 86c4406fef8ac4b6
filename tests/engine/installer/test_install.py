"""The installer against wheels, an index and a proxy of the test's own: whole environments, or none."""

from __future__ import annotations

import base64
import hashlib
import http.server
import json
import os
import signal
import subprocess
import sys
import threading
import time
import urllib.request
import zipfile
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import Cancelled, MissingPackageError, OptionError, WorkspaceError
from repm_qgis.installer import environments
from repm_qgis.installer import install as installation
from repm_qgis.installer.install import install, log_of
from repm_qgis.installer.interpreter import base_program, program_in
from repm_qgis.runtime import packages
from repm_qgis.runtime.progress import Recorder, Silent

ROOT = Path(__file__).resolve().parents[3]
PYTHON = base_program()
WHEELS = {"opencv_python_headless": ("cv2", "4.9"), "pycolmap": ("pycolmap", "4.0"), "laspy": ("laspy", "2.6")}
WHEELS["lazrs"] = ("lazrs", "0.7")
WHEELS["pyfqmr"] = ("pyfqmr", "0.5")


def wheel(folder, name, module, version, code="answer = 42\n"):
    """A tiny wheel of pure Python."""
    path = folder / f"{name}-{version}-py3-none-any.whl"
    info = f"{name}-{version}.dist-info"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{module}.py", code)
        archive.writestr(
            f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: {version}\n"
        )
        archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{info}/RECORD", f"{module}.py,,\n{info}/METADATA,,\n{info}/WHEEL,,\n{info}/RECORD,,\n")
    return path


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    folder = tmp_path_factory.mktemp("all wheels")
    for name, (module, version) in WHEELS.items():
        wheel(folder, name, module, version)
    return folder


class Index(http.server.ThreadingHTTPServer):
    """PyPI's simple pages over a folder; ``hold`` makes it wait before it sends a wheel."""

    def __init__(self, folder):
        super().__init__(("127.0.0.1", 0), _Pages)
        self.folder, self.hold, self.asked = folder, 0.0, []
        self.url = f"http://127.0.0.1:{self.server_address[1]}/simple"
        threading.Thread(target=self.serve_forever, daemon=True).start()


class _Pages(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        name = self.path.strip("/").split("/")[-1]
        self.server.asked.append(name)
        if name.endswith(".whl"):
            time.sleep(self.server.hold)
            body, kind = (self.server.folder / name).read_bytes(), "application/octet-stream"
        else:
            found = [path for path in self.server.folder.iterdir() if packages.name_of(path.name.split("-")[0]) == name]
            links = "".join(
                f'<a href="/files/{path.name}#sha256={hashlib.sha256(path.read_bytes()).hexdigest()}">{path.name}</a>'
                for path in found
            )
            body, kind = f"<!DOCTYPE html><html><body>{links}</body></html>".encode(), "text/html"
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        try:
            self.wfile.write(body)
        except OSError:  # whoever asked has been killed
            pass

    def log_message(self, *arguments):
        pass


class Proxy(http.server.ThreadingHTTPServer):
    """Passes requests for any host on to the index, for one user alone."""

    def __init__(self, index, user="anna:secret"):
        super().__init__(("127.0.0.1", 0), _Passing)
        self.index, self.passed = index, []
        self.word = "Basic " + base64.b64encode(user.encode()).decode()
        self.place = f"127.0.0.1:{self.server_address[1]}"
        threading.Thread(target=self.serve_forever, daemon=True).start()


class _Passing(_Pages):
    def do_CONNECT(self):
        self.send_error(407, "Proxy Authentication Required")

    def do_GET(self):
        if self.headers.get("Proxy-Authorization") != self.server.word:
            self.send_error(407, "Proxy Authentication Required")
            return
        path = self.path.split("/", 3)[3]
        self.server.passed.append(path)
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(f"{self.server.index.url.rsplit('/', 1)[0]}/{path}") as answer:
            body = answer.read()
            self.send_response(200)
            self.send_header("Content-Type", answer.headers["Content-Type"])
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)


@pytest.fixture
def index(wheels, monkeypatch):
    """An index, which pip's settings name; nothing else of this machine's settings counts."""
    for name in [name for name in os.environ if name.startswith("PIP_") or name.lower().endswith("_proxy")]:
        monkeypatch.delenv(name)
    server = Index(wheels)
    for name, value in {
        "CONFIG_FILE": os.devnull,
        "NO_CACHE_DIR": "1",
        "INDEX_URL": server.url,
        "TIMEOUT": "5",
    }.items():
        monkeypatch.setenv(f"PIP_{name}", value)
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture
def home(tmp_path):
    return tmp_path / "a profile" / "repm"


@pytest.fixture
def folder(home):
    return environments.folder_for(str(home), PYTHON)


def answers(folder, module="cv2"):
    code = f"import {module}, numpy; print({module}.answer, {module}.__file__)"
    done = subprocess.run([program_in(folder), "-c", code], stdout=subprocess.PIPE, text=True, check=True)
    assert str(folder) in done.stdout
    return done.stdout.split()[0]


def left(home):
    """What lies in the home of environments, but the log."""
    return [path.name for path in home.iterdir() if not path.name.endswith("install.log")] if home.exists() else []


@pytest.mark.long
def test_it_installs_from_the_index_says_what_and_finds_its_work_again(index, home, folder):
    heard = Recorder(Silent())
    assert install(PYTHON, folder, heard) is True
    assert answers(folder) == "42" and answers(folder, "lazrs") == "42"
    before = heard.notes[0]
    for words in ("pycolmap>=", "(about 90 MB to download)", f"into '{folder}'", "MB are free there", PYTHON):
        assert words in before, before
    assert environments.usable([str(home)], [PYTHON], ROOT / "tests") == folder
    known = json.loads((Path(folder) / "repm-environment.json").read_text())
    assert known["versions"]["pycolmap"] == "4.0" and known["bytes"] > 1000
    assert left(home) == [os.path.basename(folder)] and not (Path(folder) / "tmp").exists()
    assert "installing lazrs" in heard_log(folder) or "Installing collected packages" in heard_log(folder)
    asked = len(index.asked)
    assert install(PYTHON, folder, Silent()) is False and len(index.asked) == asked


def heard_log(folder):
    return Path(log_of(folder)).read_text(encoding="utf-8")


@pytest.mark.long
def test_a_folder_of_wheels_needs_no_network(index, wheels, folder, monkeypatch):
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:1/simple")
    monkeypatch.setenv("PIP_FIND_LINKS", "/nowhere")
    assert install(PYTHON, folder, Silent(), wheels=str(wheels)) and answers(folder) == "42"
    assert index.asked == []


def test_a_folder_without_wheels_is_refused_before_anything_is_made(home, folder, tmp_path):
    with pytest.raises(OptionError, match="WHEELS.*must be a folder that holds wheels"):
        install(PYTHON, folder, Silent(), wheels=str(tmp_path))
    assert not home.exists()


def test_a_wheel_that_is_missing_is_named(index, wheels, home, folder, tmp_path):
    some = tmp_path / "some"
    some.mkdir()
    for path in wheels.glob("*.whl"):
        if "laspy" not in path.name:
            (some / path.name).write_bytes(path.read_bytes())
    with pytest.raises(MissingPackageError, match=r"No wheel of laspy.*is in the folder '.*some': add its wheel"):
        install(PYTHON, folder, Silent(), wheels=str(some))
    assert left(home) == []


@pytest.mark.parametrize("how", ("cut", "bits"))
@pytest.mark.long
def test_a_damaged_wheel_is_named(index, home, folder, wheels, tmp_path, how):
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    for path in wheels.glob("*.whl"):
        (damaged / path.name).write_bytes(path.read_bytes())
    path = damaged / "lazrs-0.7-py3-none-any.whl"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2] if how == "cut" else content.replace(b"answer = 42", b"answer = 43"))
    with pytest.raises(
        MissingPackageError, match=r"The wheel 'lazrs-0.7-.*whl' in '.*damaged' is damaged \(.*get it ag"
    ):
        install(PYTHON, folder, Silent(), wheels=str(damaged))
    assert left(home) == []


@pytest.mark.long
def test_it_installs_behind_a_proxy_and_keeps_its_password(index, home, folder, monkeypatch):
    proxy = Proxy(index)
    monkeypatch.setenv("PIP_INDEX_URL", "https://packages.test/simple")
    monkeypatch.setenv("PIP_TRUSTED_HOST", "packages.test")
    with pytest.raises(MissingPackageError, match="The proxy .* does not let the packages .*407.*user:pass") as caught:
        install(PYTHON, folder, Silent(), proxy=f"http://anna:wrong@{proxy.place}")
    monkeypatch.setenv("PIP_INDEX_URL", "http://packages.test/simple")
    assert left(home) == [] and "wrong" not in str(caught.value) + heard_log(folder)
    assert install(PYTHON, folder, Silent(), proxy=f"anna:secret@{proxy.place}") and answers(folder) == "42"
    assert [path for path in proxy.passed if path.endswith(".whl")] and "secret" not in heard_log(folder)


@pytest.mark.parametrize("proxy", ("", "http://127.0.0.1:1"))
@pytest.mark.long
def test_without_a_network_a_sentence_says_what_to_do(index, home, folder, monkeypatch, proxy):
    host = "packages.test" if proxy else "127.0.0.1:1"
    monkeypatch.setenv("PIP_INDEX_URL", f"https://{host}/simple")
    with pytest.raises(MissingPackageError) as caught:
        install(PYTHON, folder, Silent(), proxy=proxy)
    said = str(caught.value)
    assert said.startswith("The proxy http://127.0.0.1:1 " if proxy else "The package index cannot be reached"), said
    assert "choose a folder of wheels" in said and "\n" not in said
    assert left(home) == []
    assert said in heard_log(folder)


class CancelAt(Silent):
    """Asks to stop once a step's text has these words."""

    def __init__(self, words):
        self.words, self.seen, self.when = words, False, 0.0

    def step(self, fraction, text=""):
        if self.words in text and not self.seen:
            self.seen, self.when = True, time.monotonic()

    def check_cancelled(self):
        if self.seen:
            raise Cancelled


@pytest.mark.parametrize("words", ("downloading", "checking"))
@pytest.mark.long
def test_a_cancel_leaves_nothing_and_is_quick(index, home, folder, words):
    index.hold = 30.0 if words == "downloading" else 0.0
    progress = CancelAt(words if index.hold == 0 else "looking for opencv")
    with pytest.raises(Cancelled):
        install(PYTHON, folder, progress)
    assert progress.seen and time.monotonic() - progress.when < 2
    assert left(home) == []


@pytest.mark.long
def test_a_cancel_does_not_wait_for_slow_imports(index, home, folder, tmp_path):
    """A virus scanner reads each library at its first import, say."""
    for name, (module, version) in WHEELS.items():
        wheel(tmp_path, name, module, version, "import time\ntime.sleep(60)\n")
    progress = CancelAt("checking")
    with pytest.raises(Cancelled):
        install(PYTHON, folder, progress, wheels=str(tmp_path))
    assert progress.seen and time.monotonic() - progress.when < 2
    assert left(home) == []


def started(folder, *arguments):
    return subprocess.Popen(
        [PYTHON, "-m", "repm_qgis.installer", "--folder", str(folder), *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def pips(folder):
    """The living pips of an environment."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            words = (path / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if words[0] == program_in(folder).encode() and b"install" in words:
            found.append(int(path.name))
    return found


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize("name", ("SIGKILL", "SIGTERM"))
@pytest.mark.long
def test_what_a_killed_installation_left_is_made_anew(index, home, folder, name):
    number = getattr(signal, name)
    index.hold = 30.0
    running = started(folder)
    for line in running.stdout:
        if "looking for opencv" in line:
            break
    running.send_signal(number)
    _, errors = running.communicate(timeout=10)
    end = time.monotonic() + 2
    while pips(folder) and time.monotonic() < end:
        time.sleep(0.05)
    assert pips(folder) == []
    if number == signal.SIGTERM:
        assert running.returncode == 1 and "Cancelled by the user." in errors and left(home) == []
    assert environments.usable([str(home)], [PYTHON], ROOT / "tests") == ""
    index.hold = 0.0
    assert install(PYTHON, folder, Silent()) and answers(folder) == "42"
    assert left(home) == [os.path.basename(folder)]


def test_too_little_space_is_refused_before_anything_is_made(index, home, folder, monkeypatch):
    monkeypatch.setattr(environments, "free_bytes", lambda path: 100_000_000)
    with pytest.raises(WorkspaceError, match=r"needs 4\d\d MB, and 100 MB are free: free some space"):
        install(PYTHON, folder, Silent())
    assert left(home) == [] and index.asked == []


@pytest.mark.skipif(os.name == "nt", reason="limits a process with ulimit")
@pytest.mark.long
def test_a_disk_that_fills_up_is_a_sentence_and_leaves_nothing(index, home, folder, wheels, tmp_path):
    large = tmp_path / "large"
    large.mkdir()
    for path in wheels.glob("*.whl"):
        (large / path.name).write_bytes(path.read_bytes())
    (large / "lazrs-0.7-py3-none-any.whl").unlink()
    wheel(large, "lazrs", "lazrs", "0.7", f"answer = 42\nmore = {'x' * 3_000_000!r}\n")
    command = f'ulimit -f 2000; exec "{PYTHON}" -m repm_qgis.installer --folder "{folder}" --wheels "{large}"'
    done = subprocess.run(["bash", "-c", command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "The disk is full" in done.stderr and "free some space" in done.stderr, done.stderr
    assert "Traceback" not in done.stderr and left(home) == []


@pytest.mark.long
def test_a_package_that_cannot_be_imported_is_named(index, home, folder, wheels, tmp_path):
    broken = tmp_path / "broken"
    broken.mkdir()
    for path in wheels.glob("*.whl"):
        (broken / path.name).write_bytes(path.read_bytes())
    wheel(broken, "laspy", "laspy", "2.6", "import os, signal\nos.kill(os.getpid(), signal.SIGABRT)\n")
    with pytest.raises(MissingPackageError, match="The package 'laspy' was installed, but cannot be used"):
        install(PYTHON, folder, Silent(), wheels=str(broken))
    assert left(home) == []


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Requirements that an update of the plugin may change."""
    place = tmp_path / "plugins" / "repm"
    place.mkdir(parents=True)
    (place / "requirements.txt").write_text("# the engine's\nlaspy>=2.5,<3\n")
    for module in (environments, packages):
        monkeypatch.setattr(module, "PLUGIN_FOLDER", place)
    monkeypatch.setattr(packages.requirements_of, "__defaults__", (place,))
    monkeypatch.setattr(installation, "PACKAGES", ())
    return place


@pytest.mark.long
def test_an_update_keeps_the_environment_or_renews_it(index, home, plugin):
    first = environments.folder_for(str(home), PYTHON)
    install(PYTHON, first, Silent())
    (plugin / "requirements.txt").write_text("# other words, the same requirements\nlaspy>=2.5,<3\n\n")
    assert environments.folder_for(str(home), PYTHON) == first and environments.fits(first, [PYTHON])

    (plugin / "requirements.txt").write_text("laspy>=2.5,<3\nlazrs>=0.6,<1\n")
    second = environments.folder_for(str(home), PYTHON)
    assert second != first and not environments.fits(first, [PYTHON])
    assert environments.usable([str(home)], [PYTHON], plugin) == first  # it serves until the new one is whole
    (home / "engine-0000000000").mkdir()  # what a kill has left
    heard = Recorder(Silent())
    install(PYTHON, second, heard)
    assert heard.findings == [] and answers(second, "lazrs") == "42" and left(home) == [os.path.basename(second)]
    assert environments.usable([str(home)], [PYTHON], plugin) == second
    assert environments.remove([second]) == [] and left(home) == []


@pytest.mark.long
def test_a_checkouts_environment_is_brought_up_to_date_in_its_place(index, plugin):
    folder = environments.own_folder(plugin)
    install(PYTHON, folder, Silent())
    (Path(folder) / "mine").touch()
    (plugin / "requirements.txt").write_text("laspy>=2.5,<3\nlazrs>=0.6,<1\n")
    (plugin / "requirements-more.txt").write_text("pycolmap>=3.12\n")
    assert install(PYTHON, folder, Silent(), extras=["requirements-more.txt"])
    assert answers(folder, "lazrs") == answers(folder, "pycolmap") == "42" and (Path(folder) / "mine").exists()
    assert install(PYTHON, folder, Silent()) is False  # it keeps what was added
    assert environments.usable([], [PYTHON], plugin) == folder


def test_an_environment_of_version_0_1_0_is_used(plugin, home):
    folder = environments.own_folder(plugin)
    subprocess.run([PYTHON, "-m", "venv", "--without-pip", "--system-site-packages", folder], check=True)
    if not os.path.exists(program_in(folder)):  # a build for Windows without venv's launcher
        installation._copy_program(PYTHON, os.path.dirname(program_in(folder)))
    assert environments.usable([str(home)], [PYTHON], plugin) == folder
    os.unlink(program_in(folder))
    assert environments.usable([str(home)], [PYTHON], plugin) == ""


def test_a_python_without_venvs_launcher_lends_itself(tmp_path):
    """As some builds for Windows are; what lies beside the program and is none of its libraries stays there."""
    own, scripts = tmp_path / "py", tmp_path / "env" / "Scripts"
    own.mkdir()
    scripts.mkdir(parents=True)
    for name in ("python.exe", "python3.dll", "python312.dll", "vcruntime140.dll", "qgis_core.dll", "notes.txt"):
        (own / name).write_text(name)
    installation._copy_program(str(own / "python.exe"), str(scripts))
    assert sorted(path.name for path in scripts.iterdir()) == [
        "python.exe",
        "python3.dll",
        "python312.dll",
        "vcruntime140.dll",
    ]
