"""Want of disk space, open files and memory: a sentence, and the old file or the new one, whatever library writes."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from osgeo import ogr

from repm_qgis.contracts.errors import ImageError, MissingPackageError, OutOfMemoryError, WorkerError, WorkspaceError
from repm_qgis.exports.images import encode
from repm_qgis.files import las
from repm_qgis.files.vector import write_layer
from repm_qgis.imagery.raster import write
from repm_qgis.runtime import shortage
from repm_qgis.runtime.shortage import shortage_as_error, speaks_of_memory
from repm_qgis.runtime.workspace import write_text, writing
from repm_qgis.solids.ept import write_ept
from repm_qgis.solids.mesh import write_mesh
from repm_qgis.solids.point_cloud import created_cloud
from repm_qgis.stages import run_stage

if sys.platform != "win32":
    import resource
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limits")
CRS = "EPSG:32631"
ROOT = Path(__file__).resolve().parents[3]
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not bound it")
NOISE = np.random.default_rng(1).uniform(0, 250, (400, 400))
DSM = (NOISE.astype(np.float32), (5e5, 1, 0, 4.8e6, 0, -1))


@contextmanager
def bounded(kind, value):
    """Bound files to so many bytes (as a full disk does), or this process to so many open ones, within the block."""
    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (value, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


def cloud(path):
    x, y = np.meshgrid(np.arange(400.0) + 5e5, np.arange(400.0) + 4.8e6)
    with created_cloud(path, CRS, (5e5, 4.8e6, 0.0)) as writer:
        for rows in np.array_split(np.arange(400), 4):
            writer.write(x[rows].ravel(), y[rows].ravel(), NOISE[rows].ravel(), np.ones(rows.size * 400))


def layer(path):
    def features():
        for number in range(3000):
            point = ogr.Geometry(ogr.wkbPoint)
            point.AddPoint_2D(number, number)
            yield point, (number,)

    write_layer(path, CRS, ogr.wkbPoint, {"number": int}, features())


def picture(path):
    plain = os.path.join(os.path.dirname(path), "plain.tif")
    with bounded(resource.RLIMIT_FSIZE, resource.RLIM_INFINITY):
        write(plain, [NOISE.astype(np.uint8)], None, "", nodata=None)
    encode(plain, Path(path))


def intermediate(path):
    with writing(path):
        np.savez(path, NOISE)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A cloud and a DSM, which EPT and mesh are made from."""
    folder = tmp_path_factory.mktemp("made")
    cloud(str(folder / "a.laz"))
    write(str(folder / "dsm.tif"), [DSM[0]], DSM[1], "")
    return folder


def writers(made):
    return {
        "a.laz": cloud,
        "a.las": cloud,
        "ept": lambda path: write_ept(str(made / "a.laz"), path, CRS),
        "a.ply": lambda path: write_mesh(str(made / "dsm.tif"), path),
        "a.tif": lambda path: write(path, [DSM[0]], DSM[1], "", cog=True),
        "b.tif": lambda path: write(path, [DSM[0]] * 3, DSM[1], "", own=True),
        "a.gpkg": layer,
        "a.geojson": layer,
        "a.fgb": layer,
        "shapes.shp": layer,
        "a.png": picture,
        "a.jpg": picture,
        "a.html": lambda path: write_text(path, "x" * 300_000),
        "a.npz": intermediate,
    }


def content(place):
    return {path: path.read_bytes() for path in place.rglob("*") if path.is_file() and path.name != "a.npz"}


NAMES = tuple(writers(Path()))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("older", (False, True))
@pytest.mark.long
def test_a_file_that_finds_no_space_is_not_written_and_the_older_one_stays(made, tmp_path, name, older):
    work, path = writers(made)[name], str(tmp_path / name)
    if older:
        work(path)
    before, failed = content(tmp_path), 0
    for size in (0, 100, 2000, 8192, 30_000, 100_000):
        try:
            with bounded(resource.RLIMIT_FSIZE, size):
                work(path)
        except WorkspaceError as error:
            failed += 1
            assert str(path) in str(error) and "\n" not in str(error) and "place" in str(error)
            assert content(tmp_path) == before
        else:
            before = content(tmp_path)
        assert not [left for left in tmp_path.rglob("*part*") if left.name != "a.npz"]
    assert failed >= 4


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.long
def test_too_many_open_files(made, tmp_path, name):
    work, path = writers(made)[name], str(tmp_path / name)
    work(path)
    before = content(tmp_path)
    used = max(int(number) for number in os.listdir("/dev/fd"))
    for more in range(4):
        try:
            with bounded(resource.RLIMIT_NOFILE, used + more):
                work(path)
        except (WorkspaceError, ImageError, WorkerError) as error:
            assert "\n" not in str(error)
        left = content(tmp_path)
        assert set(left) == set(before)


@pytest.mark.parametrize(
    "words",
    (
        "Unable to allocate 3.05 GiB for an array with shape (1,)",
        "OpenCV(4.11.0) alloc.cpp:73: error: (-4:Insufficient memory) Failed to allocate 9 bytes",
        "VRT: Out of memory allocating 12 bytes",
        "libgdal.so.36: failed to map segment from shared object",
        "can't start new thread",
        "std::bad_alloc",
        "DLL load failed while importing cv2: The paging file is too small for this operation to complete.",
    ),
)
def test_what_libraries_say_of_memory_is_understood(words):
    assert speaks_of_memory(words) and not speaks_of_memory("the raster 'a.tif' has no memory of its mask")
    for kind in (RuntimeError, ImportError, MemoryError, SystemError):
        with pytest.raises(OutOfMemoryError, match=r"^Memory ran out \(.*\): use fewer WORKERS") as caught:
            with shortage_as_error():
                raise kind(f"line one\n{words}")
        assert "\n" not in str(caught.value) and "MEMORY" in str(caught.value)


def test_memory_is_named_where_another_error_hides_it():
    with pytest.raises(OutOfMemoryError), shortage_as_error():
        try:
            raise ImportError("libtorch.so: cannot allocate memory in static TLS block")
        except ImportError as error:
            raise MissingPackageError("Point clouds need the Python package 'laspy'.") from error
    with pytest.raises(OutOfMemoryError), shortage_as_error():
        raise OSError(errno.ENOMEM, "Cannot allocate memory")


def test_the_disk_is_named_where_nobody_did():
    with pytest.raises(WorkspaceError, match="'/w/a': the disk is full"), shortage_as_error():
        raise OSError(errno.ENOSPC, "No space left on device", "/w/a")
    with pytest.raises(WorkspaceError, match=r"\(Too many open files\): .*ulimit -n"), shortage_as_error():
        raise OSError(errno.EMFILE, "Too many open files")


@linux
@pytest.mark.parametrize("limit, fails", ((200, True), (400, True), (3000, False)))
def test_a_bounded_address_space_ends_in_a_sentence_and_never_hangs(tmp_path, limit, fails):
    """OpenBLAS would try forever to get its buffer."""
    if limit == 400:  # enough for the reference's linear algebra, which a bare Debian has
        code = "import numpy.linalg; print('openblas' in open('/proc/self/maps').read())"
        fails = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True).stdout == b"True\n"
    (tmp_path / "job.json").write_text(json.dumps({"report": str(tmp_path / "a.html")}))
    done = subprocess.run(
        [sys.executable, "-m", "repm_qgis", "environment", str(tmp_path / "job.json")],
        cwd=ROOT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit << 20, limit << 20)),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    last = json.loads(done.stdout.splitlines()[-1])
    assert last["type"] == ("error" if fails else "result") and "Traceback" not in done.stderr
    assert not fails or last["text"].startswith("Memory ran out")


def test_buffers_are_taken_only_where_there_is_room(monkeypatch):
    for rest in (None, 1 << 40):
        monkeypatch.setattr(shortage, "own_rest", lambda rest=rest: rest)
        shortage.reserve_buffers()
    monkeypatch.setattr(shortage, "own_rest", lambda: 100 << 20)
    with pytest.raises(OutOfMemoryError, match="only 100 MiB of address space are left, and 192 MiB are needed"):
        shortage.reserve_buffers()


def test_a_cloud_is_the_same_where_only_one_core_compresses(tmp_path, monkeypatch):
    cloud(str(tmp_path / "a.laz"))
    monkeypatch.setattr(las, "own_rest", lambda: 1 << 40)
    cloud(str(tmp_path / "b.laz"))
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()


def test_other_errors_stay_as_they_are():
    for error in (
        KeyError("a"),
        OSError(errno.ENOENT, "gone", "/w/a"),
        RuntimeError("no"),
        ImageError("a.tif is bad."),
    ):
        with pytest.raises(type(error)) as caught, shortage_as_error():
            raise error
        assert caught.value is error


def test_every_stage_says_it(tmp_path, told, monkeypatch):
    from repm_qgis.stages import environment

    def hungry(*_):
        np.empty(1 << 60, np.uint8)

    monkeypatch.setattr(environment, "run", hungry)
    with pytest.raises(OutOfMemoryError, match="Memory ran out .*allocate"):
        run_stage("environment", {"report": str(tmp_path / "a.html")}, told())
