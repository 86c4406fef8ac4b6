"""Broken and hostile RPC files: each must be refused with RpcInvalidError, or read as what it says, and nothing else.

``python -m tests.engine.rpc.fuzz [COUNT [SEED]]`` prints one table; ``fuzz`` returns the same as an
object. An input that is read as another model than the one it was made from is *different* if the naive reader finds
the same numbers in it: then it is a whole file that says something else. All other differences are *wrong*.
"""

from __future__ import annotations

import sys
import tempfile
import time
import tracemalloc
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np
from osgeo import gdal

from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.rpc import Rpc
from repm_qgis.rpc.readers import read_rpc_file
from repm_qgis.rpc.writers import rpc_tags
from tests.engine.rpc.mutations import MUTATIONS, example
from tests.engine.rpc.naive_reader import naive, says
from tests.engine.rpc.writers import WRITERS

try:
    import resource
except ImportError:  # Windows
    resource = None

MAX_MS = 1000.0
MAX_MB = 150.0
Reader = Callable[[str], Rpc]


@dataclass
class Report:
    """What became of the inputs: counts by mutation, the ones that must not be, and the bounds."""

    inputs: int = 0
    refused: Counter = field(default_factory=Counter)
    identical: Counter = field(default_factory=Counter)
    different: Counter = field(default_factory=Counter)
    wrong: List[str] = field(default_factory=list)
    crashed: List[str] = field(default_factory=list)
    slowest_ms: float = 0.0
    slowest: str = ""
    peak_mb: float = 0.0
    peak: str = ""
    rss_mb: float = 0.0
    seconds: float = 0.0

    def table(self) -> str:
        """The report as text."""
        names = [mutation.__name__ for mutation in MUTATIONS]
        rows = [f"{'mutation':18}{'inputs':>8}{'refused':>9}{'same':>7}{'other numbers':>15}"]
        for name in names:
            counts = self.refused[name], self.identical[name], self.different[name]
            rows.append(f"{name:18}{sum(counts):8}{counts[0]:9}{counts[1]:7}{counts[2]:15}")
        totals = [sum(c.values()) for c in (self.refused, self.identical, self.different)]
        rows += [
            f"{'all':18}{self.inputs:8}{totals[0]:9}{totals[1]:7}{totals[2]:15}",
            f"wrong models: {len(self.wrong)}; other exceptions: {len(self.crashed)}",
            f"slowest: {self.slowest_ms:.1f} ms of CPU ({self.slowest}); most memory: {self.peak_mb:.1f} MB "
            f"({self.peak}); process grew by {self.rss_mb:.0f} MB; {self.seconds:.0f} s in all",
        ]
        return "\n".join(rows + self.wrong[:10] + self.crashed[:10])


def seeds(folder: Path) -> Dict[str, bytes]:
    """A whole file of each format."""
    rpc = example()
    whole = {name: write(rpc).encode() for name, write in WRITERS.items()}
    image = str(folder / "seed.tif")
    dataset = gdal.GetDriverByName("GTiff").Create(image, 8, 8, 1)
    dataset.SetMetadata(rpc_tags(rpc), "RPC")
    dataset = None  # noqa: F841
    whole["GeoTIFF"] = Path(image).read_bytes()
    return whole


def fuzz(count: int, seed: int = 1, read: Reader = read_rpc_file) -> Report:
    """Break whole files ``count`` times, read each, and say what became of them."""
    rng = np.random.default_rng(seed)
    mutations, weights = list(MUTATIONS), np.array(list(MUTATIONS.values()))
    report, start = Report(), time.monotonic()
    rss = _most_memory_mb()
    with tempfile.TemporaryDirectory() as name:
        whole = seeds(Path(name))
        path = Path(name) / "input"
        original = {}
        for kind, data in whole.items():
            path.write_bytes(data)
            original[kind] = read_rpc_file(str(path))
        tracemalloc.start()
        try:
            for number in range(count):
                kind = list(whole)[rng.integers(0, len(whole))]
                mutation = mutations[rng.choice(len(mutations), p=weights / weights.sum())]
                data = mutation(whole[kind], rng)
                path.write_bytes(data)
                label = f"{mutation.__name__} of {kind}, input {number}"
                rpc, trouble = _watched(report, read, str(path), label)
                _count(report, mutation.__name__, label, trouble, rpc, original[kind], kind, data)
        finally:
            tracemalloc.stop()
    report.rss_mb = _most_memory_mb() - rss
    report.seconds = time.monotonic() - start
    return report


def _most_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 if resource else 0.0


def _watched(report: Report, read: Reader, path: str, label: str) -> Tuple[Optional[Rpc], str]:
    """What a reader returns (None where it refuses the file), and what is wrong with the way in which it ended."""
    report.inputs += 1
    tracemalloc.reset_peak()
    held, began = tracemalloc.get_traced_memory()[0], time.process_time()
    rpc, trouble = None, ""
    try:
        rpc = read(path)
    except RpcInvalidError as error:
        if len(str(error)) > 1000 or "\n" in str(error).strip():
            trouble = "its message is no sentence"
    except BaseException as error:  # noqa: B036 - any other exception is what is looked for
        trouble = f"{type(error).__name__}: {error}"[:300]
    ms = (time.process_time() - began) * 1e3
    peak = (tracemalloc.get_traced_memory()[1] - held) / 1e6
    if ms > report.slowest_ms:
        report.slowest_ms, report.slowest = ms, label
    if peak > report.peak_mb:
        report.peak_mb, report.peak = peak, label
    return rpc, trouble


def _count(
    report: Report, mutation: str, label: str, trouble: str, rpc: Optional[Rpc], original: Rpc, kind: str, data: bytes
) -> None:
    digits = 1e-13 if kind == "GeoTIFF" else 1e-15
    if trouble:
        report.crashed.append(f"{label}: {trouble}")
    elif rpc is None:
        report.refused[mutation] += 1
    elif rpc == original:
        report.identical[mutation] += 1
    elif any(says(rpc, naive(other, data), digits) for other in (kind, *WRITERS)):
        report.different[mutation] += 1
    else:
        report.wrong.append(f"{label}: a model that the file does not hold")


def main() -> int:
    """Run and print; the exit code is 1 where a file was read wrongly, or a bound was passed."""
    count, seed = (int(value) for value in (sys.argv[1:] + ["20000", "1"][len(sys.argv) - 1 :])[:2])
    report = fuzz(count, seed)
    print(report.table())
    good = not report.wrong and not report.crashed and report.slowest_ms < MAX_MS and report.peak_mb < MAX_MB
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
