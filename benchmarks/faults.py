#!/usr/bin/env python3
"""A campaign of faults against whole runs ('make bench-faults'): what was tried, and in how many trials all held.

Whatever happens at whatever moment, a run leaves the old result or the new one, and one sentence that says which.
A trial holds where

* no result with exit code 0 differs from that of an undisturbed run, and no earlier result is lost or half replaced;
* a run that ends by itself says one sentence, and no traceback;
* nothing hangs, and five seconds after the end no process of the run is left;
* the same job, run again in the same workspace, ends with the same bytes.

All moments and mutations come from one seed. ``--share 0.1`` tries a tenth of each kind. On Windows, Cancel is the line
that the plugin sends, and kinds that need what only POSIX has are left out.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Tuple

import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from repm_qgis.contracts.results import SampleDataResult  # noqa: E402

PRODUCTS = {"output": "dsm.tif", "confidence": "confidence.tif", "cloud": "cloud.laz", "ept": "ept", "mesh": "mesh.ply"}
ORPHANS_S = 5.0
HANG_S = 180.0  # or as long as ten undisturbed runs, whichever is longer: a busy machine is no hang
UNDISTURBED_S = 1800.0
_ARRAY_HEADER = 128  # bytes before the values of a NumPy file
WINDOWS = os.name == "nt"
KILL = getattr(signal, "SIGKILL", signal.SIGTERM)  # on Windows, os.kill ends a process at once for any number
MARK = "REPM_FAULTS_TRIAL"  # in the environment of every process of a trial, which is how orphans are found


@dataclass
class Score:
    """Trials of one kind, and what went wrong in those that did not hold."""

    tried: int = 0
    failures: List[str] = field(default_factory=list)
    skipped: str = ""
    longest_s: float = 0.0  # from a cancel until all processes of the run were gone

    def add(self, problems: List[str], name: str) -> None:
        self.tried += 1
        if problems:
            self.failures.append(f"{name}: {'; '.join(problems)}")
            sys.stderr.write(f"faults: {self.failures[-1]}\n")


@dataclass
class Ended:
    """How a process ended: code (negative: signal), its messages, standard error, and how long it took."""

    code: int
    messages: List[Dict[str, Any]]
    errors: str
    seconds: float

    @property
    def last(self) -> Dict[str, Any]:
        return self.messages[-1] if self.messages else {}

    def problems(self, killed: bool = False) -> List[str]:
        """What an end by itself must not look like."""
        found = []
        if "Traceback" in self.errors or self.last.get("type") == "bug":
            found.append(f"traceback: {(self.last.get('text') or self.errors).strip().splitlines()[-1][:160]}")
        if killed:
            return found
        if self.code not in (0, 1):
            found.append(f"exit code {self.code}")
        if self.code == 1 and (self.last.get("type") != "error" or "\n" in str(self.last.get("text"))):
            found.append("exit code 1 without one sentence")
        return found


class Bench:
    """The job that is disturbed: a small simulated town in several tiles, with its undisturbed result."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.random, self._count = folder, random.Random(seed), 0  # noqa: S311 - a reproducible campaign
        self.hang_s = UNDISTURBED_S
        made = self._whole(self.start("sampledata", {"folder": str(folder / "town"), "size": 420}))
        self.images = list(SampleDataResult.from_mapping(made.last["result"]).images)
        start = time.monotonic()
        ended = self._whole(self.start("pipeline", self.job(folder / "reference")))
        self.seconds = time.monotonic() - start
        self.hang_s = max(HANG_S, 10.0 * self.seconds)
        self.reference = digest(folder / "reference")
        sys.stderr.write(f"faults: an undisturbed run takes {self.seconds:.1f} s, {len(self.reference)} products\n")
        if ended.code or len(self.reference) < len(PRODUCTS):
            raise SystemExit(f"faults: the undisturbed run failed: {ended.last}")

    def job(self, place: Path, **options: object) -> Dict[str, Any]:
        made = {name: str(place / file) for name, file in PRODUCTS.items()}
        return {"images": self.images, "workspace": str(place / "w"), "tile_size": 256, "workers": 2, **made, **options}

    def place(self) -> Path:
        """A new empty folder for one trial."""
        self._count += 1
        path = self.folder / f"trial{self._count}"
        path.mkdir()
        return path

    def start(self, stage: str, job: Dict[str, object], limits: Optional[Callable[[], object]] = None) -> "Running":
        self._count += 1
        path = self.folder / f"job{self._count}.json"
        path.write_text(json.dumps(job))
        return Running([sys.executable, "-m", "repm_qgis", stage, str(path)], hang_s=self.hang_s, limits=limits)

    @staticmethod
    def _whole(running: "Running") -> Ended:
        ended = running.end()
        if ended.code:
            hung = f"it was still at work after {UNDISTURBED_S:.0f} s" if ended.code == -999 else ""
            raise SystemExit(f"faults: an undisturbed run failed: {hung or ended.last or ended.errors}")
        return ended


class Running:
    """A process in a session of its own, whose output goes to files: a pipe would hide that orphans hold it open."""

    def __init__(
        self,
        command: List[str],
        hang_s: float = HANG_S,
        environment: Optional[Mapping[str, str]] = None,
        limits: Optional[Callable[[], object]] = None,
    ) -> None:
        self.mark, self._hang_s = os.urandom(8).hex(), hang_s
        self._streams = [tempfile.TemporaryFile() for _ in range(2)]
        self._start = time.monotonic()
        own = {**os.environ, MARK: self.mark, **(environment or {})}
        if WINDOWS:
            own["REPM_ENGINE_WATCH_STDIN"] = "1"  # as the plugin starts it there
        self.process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=own,
            stdin=subprocess.PIPE if WINDOWS else subprocess.DEVNULL,
            stdout=self._streams[0],
            stderr=self._streams[1],
            start_new_session=not WINDOWS,
            creationflags=0x200 if WINDOWS else 0,  # CREATE_NEW_PROCESS_GROUP
            preexec_fn=limits,  # noqa: PLW1509 - one thread here
        )

    def cancel(self) -> None:
        """The line by which the plugin cancels on Windows."""
        if self.process.stdin:
            try:
                self.process.stdin.write(b"cancel\n")
                self.process.stdin.flush()
            except OSError:
                return  # it has ended

    def family(self) -> List[Tuple[int, str]]:
        """All living processes of this run with their command lines, wherever in the tree they are."""
        if WINDOWS:
            return [(pid, f"process {pid} of Windows") for pid in _descendants(self.process)]
        found = []
        for name in filter(str.isdigit, os.listdir("/proc")):
            try:
                own = Path(f"/proc/{name}/environ").read_bytes()
                state = Path(f"/proc/{name}/stat").read_text().rsplit(")", 1)[1].split()[0]
                words = Path(f"/proc/{name}/cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
            except OSError:
                continue
            if f"{MARK}={self.mark}".encode() in own and state != "Z":
                found.append((int(name), words))
        return found

    def end(self) -> Ended:
        """Wait for the end; a run that hangs is killed and has the code -999."""
        try:
            code = self.process.wait(self._hang_s)
        except subprocess.TimeoutExpired:
            code = -999
            self.kill_all()
        if self.process.stdin:
            try:
                self.process.stdin.close()
            except OSError:
                pass  # a line of cancel that nobody was there to read
        seconds = time.monotonic() - self._start
        texts = []
        for stream in self._streams:
            stream.seek(0)
            texts.append(stream.read().decode("utf-8", "replace"))
        messages = []
        for line in texts[0].splitlines():
            try:
                message = json.loads(line)
            except ValueError:
                continue
            if isinstance(message, dict):  # qgis_process prints bare numbers, its progress
                messages.append(message)
        return Ended(code, messages, texts[1], seconds)

    def orphans(self) -> List[str]:
        """Processes that are still there five seconds after the end; they are ended then."""
        limit = time.monotonic() + ORPHANS_S
        while self.family() and time.monotonic() < limit:
            time.sleep(0.1)
        left = self.family()
        self.kill_all()
        return [f"orphan {words.strip()[-80:]}" for _, words in left]

    def kill_all(self) -> None:
        for pid, _ in self.family():
            try:
                os.kill(pid, KILL)
            except (ProcessLookupError, PermissionError):  # Windows: it is ending
                continue
        self.process.wait()


class _Entry(ctypes.Structure):
    """PROCESSENTRY32W."""

    _fields_ = [
        ("size", ctypes.c_uint32),
        ("usage", ctypes.c_uint32),
        ("pid", ctypes.c_uint32),
        ("heap", ctypes.c_void_p),
        ("module", ctypes.c_uint32),
        ("threads", ctypes.c_uint32),
        ("parent", ctypes.c_uint32),
        ("priority", ctypes.c_int32),
        ("flags", ctypes.c_uint32),
        ("name", ctypes.c_wchar * 260),
    ]


def _descendants(process: "subprocess.Popen[bytes]") -> List[int]:
    """The living processes of Windows that a process started, whether it lives or not, and it itself if it does.

    Windows keeps the parent's number when the parent ends, and nobody else gets the number while its handle is open.
    """
    kernel = ctypes.WinDLL("kernel32", use_last_error=True)  # type: ignore[attr-defined,unused-ignore]
    kernel.CreateToolhelp32Snapshot.restype = ctypes.c_void_p
    snapshot = ctypes.c_void_p(kernel.CreateToolhelp32Snapshot(0x2, 0))  # TH32CS_SNAPPROCESS
    entry, parents = _Entry(size=ctypes.sizeof(_Entry)), {}
    more = kernel.Process32FirstW(snapshot, ctypes.byref(entry))
    while more:
        parents[entry.pid] = entry.parent
        more = kernel.Process32NextW(snapshot, ctypes.byref(entry))
    kernel.CloseHandle(snapshot)
    if process.poll() is not None:
        parents.pop(process.pid, None)
    found, left = [], [process.pid]
    while left:
        number = left.pop()
        if number in parents:
            found.append(number)
        left += [pid for pid, parent in parents.items() if parent == number and pid not in (number, *found, *left)]
    return found


def digest(place: Path) -> Dict[str, str]:
    """Hashes of the products' contents, as far as they are there."""
    found = {}
    for file in PRODUCTS.values():
        path = place / file
        if path.is_dir():
            found[file] = _hash(b"".join(p.read_bytes() for p in sorted(path.rglob("*")) if p.suffix == ".json"))
            continue
        if not path.exists():
            continue
        found[file] = _hash(_content(path))
    return found


def _content(path: Path) -> bytes:
    if path.suffix == ".tif":
        dataset = gdal.Open(str(path))
        values = dataset.ReadAsArray()
        return np.where(np.isnan(values), np.nan, values).tobytes() + repr(dataset.GetGeoTransform()).encode()
    if path.suffix == ".laz":
        import laspy

        return laspy.read(path).points.array.tobytes()
    return path.read_bytes()


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def state_of(place: Path, reference: Dict[str, str]) -> List[str]:
    """What is wrong with the products of a place: each must be absent or whole."""
    try:
        found = digest(place)
    except Exception as error:  # noqa: BLE001 - whatever a half-written file does to its reader
        return [f"a product cannot be read ({type(error).__name__}: {error})"]
    return [f"{file} is neither old nor new" for file, value in found.items() if value != reference[file]]


def again(bench: Bench, place: Path, **options: object) -> List[str]:
    """Run the job once more in its workspace: it must end with the same bytes and leave nothing half-written."""
    ended = bench.start("pipeline", bench.job(place, **options)).end()
    problems = [f"run again: {text}" for text in ended.problems()]
    if ended.code:
        return [*problems, f"run again: {ended.last.get('text')}"]
    wanted = {file: value for file, value in bench.reference.items()}
    found = digest(place)
    problems += [f"run again: {file} differs" for file in wanted if found.get(file) != wanted[file]]
    parts = [str(path.relative_to(place)) for path in place.rglob("*.part*")]
    return [*problems, *(f"left behind: {part}" for part in parts)]


# Kinds of faults ---------------------------------------------------------------------------------------------------


def kills(bench: Bench, count: int, score: Score) -> None:
    """kill -9 of the engine, a worker, the workers' server, or the whole group, at random moments of a run.

    On Windows, TerminateProcess of the engine or a worker: there is no server, and no signal to a group.
    """
    victims = ("engine", "worker") if WINDOWS else ("engine", "worker", "server", "group")
    for number in range(count):
        victim = victims[number % len(victims)]
        place = bench.place()
        running = bench.start("pipeline", bench.job(place))
        time.sleep(bench.random.uniform(0.0, 1.05 * bench.seconds))
        hit = _kill(running, victim, bench.random)
        ended = running.end()
        killed = victim in ("engine", "group") or not hit
        problems = ended.problems(killed) + running.orphans() + state_of(place, bench.reference)
        if ended.code == 0 and digest(place) != bench.reference:
            problems.append("exit code 0 with another result")
        if ended.code == -999:
            problems.append("it hung")
        score.add(problems + again(bench, place), f"kill -9 of the {victim}")
        shutil.rmtree(place, ignore_errors=True)


def deaths_at_view_heights(bench: Bench, count: int, score: Score) -> None:
    """A worker dies (SIGKILL, or SIGSEGV as of a crash) while the rasters of all height maps are written: no empty
    folder, and no exit code 0."""
    for number in range(count):
        death = signal.Signals((KILL, signal.SIGSEGV)[number % 2])
        place = bench.place()
        views = place / "views"
        running = bench.start("pipeline", bench.job(place, view_heights=str(views)))
        while running.process.poll() is None and not list(place.glob("*views*/*.tif")):
            time.sleep(0.005)
        time.sleep(bench.random.uniform(0.0, 0.3))
        hit = _kill(running, "worker", bench.random, death)
        ended = running.end()
        problems = ended.problems(not hit) + running.orphans() + state_of(place, bench.reference)
        written = len(list(views.glob("*.tif")))
        if ended.code == 1 and "worker" not in str(ended.last.get("text")):
            problems.append(f"another reason is given: {ended.last.get('text')}")
        problems += again(bench, place, view_heights=str(views))
        whole = len(list(views.glob("*.tif")))
        if whole < 2:
            problems.append("run again: no rasters of the height maps")
        if ended.code == 0 and written < whole:
            problems.append(f"exit code 0 with {written} of {whole} rasters of the height maps")
        score.add(problems, f"{death.name} of a worker at the height maps, {'hit' if hit else 'missed'}")
        shutil.rmtree(place, ignore_errors=True)


def zeroed_tiles(bench: Bench, count: int, score: Score) -> None:
    """kill -9 in the fusion, after which a file of a fused tile holds zeros, as a power cut leaves it."""
    for _ in range(count):
        place = bench.place()
        running = bench.start("pipeline", bench.job(place))
        while running.process.poll() is None and not list(place.glob("w/*/*/*.wide.npy")):
            time.sleep(0.005)
        time.sleep(bench.random.uniform(0.0, 0.1))
        running.kill_all()
        running.end()
        files = [path for path in sorted(place.glob("w/*/*/*.np[yz]"))]
        if files:
            path = bench.random.choice(files)
            written = bench.random.choice((0, _ARRAY_HEADER))  # the disk may have got the file's begin before the cut
            path.write_bytes(path.read_bytes()[:written].ljust(path.stat().st_size, b"\0"))
        score.add(again(bench, place), f"zeros in {path.name if files else 'nothing'}")
        shutil.rmtree(place, ignore_errors=True)


def renamed(bench: Bench, count: int, score: Score) -> None:
    """The workspace is renamed at a random moment: the run ends in a sentence, and runs again under either name."""
    for _ in range(count):
        place = bench.place()
        running = bench.start("pipeline", bench.job(place))
        time.sleep(bench.random.uniform(0.3, bench.seconds))
        moved = (place / "w").exists()
        if moved:
            os.rename(place / "w", place / "other name")
        ended = running.end()
        problems = ended.problems() + running.orphans() + state_of(place, bench.reference)
        if ended.code == 1 and moved and "other name" not in str(ended.last.get("text")):
            words = ("renamed", "moved", "gone", "does not exist")
            if not any(word in str(ended.last.get("text")) for word in words):
                problems.append(f"the cause is not named: {ended.last.get('text')}")
        if (place / "other name").exists() and not (place / "w").exists():
            os.rename(place / "other name", place / "w")
        score.add(problems + again(bench, place), "workspace renamed")
        shutil.rmtree(place, ignore_errors=True)


def kills_of_qgis(bench: Bench, count: int, score: Score) -> None:
    """kill -9 of qgis_process, at random moments of a run of the pipeline that it starts."""
    if shutil.which("qgis_process") is None:
        score.skipped = "no qgis_process here"
        return
    variables = {"REPM_QGIS_CONFIG": str(bench.folder / "qgis"), "REPM_ENGINE_PYTHON": sys.executable}
    program = str(ROOT / "scripts" / "qgis-headless")
    start = time.monotonic()
    Running([program, "plugins"], environment=variables).end()
    most = time.monotonic() - start + 1.05 * bench.seconds
    for _ in range(count):
        place = bench.place()
        job = {name: value for name, value in bench.job(place).items() if name not in ("images", "workers")}
        words = [f"IMAGES={image}" for image in bench.images]
        words += [f"{name.upper()}={value}" for name, value in job.items()]
        running = Running([program, "run", "repm:pipeline", "--", *words], environment=variables)
        moment = bench.random.uniform(0.0, most)
        time.sleep(moment)
        running.process.kill()
        ended = running.end()
        problems = ended.problems(killed=True) + running.orphans() + state_of(place, bench.reference)
        if ended.code == 0 and digest(place) != bench.reference:
            problems.append("exit code 0 with another result")
        elif ended.code not in (0, -KILL):
            problems.append(f"exit code {ended.code}: {ended.errors.strip()[-160:]}")
        score.add(problems + again(bench, place), f"kill -9 of qgis_process at {moment:.2f} s")
        shutil.rmtree(place, ignore_errors=True)


def _kill(running: Running, victim: str, chance: random.Random, number: int = KILL) -> bool:
    """Send a signal to the victim; False where it is not there at this moment."""
    family = running.family()
    engine = running.process.pid
    if WINDOWS:
        chosen = [pid for pid, _ in family if (pid == engine) == (victim == "engine")]
        try:
            os.kill(chance.choice(sorted(chosen)), number)
        except (IndexError, OSError):  # none there, or it is ending
            return False
        return True
    others = [pid for pid, words in family if pid != engine and "resource_tracker" not in words]
    children = {pid: _parent(pid) for pid in others}
    servers = [pid for pid in others if children[pid] == engine]
    workers = [pid for pid in others if pid not in servers]
    chosen = {"engine": [engine], "server": servers, "worker": workers[:], "group": [engine]}[victim]
    if not chosen:
        return False
    try:
        if victim == "group":
            os.killpg(engine, number)
        else:
            os.kill(chance.choice(sorted(chosen)), number)
    except ProcessLookupError:
        return False
    return True


def _parent(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
    except OSError:
        return 0


def cancels(bench: Bench, count: int, score: Score) -> None:
    """SIGTERM, SIGTERM twice, and SIGINT at random moments, half of them within the first second.

    On Windows, the line by which the plugin cancels.
    """
    for number in range(count):
        place = bench.place()
        running = bench.start("pipeline", bench.job(place))
        moment = bench.random.uniform(0.05, 1.0) if number % 2 else bench.random.uniform(1.0, bench.seconds)
        time.sleep(moment)
        signals = ((signal.SIGTERM,), (signal.SIGTERM, signal.SIGTERM), (signal.SIGINT,))[number % 3]
        start = time.monotonic()
        if WINDOWS:
            running.cancel()
        for which in () if WINDOWS else signals:
            try:
                os.kill(running.process.pid, which)
            except ProcessLookupError:
                break
        ended = running.end()
        orphans = running.orphans()
        if ended.code:
            gone = time.monotonic() - start
            score.longest_s = max(score.longest_s, gone)
            sys.stderr.write(f"faults: cancelled at {moment:.2f} s, all was gone {gone:.1f} s later\n")
        problems = ended.problems() + orphans + state_of(place, bench.reference)
        # An engine that has not yet begun to listen ends by the signal itself: there is nothing of it to lose.
        if ended.code in (-signal.SIGTERM, -signal.SIGINT) and not ended.messages:
            problems = [text for text in problems if not text.startswith("exit code")]
        if time.monotonic() - start > 2.0 + ORPHANS_S and ended.code == 1:
            problems.append("it took more than 2 s")
        if ended.code == 0 and digest(place) != bench.reference:
            problems.append("exit code 0 with another result")
        parts = [p.name for p in place.rglob("*.part*")]
        score.add(
            problems + [f"left behind: {part}" for part in parts],
            f"{'a line' if WINDOWS else signals[0].name} x {len(signals)} at {moment:.2f} s",
        )
        shutil.rmtree(place, ignore_errors=True)


def full_disks(bench: Bench, count: int, score: Score) -> None:
    """File systems that are full or read-only: the workspace, the products, or both on a small tmpfs."""
    if os.geteuid() != 0:
        score.skipped = "mounting needs root"
        return
    for number in range(count):
        place = bench.place()
        mounted = place / "disk"
        mounted.mkdir()
        size = int(10 ** bench.random.uniform(4.6, 7.2))
        options = f"size={size}"
        if subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(mounted)], check=False).returncode:
            score.skipped = "tmpfs cannot be mounted here"
            return
        try:
            job = bench.job(place)
            moved = ("workspace", "output", "cloud", "ept", "confidence", "mesh")[number % 6]
            job[moved] = str(mounted / Path(job[moved]).name)
            if number % 5 == 4:
                subprocess.run(["mount", "-o", "remount,ro", str(mounted)], check=True)
            running = bench.start("pipeline", job)
            ended = running.end()
            problems = ended.problems() + running.orphans()
            if ended.code == 1 and not _speaks_of_space(str(ended.last.get("text")), str(mounted)):
                problems.append(f"the sentence names neither path nor cause: {ended.last.get('text')}")
            parts = [p.name for p in place.rglob("*.part*")]
            score.add(problems + [f"left behind: {part}" for part in parts], f"{moved} on {size} bytes")
        finally:
            subprocess.run(["umount", "-l", str(mounted)], check=False)
            shutil.rmtree(place, ignore_errors=True)


def _speaks_of_space(text: str, place: str) -> bool:
    return place in text and any(word in text.lower() for word in ("space", "full", "read-only", "free", "write"))


def side_by_side(bench: Bench, count: int, score: Score) -> None:
    """Two runs at once: in one workspace, or to one output from two workspaces."""
    for number in range(count):
        place, other = bench.place(), bench.place()
        second = bench.job(place) if number % 2 else {**bench.job(place), "workspace": str(other / "w")}
        runs = [bench.start("pipeline", bench.job(place)), bench.start("pipeline", second)]
        ends = [run.end() for run in runs]
        problems = [text for end in ends for text in end.problems()] + [t for run in runs for t in run.orphans()]
        if all(end.code for end in ends):
            problems.append("neither run succeeded")
        if any(end.code == 0 for end in ends) and digest(place) != bench.reference:
            problems.append("exit code 0 with another result")
        score.add(problems, "one workspace" if number % 2 else "one output")
        for path in (place, other):
            shutil.rmtree(path, ignore_errors=True)


def memory_limits(bench: Bench, count: int, score: Score) -> None:
    """Address space bounded from 0.3 to 3 GiB for every process of the run."""
    import resource

    for _ in range(count):
        place = bench.place()
        limit = int(bench.random.uniform(0.3, 3.0) * 2**30)
        running = bench.start(
            "pipeline",
            bench.job(place),
            limits=partial(resource.setrlimit, resource.RLIMIT_AS, (limit, limit)),
        )
        ended = running.end()
        problems = ended.problems() + running.orphans() + state_of(place, bench.reference)
        if ended.code == 1 and not any(
            w in str(ended.last.get("text")).lower() for w in ("memory", "import", "thread")
        ):
            problems.append(f"memory is not named: {ended.last.get('text')}")
        score.add(problems, f"{limit / 2**30:.2f} GiB of address space")
        shutil.rmtree(place, ignore_errors=True)


def received(bench: Bench, count: int, score: Score) -> None:
    """A workspace that came from elsewhere has a link or a pipe under a name that the run uses: nothing is lost."""
    names = (".repm.lock", "report.html", "scene.json", "equivalent_error.html", "../.dsm.tif.lock")
    for number in range(count):
        name, pipe = names[number % len(names)], number // len(names) % 2 == 1
        place = bench.place()
        (place / "w").mkdir()
        precious = place / "precious"
        precious.write_text("years of work")
        planted = place / "w" / name
        os.mkfifo(planted) if pipe else planted.symlink_to(precious)
        ended = bench.start("pipeline", bench.job(place)).end()
        problems = ended.problems()
        if precious.read_text() != "years of work":
            problems.append("a file that nobody named was lost")
        score.add(problems, f"{'pipe' if pipe else 'link'} as {name}")
        shutil.rmtree(place, ignore_errors=True)


def mutations(bench: Bench, count: int, score: Score) -> None:
    """Damaged scenes, jobs and tables, many to a process: each must be refused in a sentence, or work."""
    from tests.engine import fuzz_documents as documents

    for name, outcome in documents.campaign(bench.folder, count, bench.random.randrange(2**31)):
        score.add([outcome] if outcome else [], name)


KINDS: Dict[str, Tuple[Callable[[Bench, int, Score], None], int]] = {
    "kill -9": (kills, 100),
    "kill -9 of QGIS": (kills_of_qgis, 20),
    "death of a worker at the height maps": (deaths_at_view_heights, 12),
    "zeros in a fused tile": (zeroed_tiles, 12),
    "workspace renamed": (renamed, 12),
    "cancel": (cancels, 40),
    "full or read-only disk": (full_disks, 40),
    "two runs side by side": (side_by_side, 20),
    "memory limit": (memory_limits, 10),
    "link or pipe in a received workspace": (received, 10),
    "mutated scene, job or table": (mutations, 2000),
}


NOT_ON_WINDOWS = {
    "kill -9 of QGIS": "no qgis_process here",
    "workspace renamed": "Windows renames no folder with an open file in it",
    "full or read-only disk": "tmpfs is Linux's",
    "memory limit": "Windows does not bound the address space",
    "link or pipe in a received workspace": "Windows has no pipes with names in folders, and links need rights",
    "mutated scene, job or table": "its processes need an alarm clock",
}


def campaign(share: float, seed: int, only: Optional[str]) -> Iterator[Tuple[str, Score]]:
    with tempfile.TemporaryDirectory(prefix="repm-faults-") as folder:
        bench = Bench(Path(folder), seed)
        for name, (work, count) in KINDS.items():
            if only in (None, name):
                score = Score(skipped=NOT_ON_WINDOWS.get(name, "") if WINDOWS else "")
                if score.skipped:
                    yield name, score
                    continue
                work(bench, max(1, round(share * count)), score)
                yield name, score


def main() -> int:
    gdal.UseExceptions()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=1.0, help="part of the trials of each kind")
    parser.add_argument("--seed", type=int, default=13)
    parser.add_argument("--only", choices=list(KINDS))
    options = parser.parse_args()
    failed = 0
    for name, score in campaign(options.share, options.seed, options.only):
        held = score.tried - len(score.failures)
        words = f"skipped: {score.skipped}" if score.skipped else f"tried {score.tried:5d}   held {held:5d}"
        words += f"   longest {score.longest_s:.1f} s until all was gone" if score.longest_s else ""
        sys.stdout.write(f"{name:<38} {words}\n")
        sys.stdout.flush()
        failed += len(score.failures)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
