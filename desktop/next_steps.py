"""What to do next, as buttons in a message above the map: each opens a dialog with what an algorithm has found."""

from __future__ import annotations

from typing import Any, Mapping, Optional, Sequence, Tuple

from qgis.core import Qgis
from qgis.PyQt.QtWidgets import QPushButton

Step = Tuple[str, str, Mapping[str, Any]]
"""A button's text, and the id and parameters of the algorithm whose dialog it opens."""

_open: dict[str, Any] = {}
_dialogs: list[Any] = []


def offer(text: str, steps: Sequence[Step], topic: str) -> Optional[Any]:
    """Show a message with a button for each step, in place of an earlier one of the same topic; gives the message.

    None where there is no desktop, as under qgis_process.
    """
    from qgis.utils import iface

    if iface is None or not steps:
        return None
    bar = iface.messageBar()
    earlier = _open.pop(topic, None)
    if earlier is not None:
        bar.popWidget(earlier)
    message = bar.createMessage("REPM", text)
    for words, algorithm, parameters in steps:
        button = QPushButton(words, message)
        button.clicked.connect(lambda _=False, named=algorithm, values=dict(parameters): open_dialog(named, values))
        message.layout().addWidget(button)
    message.destroyed.connect(lambda *_: _open.pop(topic, None))
    _open[topic] = bar.pushWidget(message, Qgis.MessageLevel.Info, 0)
    return _open[topic]


def open_dialog(algorithm: str, parameters: Mapping[str, Any]) -> Any:
    """Open an algorithm's dialog with these parameters filled in."""
    import processing

    # Without a reference from here, Python forgets what a dialog is while it is still open.
    dialog = processing.createAlgorithmDialog(algorithm, dict(parameters))
    _dialogs.append(dialog)
    dialog.show()
    return dialog


def forget() -> None:
    """Take the messages away, as the plugin is unloaded."""
    from qgis.utils import iface

    for message in list(_open.values()):
        iface.messageBar().popWidget(message)
    _open.clear()
