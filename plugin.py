"""The plugin object: adds the Processing provider and the translations to QGIS, and removes them."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Optional

from qgis.core import QgsApplication
from qgis.PyQt.QtCore import QCoreApplication, QTranslator

from .processing_provider import engine
from .processing_provider.language import locale
from .processing_provider.provider import RepmProvider

if TYPE_CHECKING:  # widgets: qgis_process has none
    from .desktop.menu import PluginMenu

_FOLDER = os.path.dirname(os.path.abspath(__file__))


class RepmPlugin:
    """Registers the provider ``repm`` and the translator; ``unload`` undoes both."""

    def __init__(self, iface: object) -> None:
        self.iface = iface
        self.provider: Optional[RepmProvider] = None
        self.translator: Optional[QTranslator] = None
        self.menu: Optional[PluginMenu] = None

    def initProcessing(self) -> None:
        """Register the provider; qgis_process needs no more than this."""
        engine.end_at_ctrl_c()
        self._install_translator()
        if self.provider is None:
            self.provider = RepmProvider()
            QgsApplication.processingRegistry().addProvider(self.provider)
            # Our models use our own algorithms, which the registry knows only from here on.
            self.provider.refreshAlgorithms()

    def initGui(self) -> None:
        """Called by the desktop only."""
        self.initProcessing()
        from .desktop.menu import PluginMenu  # widgets: qgis_process has none

        self.menu = PluginMenu(self.iface)

    def unload(self) -> None:
        if self.menu is not None:
            self.menu.remove()
            self.menu = None
        if self.provider is not None:
            QgsApplication.processingRegistry().removeProvider(self.provider)
            self.provider = None
        if self.translator is not None:
            QCoreApplication.removeTranslator(self.translator)
            self.translator = None

    def _install_translator(self) -> None:
        for name in (locale(), locale()[:2]):
            path = os.path.join(_FOLDER, "i18n", f"repm_{name}.qm")
            if self.translator is None and name and os.path.exists(path):
                translator = QTranslator()
                if translator.load(path):
                    QCoreApplication.installTranslator(translator)
                    self.translator = translator
