"""The types of what comes from JSON, or goes there, and of arguments by their names.

A checker of types does not know them: whoever reads a value has checked it (:mod:`repm_qgis.contracts.checks`), or has
written it.
"""

from __future__ import annotations

from typing import Any, Dict, Mapping

JsonObject = Dict[str, Any]
JsonMapping = Mapping[str, Any]
"""The same, which is only read."""
Keywords = Dict[str, Any]
"""Arguments of one call by their names, collected before it."""
