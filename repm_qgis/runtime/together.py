"""The products of a run appear together or not at all.

Each file is written under a temporary name and renamed when it is complete (:mod:`.workspace`); but a run writes
several, and one that fails or is cancelled would leave new ones beside old ones. So what was there before the run keeps
a second name until the run has ended well: ``.dsm.tif.before-MACHINE-PROCESS-NUMBER`` is the old file itself (a hard
link: nothing is copied), ``.dsm.tif.absent-...`` says that there was none. A run that fails gives the old files their
names back and removes the new ones. After a kill, the caller or the next run with these products does so.

All marks are made before the work and removed after it: where some are missing, the run had ended well, or not begun.
What a stage writes into a folder that may hold other files is known later only: it joins the run before it is written,
and ``.FOLDER.within-...`` beside the folder lists it, which is the last mark to be made and to go.
"""

from __future__ import annotations

import glob
import json
import os
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Callable, Dict, Iterable, Iterator, List, Sequence, Tuple

from .workspace import MACHINE, kept_folders, process_exists, real_target, remove_temporary, write_text

_BEFORE, _ABSENT, _FOLDER, _WITHIN = "before", "absent", "folder", "within"
_COPIED = ".json"  # scenes are read in the run that writes them
_open: List["_Marks"] = []


@contextmanager
def together(paths: Iterable[str], folders: Iterable[str] = ()) -> Iterator[None]:
    """Within the block, what takes these names is provisional: an error in it undoes all.

    ``paths`` are files and folders, which need not exist, and ``folders`` those that others may write into, see
    :func:`join`. Raises WorkspaceError where one of them is a device.
    """
    targets = list(dict.fromkeys(map(real_target, paths)))
    _recover(targets, list(map(real_target, folders)))
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


def join(folder: str, names: Iterable[str]) -> None:
    """Make files and folders of these names in one of the run's folders, which must exist, part of what appears
    together; outside of a run, nothing."""
    if _open:
        root, named = real_target(folder), list(names)
        _recover([root / name for name in named], [])
        _open[-1].make([root / name for name in named])
        _open[-1].list(root, named)


def undo_all() -> None:
    """Undo what this process has begun to write, for one that is about to end itself."""
    for marks in list(_open):
        if not marks.settled:
            marks.undo()


def recover(paths: Iterable[str], folders: Iterable[str] = ()) -> None:
    """Undo what runs of this machine that were killed have left at these places, and in these folders."""
    _recover([real_target(path) for path in paths], list(map(real_target, folders)))


class _Marks:
    """The marks of one run: each target with its mark and the kind of that."""

    def __init__(self, name: str) -> None:
        self.name, self.settled = name, False
        self.made: List[Tuple[Path, Path, str]] = []
        self.lists: List[Path] = []

    def list(self, folder: Path, names: Sequence[str]) -> None:
        """Note which of the marks are those of a folder's contents."""
        self.lists.append(self.mark(folder, _WITHIN))
        write_text(str(self.lists[-1]), json.dumps(names))

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
                    (shutil.copy2 if target.suffix == _COPIED else os.replace)(target, mark)

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
                if kind == _BEFORE and not os.path.lexists(target):  # it was not written, on a disk without hard links
                    os.replace(mark, target)
                else:
                    os.unlink(mark)
        for each in self.lists:
            remove_temporary(str(each))


def _give_back(mark: Path, target: Path) -> None:
    """Give what a mark keeps its name again, where it has lost it."""
    with suppress(OSError):  # another thread has done so
        if not (os.path.lexists(target) and os.path.samestat(os.lstat(mark), os.lstat(target))):
            os.replace(mark, target)


def _recover(targets: Sequence[Path], folders: Sequence[Path]) -> None:
    runs: Dict[str, _Marks] = {}
    expected: Dict[str, int] = {}
    for target in targets:
        for mark, kind, name in _marks_at(target, (_BEFORE, _ABSENT, _FOLDER)):
            runs.setdefault(name, _Marks(name)).made.append((target, mark, kind))
    for folder in folders:
        for listed, _, name in _marks_at(folder, (_WITHIN,)):
            marks = runs.setdefault(name, _Marks(name))
            marks.lists.append(listed)
            inner = [folder / each for each in _listed(listed)]
            expected[name] = expected.get(name, 0) + len(inner)
            for target in inner:
                found = _marks_at(target, (_BEFORE, _ABSENT, _FOLDER))
                marks.made += [(target, mark, kind) for mark, kind, own in found if own == name]
    for name, marks in runs.items():
        whole = len(marks.made) == len(targets) + expected.get(name, 0)
        (marks.undo if whole else marks.remove)()


def _marks_at(target: Path, kinds: Sequence[str]) -> Iterator[Tuple[Path, str, str]]:
    """The marks of a target that runs of this machine have left which are gone: each with its kind and the run."""
    for kind in kinds:
        start = f".{target.name}.{kind}-"
        for mark in target.parent.glob(f"{glob.escape(start + MACHINE)}-*"):
            name = mark.name[len(start) :]
            process = name[len(MACHINE) + 1 :].split("-")[0]
            if process.isdigit() and not process_exists(int(process)) and not (kind == _BEFORE and mark.is_dir()):
                yield mark, kind, name


def _listed(path: Path) -> List[str]:
    """The names in a list, which may come from anybody: those of the folder's own contents only."""
    with suppress(OSError, ValueError):
        names = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(names, list):
            return [
                each
                for each in names
                if isinstance(each, str) and each == os.path.basename(each) not in ("", ".", "..")
            ]
    return []
