"""The workers of a Dask cluster, in place of this machine's: the same tasks, the same results.

Only tasks and small records travel; pixels are read and written by the workers, on storage that all of them share.
Missing packages and files of a worker are found before the work begins. Dask (https://distributed.dask.org) is imported
only here, and this module only where a cluster is requested.
"""

from __future__ import annotations

import asyncio
import json
import os
import stat
import time
import uuid
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence, Tuple

from distributed import Client, Future, WorkerPlugin, as_completed
from distributed.scheduler import KilledWorker
from distributed.security import Security
from osgeo import gdal

from ..contracts.documents import JsonObject
from ..contracts.errors import ClusterError, reason_of
from .parallel import R, T, do_task, packed, use_workers
from .process_limits import prepare_process
from .progress import Progress
from .workspace import ensure_folder, whole_file

_CONNECT_S = 5
_KEY_NAME = "repm-cluster.pem"
_KEY_DAYS = 180  # after which a new one is made; Dask's certificates are valid for a year
_MOST_BYTES = 10 << 20  # of a scheduler file
_POLL_S = 0.02
_LOOK_S = 5.0  # between two checks whether there are workers left
_OUTSTANDING = 2000  # tasks that the scheduler knows at a time, so that memory does not grow with their number
_PACKAGES = ("repm_qgis", "osgeo.gdal", "numpy", "cv2", "scipy", "pyproj", "laspy", "lazrs")
_FILLED = 0.8  # of a worker's memory limit: above that Dask gives it no more tasks
_MIB = 1024.0 * 1024.0
_VERSIONS = "Give all machines the same versions (docs/cluster.md)."


@contextmanager
def cluster_workers(address: str, read: Sequence[str], folders: Sequence[str], progress: Progress) -> Iterator[None]:
    """Within the block all tasks run on the workers of a cluster.

    ``address`` is that of its scheduler ("tcp://host:port"), or the path of a scheduler file. ``read`` are files and
    ``folders`` the folders for products, which all workers must see as this machine does. Raises ClusterError.
    """
    client = _client(address)
    try:
        workers = _same_everywhere(client, address)
        _require_shared(client, address, workers, read=read, folders=folders)
        client.register_plugin(_Prepared())
        limits = [int(worker["memory_limit"]) for worker in workers.values() if worker.get("memory_limit")]
        hosts = len({worker["host"] for worker in workers.values()})
        progress.info(f"The tasks run on {len(workers)} workers of the cluster at '{address}' ({hosts} machines).")
        with use_workers(_ClusterWorkers(client, address, _FILLED * min(limits) / _MIB if limits else None)):
            yield
    finally:
        _close(client)


def key_file(folder: str) -> str:
    """The file with key and certificate for the clusters of a folder, which this user alone can read.

    It is made where there is none, and made again where it is old or others could have read or written it. Scheduler,
    workers and clients use the same one: who can read it belongs to the cluster. Raises WorkspaceError, and ImportError
    where the package cryptography is missing.
    """
    path = os.path.join(folder, _KEY_NAME)
    if not _is_own_key(path):
        made = Security.temporary()
        with whole_file(path) as temporary:
            with suppress(OSError):  # its permissions would be kept
                os.unlink(path)
            private = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with open(private, "w", encoding="ascii", newline="\n") as stream:
                stream.write(made.tls_scheduler_key + made.tls_scheduler_cert)
    return path


def _is_own_key(path: str) -> bool:
    try:
        status = os.lstat(path)
    except OSError:
        return False
    if not stat.S_ISREG(status.st_mode) or time.time() - status.st_mtime > _KEY_DAYS * 86400:
        return False
    return os.name == "nt" or (status.st_uid == os.getuid() and not status.st_mode & 0o077)


def security(key: str) -> Security:
    """Dask's settings to use the key and certificate of a file for everything."""
    each = {f"tls_{role}_{part}": key for role in ("client", "scheduler", "worker") for part in ("key", "cert")}
    return Security(require_encryption=True, tls_ca_file=key, **each)


def _security(scheduler: str, address: str) -> Security:
    """The keys for a scheduler: those beside its file, else those that Dask's own settings name."""
    beside = os.path.join(os.path.dirname(address), _KEY_NAME)
    if scheduler.startswith("tls://") and scheduler != address and os.path.isfile(beside):
        return security(beside)
    found = Security()
    if scheduler.startswith("tls://") and not found.get_connection_args("client").get("ssl_context"):
        keys = f"give the scheduler file that lies beside its {_KEY_NAME}, or name its keys to Dask"
        raise ClusterError(f"The cluster at '{address}' requires encryption (TLS): {keys} (docs/cluster.md, Security).")
    return found


def _client(address: str) -> Client:
    remedy = "start one with scripts/repm-cluster, or correct CLUSTER"
    try:
        scheduler = address if "://" in address else _in_scheduler_file(address)
        keys = _security(scheduler, address)
        return Client(scheduler, security=keys, timeout=_CONNECT_S, set_as_default=False, name="repm")
    except (OSError, asyncio.TimeoutError, ValueError, TypeError, KeyError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ClusterError(f"No Dask scheduler answers at '{address}' ({reason}): {remedy}.") from error


def _in_scheduler_file(path: str) -> str:
    """The address that a scheduler has written into its file; raises OSError, ValueError or KeyError."""
    if not os.path.isfile(path):
        known = "the address of a scheduler, such as tcp://10.0.0.1:8786, or a scheduler file"
        raise ClusterError(f"CLUSTER '{path}' is neither a file nor an address: give {known}.")
    with open(path, encoding="utf-8") as stream:
        document = json.loads(stream.read(_MOST_BYTES))
    if not isinstance(document, dict) or not isinstance(document.get("address"), str):
        raise ValueError("it holds no address")
    found: str = document["address"]
    return found


def _gone(address: str) -> ClusterError:
    remedy = "start it again and run again: what is finished is kept"
    return ClusterError(f"The scheduler of the cluster at '{address}' has ended: {remedy}.")


def _close(client: Client) -> None:
    with suppress(Exception):  # the scheduler may be gone
        client.close(timeout=1)
    client.status = "closed"  # otherwise it would try again when it is collected, for as long as its timeout


class _Prepared(WorkerPlugin):  # type: ignore[misc]  # Dask has no types
    """Every worker, also one that joins later, computes with the settings of this machine's workers."""

    name = "repm"

    def setup(self, worker: object) -> None:
        prepare_process()


def _facts() -> Callable[[Sequence[str]], JsonObject]:
    def facts(packages: Sequence[str]) -> JsonObject:
        """The versions of packages, a digest of REPM's code, and the number of threads of linear algebra.

        It must run where REPM is missing or another one: a function within a function travels as its code.
        """
        import hashlib
        import importlib
        import os
        import pathlib
        import platform

        found = {"Python": ".".join(platform.python_version_tuple()[:2])}
        for name in packages:
            try:
                module = importlib.import_module(name)
            except Exception as error:  # noqa: BLE001 - whatever a broken package does
                found[name] = f"missing ({type(error).__name__}: {error})"
                continue
            found[name] = str(getattr(module, "__version__", "of an unknown version"))
            if name == "repm_qgis":
                files = sorted(pathlib.Path(str(module.__file__)).parent.rglob("*.py"))
                code = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
                found[name] += f" (code {code[:8]})"
        return {"versions": found, "threads": os.environ.get("OMP_NUM_THREADS", "as many as cores")}

    return facts


def _unusable_here(files: Dict[str, int], probes: Dict[str, str]) -> List[Tuple[str, str]]:
    """The paths that a worker cannot use, and why: files by their sizes, -1 for folders, and folders by a file's text
    in them."""
    wrong = []
    for path, size in files.items():
        try:
            found = _size(path)
        except OSError as error:
            wrong.append((path, reason_of(error)))
            continue
        if size not in (-1, found):
            wrong.append((path, f"it has {found} bytes there, and {size} here"))
    for path, text in probes.items():
        try:
            if Path(path).read_text(encoding="ascii") != text:
                wrong.append((os.path.dirname(path), "it is a different folder there"))
                continue
            answer = Path(f"{path}-{os.getpid()}")
            answer.write_text(text, encoding="ascii")
            answer.unlink()
        except OSError as error:
            wrong.append((os.path.dirname(path), reason_of(error)))
    return wrong


def _ask(client: Client, address: str, question: Callable[..., object], *arguments: object) -> JsonObject:
    """Every worker's answer by its address; raises ClusterError where one cannot answer, or the scheduler has ended."""
    try:
        answers: JsonObject = client.run(question, *arguments, on_error="return")
    except OSError as error:
        raise _gone(address) from error
    for worker, answer in answers.items():
        if isinstance(answer, BaseException):
            reason = " ".join(f"{type(answer).__name__}: {answer}".split())[:200]
            raise ClusterError(f"The cluster's worker {worker} cannot answer ({reason}). {_VERSIONS}")
    return answers


def _same_everywhere(client: Client, address: str) -> Dict[str, JsonObject]:
    """The scheduler's facts about its workers; raises ClusterError for none, or one that differs from this machine."""
    try:
        client.wait_for_workers(1, timeout=_CONNECT_S)
    except (OSError, asyncio.TimeoutError) as error:
        remedy = "start workers with scripts/repm-cluster or 'dask worker'"
        raise ClusterError(f"The cluster at '{address}' has no workers: {remedy}.") from error
    workers: Dict[str, JsonObject] = client.scheduler_info(n_workers=-1)["workers"]
    own = _facts()(_PACKAGES)["versions"]
    for worker, answer in sorted(_ask(client, address, _facts(), _PACKAGES).items()):
        name = f"The worker {worker} on '{workers.get(worker, {}).get('host', 'an unknown machine')}'"
        for package, version in answer["versions"].items():
            if version != own[package]:
                raise ClusterError(f"{name} has {package} {version}, this machine {own[package]}. {_VERSIONS}")
        if answer["threads"] != "1":
            found = f"lets linear algebra use {answer['threads']} threads, which changes last digits of the results"
            raise ClusterError(f"{name} {found}: start it with OMP_NUM_THREADS=1, or with a nanny, which sets it.")
        threads = workers.get(worker, {}).get("nthreads", 1)
        if threads != 1:
            raise ClusterError(f"{name} runs {threads} tasks at a time: start it with --nthreads 1, and more workers.")
    return workers


def _size(path: str) -> int:
    """Bytes of a file, in cloud storage too, or of a folder's entry; raises OSError where there is nothing."""
    if not path.startswith("/vsi"):
        return os.stat(path).st_size
    status = gdal.VSIStatL(path)
    if status is None:
        reason = "GDAL does not find it: its settings, such as those for cloud storage, may not be set there"
        raise FileNotFoundError(reason)
    return int(status.size)


def _require_shared(
    client: Client, address: str, workers: Dict[str, JsonObject], *, read: Sequence[str], folders: Sequence[str]
) -> None:
    """Raise ClusterError with the first machine and path that a worker sees differently from this machine."""
    files = {}
    for path in read:
        with suppress(OSError):  # a path that is missing here too is reported by the stage
            files[path] = -1 if os.path.isdir(path) else _size(path)
    text, probes = uuid.uuid4().hex, {}
    try:
        for folder in sorted({os.path.abspath(folder) for folder in folders}):
            probe = str(ensure_folder(folder) / f".repm-probe-{text}")
            with open(probe, "w", encoding="ascii") as stream:
                stream.write(text)
            probes[probe] = text
        answers = _ask(client, address, _unusable_here, files, probes)
    finally:
        for probe in probes:
            with suppress(OSError):
                os.unlink(probe)
    for worker, wrong in sorted(answers.items()):
        for path, reason in wrong:
            host = workers.get(worker, {}).get("host", worker)
            remedy = "put images, workspace and products on storage that all machines see under the same path"
            raise ClusterError(f"The worker {worker} on '{host}' cannot use '{path}' ({reason}): {remedy}.")


class _ClusterWorkers:
    """Dask's workers, as :class:`repm_qgis.runtime.parallel.Workers`."""

    def __init__(self, client: Client, address: str, task_mib: Optional[float]) -> None:
        self._client, self._address, self.task_mib = client, address, task_mib

    def run(
        self,
        function: Callable[[T], R],
        tasks: Sequence[T],
        workers: int,
        progress: Progress,
        describe: Callable[[T], str],
    ) -> List[R]:
        """See :func:`~repm_qgis.runtime.parallel.run_tasks`; a task whose worker is lost goes to another, three times.

        Then the rest is finished, and ClusterError names those that were lost.
        """
        run, rest = uuid.uuid4().hex[:8], iter(range(len(tasks)))
        numbers: Dict[Future, int] = {}  # of the tasks that the scheduler knows, by their futures
        results: Dict[int, R] = {}
        lost: List[int] = []
        ended = as_completed(with_results=True, raise_errors=False, loop=self._client.loop)
        progress.step(0.0, f"{len(tasks)} tasks on the cluster")
        look = time.monotonic() + _LOOK_S
        try:
            while len(results) + len(lost) < len(tasks):
                if len(numbers) < _OUTSTANDING // 2:
                    more = list(islice(rest, _OUTSTANDING - len(numbers)))
                    keys = [f"{describe(tasks[number])} {run}-{number}" for number in more]
                    work = [packed(function, tasks[number]) for number in more]
                    futures = self._client.map(do_task, work, key=keys, pure=False) if more else []
                    numbers.update(zip(futures, more))
                    ended.update(futures)
                batch = list(ended.next_batch(block=False)) if numbers else []
                for future, result in batch:
                    number = numbers.pop(future)
                    if self._is_result(future, result):
                        results[number] = result
                    else:
                        lost.append(number)
                    progress.step(
                        len(results) / len(tasks), f"{describe(tasks[number])} ({len(results)} of {len(tasks)})"
                    )
                progress.check_cancelled()
                if not batch:
                    time.sleep(_POLL_S)
                if time.monotonic() > look:
                    self._look(progress)
                    look = time.monotonic() + _LOOK_S
        finally:
            self._drop(list(numbers))
        if lost:
            names = "; ".join(describe(tasks[number]) for number in sorted(lost)[:20])
            found = f"{len(lost)} of {len(tasks)} tasks lost four workers each, most likely because memory ran out"
            remedy = "give the workers more memory, or choose a smaller TILE_SIZE, and run again"
            raise ClusterError(f"{found} ({names}); all others are done: {remedy}.")
        return [results[number] for number in range(len(tasks))]

    def _is_result(self, future: Future, result: Any) -> bool:
        """Whether a task has a result; False where its workers were lost. Raises the error of a task that failed."""
        if future.status == "finished":
            return True
        if future.status == "error" and not isinstance(result, BaseException):
            result = result[1]  # as sys.exc_info() has it
        if isinstance(result, KilledWorker):
            return False
        if future.status == "error":
            raise result
        raise _gone(self._address)

    def _look(self, progress: Progress) -> None:
        """Check that the scheduler runs, and report where there is no worker."""
        if self._client.status != "running":
            raise _gone(self._address)
        if not self._client.nthreads():
            progress.info(f"The cluster at '{self._address}' has no workers at the moment: this run waits for one.")

    def _drop(self, futures: List[object]) -> None:
        """Have the scheduler forget tasks; a worker ends the one that it does."""
        if futures:
            with suppress(Exception):  # the scheduler may be gone
                self._client.cancel(futures, force=True)

    def kill(self) -> None:
        """Nothing: the scheduler forgets the tasks of a client that is gone."""
