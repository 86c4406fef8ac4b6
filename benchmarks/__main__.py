"""``python benchmarks NAME [PART ...] [--write] [--quick]``: measure, and print the tables.

NAME is a module of this folder that has sections; without one, all names are listed. PART names some parts of them.
``--write`` also writes sections of which all parts were run into docs/benchmarks.md and docs/benchmarks/. ``--quick``
takes the first case of everything, in small images: it shows that a benchmark works, and its figures mean nothing.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

from osgeo import gdal

FOLDER = Path(__file__).resolve().parent
sys.path[:] = [str(FOLDER.parent), *(path for path in sys.path if path != str(FOLDER))]

from benchmarks import runner  # noqa: E402
from benchmarks.tables import publish  # noqa: E402


def names() -> list[str]:
    """The modules that have sections."""
    return sorted(path.stem for path in FOLDER.glob("*.py") if "\nSECTIONS = " in path.read_text(encoding="utf-8"))


def main() -> int:
    parser = argparse.ArgumentParser("benchmarks", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("name", choices=names(), metavar="NAME", help=", ".join(names()))
    parser.add_argument("parts", nargs="*", metavar="PART")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    if options.quick and options.write:
        parser.error("quick figures are not written")
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
