"""The same bytes from a Dask cluster as from this machine: a real scheduler, and workers with folders of their own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import Cancelled, ClusterError, MissingPackageError, OptionError
from repm_qgis.imagery import raster
from repm_qgis.runtime.parallel import run_tasks, run_whole, task_mib
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE
from tests.engine import cluster_tasks as tasks
from tests.engine.local_bucket import bucket
from tests.engine.local_cluster import MEMORY_MIB, ROOT, Cluster

pytest.importorskip("distributed", reason="the package 'distributed' is not installed")
FILES = ("dsm.tif", "confidence.tif", "cloud.laz", "mesh.ply")


@pytest.fixture(scope="module")
def start_cluster(tmp_path_factory):
    """start_cluster(): a new cluster with two workers."""
    started = []

    def start(workers=2):
        started.append(Cluster(tmp_path_factory.mktemp("cluster"), workers))
        return started[-1]

    yield start
    for cluster in started:
        cluster.end()


@pytest.fixture(scope="module")
def cluster(start_cluster):
    return start_cluster()


@pytest.fixture
def on(told):
    """on(cluster, **changes): the block in which tasks run on a cluster, and what was said."""
    from repm_qgis.runtime.cluster import cluster_workers

    def block(cluster, read=(), folders=(), cancel_at=None):
        said = told(cancel_at)
        return cluster_workers(getattr(cluster, "address", cluster), read, folders, said), said

    return block


@pytest.mark.long
def test_tasks_run_on_all_workers_and_come_back_in_order(cluster, on):
    block, said = on(cluster)
    with block:
        assert run_tasks(tasks.square, list(range(500)), 0, said, str) == [x * x for x in range(500)]
        assert len(set(run_tasks(tasks.who, [1, 2, 3, 4], 0, said, str)) - {os.getpid()}) == 2
        assert task_mib() == pytest.approx(0.8 * MEMORY_MIB, rel=0.01)
        assert os.getpid() != run_whole(tasks.noted, "it", said, "something")
        with pytest.raises(OptionError, match="x is 7: it must not be seven"):
            run_tasks(tasks.picky, list(range(20)), 0, said, str)
        assert run_tasks(tasks.square, [3], 0, said, str) == [9]  # the cluster works after an error, too
    assert "it was done" in said.notes and "by another process" in said.warnings
    assert any(
        re.search(r"The tasks run on 2 workers of the cluster at '.*scheduler.json'", text) for text in said.notes
    )
    assert task_mib() is None and run_whole(tasks.noted, "it", said, "") == os.getpid()
    assert max(said.fractions) == 1.0


@pytest.mark.long
def test_cancel_ends_a_run_within_two_seconds(cluster, on):
    block, said = on(cluster, cancel_at=20)
    start = time.monotonic()
    with pytest.raises(Cancelled), block:
        run_tasks(tasks.slow, list(range(10)), 0, said, str)
    assert time.monotonic() - start < 4  # with the connection, which is no part of Cancel
    cluster.renew()


@pytest.mark.slow
def test_the_pipeline_gives_the_same_bytes(cluster, hamlet, told, tmp_path):
    options = {"images": hamlet.images[:2], "tile_size": 256, "resolution": 0.5, "workers": 1}

    def run(name, **more):
        made = {file.split(".")[0]: str(tmp_path / name / file) for file in FILES}
        options_ = {**options, **made, "workspace": str(tmp_path / name / "w"), "output": made.pop("dsm"), **more}
        options_.pop("dsm")
        return run_stage("pipeline", options_, told())

    here, there = run("here"), run("there", cluster=cluster.address)
    for file in FILES:
        assert Path(tmp_path / "here" / file).read_bytes() == Path(tmp_path / "there" / file).read_bytes(), file
    assert here.valid == there.valid and here.seconds.keys() == there.seconds.keys()
    compare = {"dsm": there.output, "reference": hamlet.truth, "align": "vertical"}
    figures = [run_stage("comparedsm", {**compare, "cluster": each}, told()) for each in ("", cluster.address)]
    assert figures[0] == figures[1]


@pytest.mark.long
def test_a_mosaic_gives_the_same_bytes_and_the_workers_write_it(cluster, told, tmp_path, monkeypatch):
    heights = np.add.outer(np.arange(300), np.arange(300)).astype(np.float32) / 10
    dsms = []
    for number in range(2):
        place, path = (500000.0 + 150 * number, 1.0, 0.0, 4800000.0, 0.0, -1.0), str(tmp_path / f"dsm_{number}.tif")
        dsms.append(raster.write(path, [heights + 17 * number], place, "EPSG:32631", unit="m"))
    small = replace(ENGINE, mosaic=replace(ENGINE.mosaic, block_cells=96, tile_blocks=2))

    def run(name, **more):
        out = {"output": str(tmp_path / name / "m.tif"), "sources": str(tmp_path / name / "s.vrt")}
        return run_stage("mosaic", {"dsms": dsms, "workers": 1, **out, **more}, told(), small)

    here = run("here")

    def read_here(*_):
        raise AssertionError("the coordinator reads pixels of blocks")

    monkeypatch.setattr("repm_qgis.mosaic.products.MosaicRaster.values", read_here)
    there = run("there", cluster=cluster.address)
    files = [path.relative_to(tmp_path / "here") for path in sorted((tmp_path / "here").rglob("*")) if path.is_file()]
    assert len(files) == 1 + 1 + 2 + 7 and here.offsets == there.offsets
    for file in files:
        assert (tmp_path / "here" / file).read_bytes() == (tmp_path / "there" / file).read_bytes(), file
    assert len(list((tmp_path / "there").rglob("*"))) == len(files) + 1


@pytest.mark.long
def test_a_task_whose_worker_dies_is_done_again_elsewhere(cluster, on, tmp_path):
    block, said = on(cluster)
    with block:
        work = [(x, str(tmp_path / "mark")) for x in range(20)]
        assert run_tasks(tasks.deadly_once, work, 0, said, str) == [x * x for x in range(20)]
    assert os.path.exists(tmp_path / "mark")
    cluster.renew()


@pytest.mark.long
def test_a_tile_that_kills_every_worker_is_named_and_the_rest_is_done(start_cluster, on, tmp_path):
    block, said = on(start_cluster(workers=5))
    words = r"1 of 12 tasks lost four workers each, most likely because memory ran out \(tile 3\); all others are done"
    with pytest.raises(ClusterError, match=words), block:
        run_tasks(tasks.deadly, list(range(12)), 0, said, "tile {}".format)


@pytest.mark.long
def test_a_scheduler_that_dies_ends_the_run_in_a_sentence(start_cluster, on):
    cluster = start_cluster()
    block, said = on(cluster)
    threading.Timer(1.0, cluster.scheduler.kill).start()
    start = time.monotonic()
    with pytest.raises(ClusterError, match="The scheduler of the cluster at '.*' has ended: start it again"), block:
        run_tasks(tasks.slow, list(range(10)), 0, said, str)
    assert time.monotonic() - start < 15


@pytest.mark.long
def test_a_scheduler_that_dies_while_workers_are_asked_is_the_same_sentence(start_cluster, on, monkeypatch):
    from repm_qgis.runtime import cluster as cluster_module  # Dask may be missing

    cluster = start_cluster()
    block, _ = on(cluster)
    ask = cluster_module._require_shared

    def killed_before(*arguments, **named):
        cluster.scheduler.kill()
        cluster.scheduler.wait()
        return ask(*arguments, **named)

    monkeypatch.setattr(cluster_module, "_require_shared", killed_before)
    with pytest.raises(ClusterError, match="The scheduler of the cluster at '.*' has ended: start it again"), block:
        pass


@pytest.mark.parametrize(
    "address, words",
    (
        ("tcp://127.0.0.1:1", "No Dask scheduler answers at 'tcp://127.0.0.1:1'"),
        ("nonsense", "CLUSTER 'nonsense' is neither a file nor an address"),
        ("tls://127.0.0.1:1", "The cluster at 'tls://127.0.0.1:1' requires encryption .TLS.: give the scheduler file"),
        ("foo://x", "No Dask scheduler answers at 'foo://x'"),
        ("empty.json", "No Dask scheduler answers at '.*empty.json' .it holds no address"),
    ),
)
@pytest.mark.long
def test_a_bad_address_is_a_sentence(on, tmp_path, address, words):
    (tmp_path / "empty.json").write_text("{}")
    block, _ = on(str(tmp_path / address) if address.endswith(".json") else address)
    with pytest.raises(ClusterError, match=words), block:
        pass


@pytest.mark.long
def test_workers_that_differ_are_a_sentence(cluster, on, monkeypatch):
    import numpy

    with monkeypatch.context() as change, pytest.raises(ClusterError) as caught:
        change.setattr(numpy, "__version__", "9.9")
        with on(cluster)[0]:
            pass
    assert re.search(r"The worker tcp://\S+ on '127.0.0.1' has numpy \S+, this machine 9.9", str(caught.value))
    monkeypatch.setattr("repm_qgis.runtime.cluster._PACKAGES", ("repm_qgis", "tests.engine.cluster_tasks", "nowhere"))
    monkeypatch.setitem(sys.modules, "nowhere", numpy)
    with pytest.raises(ClusterError, match="has nowhere missing .ModuleNotFoundError"), on(cluster)[0]:
        pass


@pytest.mark.long
def test_storage_that_is_not_shared_is_a_sentence(cluster, on, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "image.tif").write_bytes(b"1")
    own = "/proc/self/cwd"  # another folder in every process
    for changes in ({"read": [f"{own}/image.tif"]}, {"folders": [f"{own}/out"]}):
        with pytest.raises(ClusterError, match="The worker .* cannot use '/proc/self/cwd/.*No such file") as caught:
            with on(cluster, **changes)[0]:
                pass
        assert "put images, workspace and products on storage that all machines see" in str(caught.value)
    with on(cluster, read=[str(tmp_path / "image.tif")], folders=[str(tmp_path / "out")])[0]:
        assert os.listdir(tmp_path / "out") == []


@pytest.mark.slow
def test_images_in_cloud_storage_are_read_by_the_workers(cluster, on, hamlet, told, tmp_path, monkeypatch):
    """A bucket on this machine: the same heights as from files; workers without its settings are a sentence."""
    bases = [os.path.basename(path) for path in hamlet.images[:2]]
    made = {"tile_size": 256, "resolution": 0.5, "output": str(tmp_path / "dsm.tif"), "workspace": str(tmp_path / "w")}
    options = {**made, "images": hamlet.images[:2], "workspace": str(tmp_path / "files")}
    wanted = gdal.Open(run_stage("pipeline", options, told()).output).ReadAsArray()
    with bucket(os.path.dirname(hamlet.images[0])) as (settings, asked):
        for name, value in settings.items():
            monkeypatch.setenv(name, value)
        images = [f"/vsis3/town/{base}" for base in bases]
        words = f"The worker .* on '127.0.0.1' cannot use '{images[0]}' .GDAL does not find it"
        with pytest.raises(ClusterError, match=words), on(cluster, read=images)[0]:
            pass
        there = Cluster(tmp_path, 2)  # its processes have the settings of this one
        try:
            before = len(asked)
            run_stage("pipeline", {**made, "images": images, "cluster": there.address}, told())
        finally:
            there.end()
    np.testing.assert_array_equal(gdal.Open(made["output"]).ReadAsArray(), wanted)
    assert len(asked) > before


def test_a_cluster_without_dask_is_a_sentence_and_nothing_imports_it_otherwise(hamlet, told, tmp_path, monkeypatch):
    code = (
        "import sys; import repm_qgis.stages.pipeline, repm_qgis.stages.comparedsm; print('distributed' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout == "False\n"
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "repm_qgis.runtime.cluster", raising=False)
    options = {"images": hamlet.images[:2], "workspace": str(tmp_path / "w"), "output": str(tmp_path / "d.tif")}
    with pytest.raises(MissingPackageError, match="CLUSTER needs the Python package 'distributed'"):
        run_stage("pipeline", {**options, "cluster": "tcp://127.0.0.1:1"}, told())


def test_relative_paths_are_refused(hamlet, told, tmp_path, monkeypatch):
    """Workers would read and write them in their own folders."""
    monkeypatch.chdir(tmp_path)
    options = {"images": hamlet.images[:2], "workspace": str(tmp_path / "w"), "output": "dsm.tif"}
    with pytest.raises(OptionError, match="OUTPUT is 'dsm.tif': it must be an absolute path where CLUSTER is used"):
        run_stage("pipeline", {**options, "cluster": "tcp://127.0.0.1:1"}, told())
