"""A Dask cluster on this machine for tests and benchmarks: processes of their own, each in its own folder."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MEMORY_MIB = 3000
QUIET = runpy.run_path(str(ROOT / "scripts" / "repm-cluster"))["QUIET"]  # as that script starts the same processes


class Cluster:
    """A scheduler and workers as processes of their own; ``address`` is the scheduler file."""

    def __init__(self, folder, workers):
        self.folder, self.workers, self.address = folder, [], str(folder / "scheduler.json")
        self.scheduler = self._start("dask_scheduler", "--scheduler-file", self.address, "--port", "0")
        self.grow(workers)

    def _start(self, module, *options):
        place = self.folder / f"process{len(self.workers)}{module}"
        place.mkdir(exist_ok=True)
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--no-dashboard", "--host", "127.0.0.1", *options]
        with open(place / "log", "ab") as log:
            return subprocess.Popen(
                command,
                cwd=place,
                env={**os.environ, **QUIET, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
                stdout=log,
                stderr=log,
            )

    def grow(self, count, wait=True):
        """Start workers, each in a folder of its own, and wait for them."""
        for _ in range(count):
            options = ("--nthreads", "1", "--memory-limit", f"{MEMORY_MIB}MiB", "--no-nanny")
            self.workers.append(self._start("dask_worker", "--scheduler-file", self.address, *options))
        if not wait:
            return
        living = sum(worker.poll() is None for worker in self.workers)
        from distributed import Client

        with Client(scheduler_file=self.address, set_as_default=False) as client:
            client.wait_for_workers(living, timeout=60)

    def renew(self):
        """New workers in place of those that are busy with what nobody wants any more, or dead."""
        for worker in self.workers:
            worker.kill()
            worker.wait()
        self.workers = []
        self.grow(2)

    def end(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()
