"""``python benchmarks NAME [PART ...] [--write] [--quick]``: measure, and print the tables.

NAME is a module of this folder that has sections, PART names some parts of them. ``--write`` also writes sections of
which all parts were run into docs/benchmarks.md and docs/benchmarks/. ``--quick`` takes the first case of everything,
in small images: it shows that a benchmark works, and its figures mean nothing.

``python benchmarks --quick`` runs all of them so, one after the other, in an empty cache. It ends with 1 where one
fails, prints no figure, or takes more than ``--limit`` seconds both by the clock and of the processors, as on a busy
machine the clock says little. One that takes four times as long is stopped.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Dict, List, Sequence

from osgeo import gdal

FOLDER = Path(__file__).resolve().parent
sys.path[:] = [str(FOLDER.parent), *(path for path in sys.path if path != str(FOLDER))]

from benchmarks import runner  # noqa: E402
from benchmarks.tables import publish, table  # noqa: E402


def names() -> list[str]:
    """The modules that have sections."""
    return sorted(path.stem for path in FOLDER.glob("*.py") if "\nSECTIONS = " in path.read_text(encoding="utf-8"))


def figures(text: str) -> int:
    """How many rows of the Markdown tables in a text have a figure."""
    lines = [*text.splitlines(), ""]
    rows = [line for line, after in zip(lines, lines[1:]) if line.startswith("|") and not after.startswith("|---")]
    return sum(any(map(str.isdigit, row)) for row in rows)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process that still runs, with all of its session: by Ctrl-C, after which it removes its folders, or so."""
    for seconds, ending in ((10.0, signal.SIGINT), (None, signal.SIGKILL)):
        if process.poll() is None:
            os.killpg(process.pid, ending)
            with suppress(subprocess.TimeoutExpired):
                process.wait(seconds)


def quickly(name: str, limit: float, environment: Dict[str, str]) -> List[object]:
    """Run a benchmark with --quick; its row: name, seconds, CPU seconds of all its processes, and how it ended."""
    start, before, outcome = time.monotonic(), os.times(), ""
    command = [sys.executable, str(FOLDER), name, "--quick"]
    with tempfile.TemporaryFile("w+") as printed, tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(command, stdout=printed, stderr=said, env=environment, start_new_session=True)
        try:
            process.wait(4 * limit)
        except subprocess.TimeoutExpired:
            outcome = f"stopped after {4 * limit:g} s"
        finally:  # also where this process is interrupted
            _end(process)
        if process.returncode and not outcome:
            outcome = f"ended with code {process.returncode}"
        for file in (printed, said):
            file.seek(0)
        tables, log = printed.read(), said.read()
    print(tables, flush=True)
    seconds, cpu = time.monotonic() - start, sum(os.times()[2:4]) - sum(before[2:4])
    if not outcome and min(seconds, cpu) > limit:
        outcome = f"took more than {limit:g} s"
    outcome = outcome or ("ok" if figures(tables) else "printed no figure")
    if outcome != "ok":
        runner.say(f"{name}: {outcome}\n{log[-4000:]}")
    return [name, f"{seconds:.1f}", f"{cpu:.1f}", outcome]


def run_all(chosen: Sequence[str], limit: float) -> int:
    """Run all chosen benchmarks quickly, and print a table of them; 1 where one is not ok."""
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        for name in chosen:
            rows.append(quickly(name, limit, {**os.environ, "REPM_BENCH_CACHE": cache}))
            runner.say(" ".join(map(str, rows[-1])))
    print(table("NAME | seconds | CPU s | ok", rows), flush=True)
    return int(any(row[-1] != "ok" for row in rows))


def main() -> int:
    parser = argparse.ArgumentParser("benchmarks", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("name", nargs="?", choices=names(), metavar="NAME", help=", ".join(names()))
    parser.add_argument("parts", nargs="*", metavar="PART")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--limit", type=float, default=60.0, metavar="S", help="of each, where all are run (60)")
    options = parser.parse_args()
    if options.quick and options.write:
        parser.error("quick figures are not written")
    if options.name is None and not options.quick:
        parser.error("give a NAME, or --quick to run all")
    if options.name is None:
        return run_all(names(), options.limit)
    sections = import_module(f"benchmarks.{options.name}").SECTIONS
    every = [part for section in sections for part in section.parts]
    if set(options.parts) - set(every):
        parser.error(f"the parts of {options.name} are: {', '.join(every)}")
    gdal.UseExceptions()
    gdal.SetCacheMax(64 << 20)
    runner.set_quick(options.quick)
    for section in sections:
        chosen = [part for part in section.parts if part in (options.parts or every)]
        texts = [text for part in chosen for text in section.parts[part]()]
        if texts:
            print("\n\n".join([f"## {section.title}", *texts]), flush=True)
        if options.write and texts and len(chosen) == len(section.parts):
            publish(section, texts)
        elif options.write and texts and chosen:
            runner.say(f"{section.name} is not written: only {', '.join(chosen)} of its parts were run.")
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--alone"]:
        runner.answer(*sys.argv[2:])
    else:
        sys.exit(main())
