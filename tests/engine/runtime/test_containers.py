"""The limits of containers, from a made-up tree of the kernel's files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from repm_qgis.runtime import memory
from repm_qgis.runtime.containers import container_rest, memory_kills, own_rest

ROOT = Path(__file__).resolve().parents[3]
MIB = 1 << 20
V2 = "41 31 0:38 {} /sys/fs/cgroup rw,nosuid shared:9 - cgroup2 cgroup2 rw"
V1 = "35 31 0:32 {} /sys/fs/cgroup/memory rw - cgroup cgroup rw,memory"
OTHER = "33 31 0:30 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu"


@pytest.fixture
def kernel(tmp_path):
    """kernel(cgroup, mountinfo, files): the root of a tree with the process's groups, mounts and files of groups."""

    def made(cgroup, mounts, files):
        place = tmp_path / "proc" / "self"
        place.mkdir(parents=True, exist_ok=True)
        (place / "cgroup").write_text(f"{cgroup}\n")
        (place / "mountinfo").write_text("\n".join(["1 0 8:1 / / rw - ext4 /dev/sda rw", OTHER, *mounts, ""]))
        for name, text in files.items():
            path = tmp_path / "sys" / "fs" / "cgroup" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"{text}\n")
        return str(tmp_path)

    return made


def group(folder, limit, used, cached=0):
    """The files of a group of version 2, MiB."""
    limit = limit if isinstance(limit, str) else limit * MIB
    statistics = f"anon 5\nfile 7\ninactive_file {cached * MIB}\nslab 3"
    return {
        f"{folder}memory.max": limit,
        f"{folder}memory.current": used * MIB,
        f"{folder}memory.stat": statistics,
    }


def test_the_smallest_rest_of_all_groups_above_counts_without_what_can_be_dropped(kernel):
    files = {**group("", "max", 9000), **group("user/", 1000, 400, 100), **group("user/job/", 2000, 300)}
    assert container_rest(kernel("0::/user/job", [V2.format("/")], files)) == 700 * MIB
    files = group("user/job/", 500, 450, 440)
    assert container_rest(kernel("0::/user/job", [V2.format("/")], files)) == 490 * MIB
    files = group("user/job/", 500, 600)
    assert container_rest(kernel("0::/user/job", [V2.format("/")], files)) == 0


def test_a_group_without_a_limit_has_none(kernel):
    assert container_rest(kernel("0::/job", [V2.format("/")], group("job/", "max", 100))) is None
    assert container_rest(kernel("0::/job", [], group("job/", 100, 10))) is None
    assert container_rest(kernel("", [V2.format("/")], {})) is None
    assert container_rest("/nowhere") is None


@pytest.mark.parametrize("own, top", (("/", "/"), ("/docker/abc", "/docker/abc"), ("/../../x", "/"), ("/gone", "/")))
def test_a_container_sees_its_own_group_as_the_mounted_one(kernel, own, top):
    assert container_rest(kernel(f"0::{own}", [V2.format(top)], group("", 300, 100))) == 200 * MIB


def test_version_1(kernel):
    unlimited = {"memory/memory.limit_in_bytes": 9223372036854771712, "memory/memory.usage_in_bytes": 50 * MIB}
    files = {
        **unlimited,
        "memory/docker/abc/memory.limit_in_bytes": 800 * MIB,
        "memory/docker/abc/memory.usage_in_bytes": 700 * MIB,
        "memory/docker/abc/memory.stat": f"inactive_file 1\ntotal_inactive_file {300 * MIB}",
        "memory/docker/abc/memory.oom_control": "oom_kill_disable 0\nunder_oom 0\noom_kill 3",
    }
    root = kernel("9:name=systemd:/\n4:memory:/docker/abc\n1:cpu:/\n0::/", [V1.format("/"), V2.format("/")], files)
    assert container_rest(root) == 400 * MIB
    assert memory_kills(root) == 3


def test_kills_for_memory_are_those_of_the_own_group_or_of_the_machine(kernel):
    files = {"job/memory.events": "low 0\noom 2\noom_kill 2\noom_group_kill 0", "memory.events": "oom_kill 9"}
    root = kernel("0::/job", [V2.format("/")], files)
    assert memory_kills(root) == 2
    (Path(root) / "sys/fs/cgroup/job/memory.events").unlink()
    assert memory_kills(root) is None
    (Path(root) / "proc" / "vmstat").write_text("pgfault 4\noom_kill 5\n")
    assert memory_kills(root) == 5


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not bound the address space")
def test_the_limit_of_the_shell_counts():
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30)); "
        "from repm_qgis.runtime.memory import free_mib; print(free_mib())"
    )
    said = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert 700 < float(said) < 1024
    assert own_rest() is None or own_rest() > 0


def test_free_memory_is_the_least_that_anything_leaves(monkeypatch):
    monkeypatch.setattr(memory, "kernel_memory", lambda: {"MemAvailable": 900 * MIB})
    for container, own, free in ((300, 500, 300), (300, 100, 100), (None, None, 900), (5000, None, 900)):
        monkeypatch.setattr(memory, "container_rest", lambda rest=container: None if rest is None else rest * MIB)
        monkeypatch.setattr(memory, "own_rest", lambda rest=own: None if rest is None else rest * MIB)
        assert memory.free_mib() == free
