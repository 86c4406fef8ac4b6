"""REPM: digital surface models from satellite images with RPCs. QGIS loads this file; the work is in repm_qgis."""


def classFactory(iface: object) -> object:  # noqa: N802 - QGIS asks for this name
    """Make the plugin for QGIS, which calls this. ``iface`` is None in qgis_process."""
    from .plugin import RepmPlugin

    return RepmPlugin(iface)
