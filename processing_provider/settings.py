"""The provider's page in Settings > Options > Processing > Providers."""

from __future__ import annotations

import os
from typing import Any

from qgis.PyQt.QtCore import QCoreApplication
from qgis.PyQt.QtGui import QIcon

from ..repm_qgis.contracts.options import ReconstructOptions

GROUP = "REPM"
ENGINE_PYTHON = "REPM_ENGINE_PYTHON"
WORKERS = "REPM_WORKERS"
MEMORY = "REPM_MEMORY"
CLUSTER = "REPM_CLUSTER"
COLMAP = {name: f"REPM_COLMAP_{name}" for name in ("GEOMETRIC", "COLMAP_FUSION", "WINDOW_RADIUS", "GPU_MEMORY")}
"""The settings of the backend colmap by the parameters whose place they take in the dialogs."""


def _tr(text: str) -> str:
    return QCoreApplication.translate("RepmSettings", text)


def register(icon_path: str) -> None:
    """Add the settings, and read what the user chose before."""
    try:
        from processing.core.ProcessingConfig import ProcessingConfig, Setting
    except ImportError:  # a script that uses the provider without the Processing plugin has no settings page
        return

    ProcessingConfig.settingIcons[GROUP] = QIcon(icon_path)
    ProcessingConfig.addSetting(
        Setting(
            GROUP,
            ENGINE_PYTHON,
            _tr("Engine interpreter (empty: the engine's own environment, else QGIS's Python)"),
            "",
            valuetype=Setting.FILE,
        )
    )
    ProcessingConfig.addSetting(
        Setting(GROUP, WORKERS, _tr("Worker processes (0: one per core)"), 0, valuetype=Setting.INT)
    )
    ProcessingConfig.addSetting(
        Setting(
            GROUP,
            MEMORY,
            _tr("Memory of all workers together (MiB, 0: three quarters of what is free)"),
            0,
            valuetype=Setting.INT,
        )
    )
    ProcessingConfig.addSetting(
        Setting(
            GROUP,
            CLUSTER,
            _tr("Dask cluster: address of the scheduler, or its scheduler file (empty: this machine)"),
            "",
            valuetype=Setting.STRING,
        )
    )
    kinds = {bool: None, int: Setting.INT, float: Setting.FLOAT}
    for (name, setting), label in zip(COLMAP.items(), _colmap_labels()):
        default = ReconstructOptions.default_of(name.lower())
        ProcessingConfig.addSetting(Setting(GROUP, setting, label, default, valuetype=kinds[type(default)]))
    ProcessingConfig.readSettings()


def _colmap_labels() -> tuple[str, ...]:
    return (
        _tr("COLMAP: geometric consistency"),
        _tr("COLMAP: only heights that its fusion keeps"),
        _tr("COLMAP: radius of the window (px)"),
        _tr("COLMAP: memory of a GPU (GiB, 0: what is free)"),
    )


def unregister() -> None:
    """Take the settings out again; the user's values stay for the next time."""
    try:
        from processing.core.ProcessingConfig import ProcessingConfig
    except ImportError:
        return

    for name in (ENGINE_PYTHON, WORKERS, MEMORY, CLUSTER, *COLMAP.values()):
        if name in ProcessingConfig.settings:  # where QGIS ends, Processing may have taken all of them out before
            ProcessingConfig.removeSetting(name)
    ProcessingConfig.settingIcons.pop(GROUP, None)


def _value(name: str) -> Any:
    try:
        from processing.core.ProcessingConfig import ProcessingConfig
    except ImportError:  # a script that uses the provider without the Processing plugin
        return None
    return ProcessingConfig.getSetting(name)


def engine_python() -> str:
    """The interpreter that the user chose, in the settings or by REPM_ENGINE_PYTHON; "" for none."""
    return str(_value(ENGINE_PYTHON) or "").strip() or os.environ.get("REPM_ENGINE_PYTHON", "").strip()


def workers() -> int:
    """How many worker processes the engine may use; 0 means one a core."""
    return _whole(WORKERS)


def memory() -> int:
    """The memory of all workers together, MiB; 0 means a share of the free memory."""
    return _whole(MEMORY)


def cluster() -> str:
    """The address or the scheduler file of a Dask cluster; "" for this machine."""
    return str(_value(CLUSTER) or "").strip()


def of_parameter(name: str) -> object:
    """The settings' value of a parameter that dialogs leave to them; the option's default where they have none."""
    if name == "CLUSTER":
        return cluster()
    default = ReconstructOptions.default_of(name.lower())
    try:
        value = _value(COLMAP[name])
        return default if value in (None, "") else type(default)(value)
    except (TypeError, ValueError):
        return default


def _whole(name: str) -> int:
    try:
        return max(0, int(_value(name) or 0))
    except (TypeError, ValueError):
        return 0
