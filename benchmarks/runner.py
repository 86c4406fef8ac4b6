"""Running what is measured: a stage in this process, a function in a process of its own, a program as a whole."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import IO, Any, Callable, Dict, Iterable, List, Optional, Sequence, Tuple, TypeVar, Union

from repm_qgis.contracts.results import PipelineResult
from repm_qgis.contracts.stages import PIPELINE, R, Stage
from repm_qgis.runtime.parallel import cores
from repm_qgis.runtime.process_limits import bound_cache
from repm_qgis.runtime.progress import Progress, Silent
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE, EngineParameters

ROOT = Path(__file__).resolve().parents[1]
CORES = cores()
Item = TypeVar("Item")
_QUICK = "REPM_BENCH_QUICK"


def set_quick(quick: bool) -> None:
    """From here on, ``few`` returns the first item alone, and simulated images are small; in all processes that are
    begun from here on as well."""
    os.environ[_QUICK] = "1" if quick else ""


def is_quick() -> bool:
    return os.environ.get(_QUICK) == "1"


def few(items: Iterable[Item]) -> List[Item]:
    """The cases of a benchmark: all, or the first of a quick run, before which none of the others is made."""
    return list(islice(items, 1 if is_quick() else None))


def say(text: object) -> None:
    """Progress of a long benchmark, on standard error, beside the tables on standard output."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def earlier(revision: str, folder: Path) -> Optional[Path]:
    """The files of an earlier revision, in a folder; None where this is no clone that has it."""
    packed = subprocess.run(["git", "-C", str(ROOT), "archive", revision], capture_output=True, check=False)
    if packed.returncode:
        say(f"the revision {revision} is not here: what was before is not measured")
        return None
    tree = folder / "before"
    tree.mkdir()
    subprocess.run(["tar", "-x", "-C", str(tree)], input=packed.stdout, check=True)
    return tree


# In this process --------------------------------------------------------------------------------------------------


def there(value: Optional[Item], what: str = "what was asked for") -> Item:
    """A value that must be there; raises Failed where it is None."""
    if value is None:
        raise Failed(f"{what} is not there")
    return value


def stage(
    of: Stage[R], progress: Progress = Silent(), parameters: Optional[EngineParameters] = None, /, **options: object
) -> R:
    """A stage's result; ``parameters`` are for the stages that take them."""
    return run_stage(of, options, progress, parameters)


def pipeline(
    images: Sequence[str],
    folder: Union[str, Path],
    progress: Progress = Silent(),
    parameters: EngineParameters = ENGINE,
    /,
    **options: object,
) -> PipelineResult:
    """The pipeline's result; the workspace is ``w`` and the DSM ``dsm.tif`` in a folder."""
    made = {"images": list(images), "workspace": f"{folder}/w", "output": f"{folder}/dsm.tif", **options}
    return run_stage(PIPELINE, made, progress, parameters)


# In a process of its own ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Alone:
    """What a function returned, the CPU seconds of its whole process, and MiB of the process and of its children."""

    result: Any
    cpu_s: float
    mib: float
    child_mib: float


def alone(function: Callable[..., object], *arguments: object) -> Alone:
    """Run a function of a benchmark in a new process; arguments and result are JSON-able. Raises Failed."""
    command = [sys.executable, "-m", "benchmarks", "--alone", function.__module__, function.__name__]
    done = subprocess.run([*command, json.dumps(arguments)], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Failed((done.stderr.strip().splitlines() or ["failed"])[-1][:200])
    return Alone(**json.loads(done.stdout.splitlines()[-1]))


def answer(module: str, function: str, arguments: str) -> None:
    """The other side of ``alone``. The process ends here: what is cleaned up after it is not measured."""
    import resource  # which Windows lacks, where tests import other parts of this module

    bound_cache()  # as the engine's own process does
    result = getattr(import_module(module), function)(*json.loads(arguments))
    used = resource.getrusage(resource.RUSAGE_SELF)
    # The peak of getrusage would begin with the memory of the process that started this one.
    with open("/proc/self/status", encoding="utf-8") as status:
        own = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
    child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    figures = Alone(result, used.ru_utime + used.ru_stime, own / 1024, child / 1024)
    print(json.dumps(vars(figures)), flush=True)
    os._exit(0)


# Whole commands ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cost:
    """Seconds by the clock and of all cores, and the largest memory of the whole process tree, GiB."""

    wall_s: float
    cpu_s: float
    peak_gib: float


class Failed(Exception):
    """A program ended with an error, or did not make its DSM; the message is what it printed last."""


def measured(
    command: Sequence[str], folder: Optional[str] = None, memory_gib: Optional[Callable[[int], float]] = None
) -> Tuple[str, Cost]:
    """A command's standard output and its cost; raises Failed where it ends with another code than 0.

    Python keeps its compiled modules, as it does where a plugin is installed. ``memory_gib`` gives the memory that is
    in use now for a process id; it is asked ten times a second.
    """
    before, start = os.times(), time.monotonic()
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, cwd=folder, env=environment, start_new_session=True
    )
    printed: List[str] = ["", ""]

    def listen(number: int, stream: IO[str]) -> None:
        printed[number] = stream.read()

    streams = there(process.stdout), there(process.stderr)
    readers = [threading.Thread(target=listen, args=(number, stream)) for number, stream in enumerate(streams)]
    for reader in readers:
        reader.start()
    peak = 0.0
    try:
        while process.poll() is None:
            peak = max(peak, (memory_gib or tree_gib)(process.pid))
            with suppress(subprocess.TimeoutExpired):  # the figures of quick runs mean nothing, and looking costs
                process.wait(1.0 if is_quick() else 0.1)
    finally:
        if process.poll() is None:  # this process is interrupted
            os.killpg(process.pid, signal.SIGKILL)
    for reader in readers:
        reader.join()
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    if process.returncode:
        last = (printed[1].strip() or printed[0].strip() or "nothing printed").splitlines()[-1]
        raise Failed(f"ended with code {process.returncode}: {last[:200]}")
    return printed[0], Cost(time.monotonic() - start, cpu, peak)


def made_by(tree: Path, images: Sequence[str], folder: str, **options: object) -> Tuple[str, Cost]:
    """The DSM that the pipeline of a checkout makes of images in a folder, and its cost as a whole command."""
    dsm, job = f"{folder}/dsm.tif", Path(folder, "job.json")
    made = {"images": list(images), "workspace": f"{folder}/w", "output": dsm, **options}
    job.write_text(json.dumps(made), encoding="utf-8")
    return dsm, measured([sys.executable, "-m", "repm_qgis", "pipeline", str(job)], str(tree))[1]


def tree_gib(root: int) -> float:
    """Memory of a process and all below it, GiB: what they share is divided among them (PSS) where the kernel does."""
    parents, sizes = {}, {}
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                with open(f"/proc/{name}/stat", encoding="utf-8") as stream:
                    fields = stream.read().rsplit(")", 1)[1].split()
                parents[int(name)], sizes[int(name)] = int(fields[1]), int(fields[21])
            except (OSError, IndexError, ValueError):
                continue

    def below(pid: int) -> bool:
        while pid and pid != root:
            pid = parents.get(pid, 0)
        return pid == root

    page = os.sysconf("SC_PAGE_SIZE")
    return sum(_proportional_bytes(pid) or size * page for pid, size in sizes.items() if below(pid)) / 2**30


def _proportional_bytes(pid: int) -> int:
    """Proportional set size; 0 where the kernel does not say."""
    try:
        with open(f"/proc/{pid}/smaps_rollup", encoding="utf-8") as stream:
            return next((1024 * int(line.split()[1]) for line in stream if line.startswith("Pss:")), 0)
    except (OSError, ValueError, IndexError):
        return 0


def resident_gib() -> Callable[[int], float]:
    """For ``measured``: the sum of the largest resident sets of all processes of a group, GiB."""
    largest: Dict[str, float] = {}

    def look(group: int) -> float:
        for name in filter(str.isdigit, os.listdir("/proc")):
            try:
                if os.getpgid(int(name)) == group:
                    lines = Path(f"/proc/{name}/status").read_text(encoding="utf-8").splitlines()
                    kib = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
                    largest[name] = kib / 2**20
            except (OSError, StopIteration):
                continue
        return sum(largest.values())

    return look
