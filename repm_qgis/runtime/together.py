"""The products of a run appear together or not at all.

Each file is written under a temporary name and renamed when it is complete (:mod:`.workspace`); but a run writes
several, and one that fails or is cancelled would leave new ones beside old ones. So what was there before the run keeps
a second name until the run has ended well: ``.dsm.tif.before-MACHINE-PROCESS-NUMBER`` is the old file itself (a hard
link: nothing is copied), ``.dsm.tif.absent-...`` says that there was none. A run that fails gives the old files their
names back and removes the new ones. After a kill, the caller or the next run with these products does so.

All marks are made before the work and removed after it: where some are missing, the run had ended well, or not begun.
"""

from __future__ import annotations

import glob
import os
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Callable, Dict, Iterable, Iterator, List, Sequence, Tuple

from .workspace import MACHINE, kept_folders, process_exists, real_target, remove_temporary

_BEFORE, _ABSENT, _FOLDER = "before", "absent", "folder"
_open: List["_Marks"] = []


@contextmanager
def together(paths: Iterable[str]) -> Iterator[None]:
    """Within the block, what takes these names is provisional: an error in it undoes all.

    ``paths`` are files and folders, which need not exist. Raises WorkspaceError where one of them is a device.
    """
    targets = list(dict.fromkeys(map(real_target, paths)))
    _recover(targets)
    marks = _Marks(f"{MACHINE}-{os.getpid()}-{os.urandom(4).hex()}")
    _open.append(marks)
    try:
        try:
            marks.make(targets)
            yield
        except BaseException:
            marks.end(marks.undo)
            raise
        marks.settled = True  # in one step: a cancel from here on undoes nothing
        marks.end(marks.remove)
    finally:
        _open.remove(marks)


def undo_all() -> None:
    """Undo what this process has begun to write, for one that is about to end itself."""
    for marks in list(_open):
        if not marks.settled:
            marks.undo()


def recover(paths: Iterable[str]) -> None:
    """Undo what runs of this machine that were killed have left at these places."""
    _recover([real_target(path) for path in paths])


class _Marks:
    """The marks of one run: each target with its mark and the kind of that."""

    def __init__(self, name: str) -> None:
        self.name, self.settled = name, False
        self.made: List[Tuple[Path, Path, str]] = []

    def make(self, targets: Sequence[Path]) -> None:
        for target in targets:
            kind = _FOLDER if target.is_dir() else _BEFORE if os.path.lexists(target) else _ABSENT
            mark = self.mark(target, kind)
            if kind == _FOLDER:
                kept_folders[str(target)] = str(self.mark(target, _BEFORE))
            if target.parent.is_dir():
                self._mark(target, mark, kind)
            self.made.append((target, mark, kind))

    @staticmethod
    def _mark(target: Path, mark: Path, kind: str) -> None:
        with suppress(OSError):  # a folder that cannot be written, which the stage reports
            if kind != _BEFORE:
                mark.touch(exist_ok=False)
            elif target.is_symlink():
                os.replace(target, mark)
            else:
                try:
                    os.link(target, mark)
                except OSError:  # a disk without hard links
                    os.replace(target, mark)

    def mark(self, target: Path, kind: str) -> Path:
        return target.with_name(f".{target.name}.{kind}-{self.name}")

    @staticmethod
    def end(work: Callable[[], None]) -> None:
        """Undo or remove, to the end also where a cancel comes meanwhile."""
        try:
            work()
        except BaseException:
            work()
            raise

    def undo(self) -> None:
        for target, mark, kind in self.made:
            if kind == _BEFORE:
                _give_back(mark, target)
            elif kind == _ABSENT:
                remove_temporary(str(target))
            elif os.path.isdir(self.mark(target, _BEFORE)):
                remove_temporary(str(target))
                _give_back(self.mark(target, _BEFORE), target)
        self.remove()

    def remove(self) -> None:
        for target, mark, kind in self.made:
            kept_folders.pop(str(target), None)
            if kind == _FOLDER:
                remove_temporary(str(self.mark(target, _BEFORE)))
            with suppress(OSError):
                os.unlink(mark)


def _give_back(mark: Path, target: Path) -> None:
    """Give what a mark keeps its name again, where it has lost it."""
    with suppress(OSError):  # another thread has done so
        if not (os.path.lexists(target) and os.path.samestat(os.lstat(mark), os.lstat(target))):
            os.replace(mark, target)


def _recover(targets: Sequence[Path]) -> None:
    runs: Dict[str, _Marks] = {}
    for target in targets:
        for kind in (_BEFORE, _ABSENT, _FOLDER):
            start = f".{target.name}.{kind}-"
            for mark in target.parent.glob(f"{glob.escape(start + MACHINE)}-*"):
                name = mark.name[len(start) :]
                process = name[len(MACHINE) + 1 :].split("-")[0]
                if process.isdigit() and not process_exists(int(process)) and not (kind == _BEFORE and mark.is_dir()):
                    runs.setdefault(name, _Marks(name)).made.append((target, mark, kind))
    for marks in runs.values():
        whole = len(marks.made) == len(targets)
        (marks.undo if whole else marks.remove)()
