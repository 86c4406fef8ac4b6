"""The base of all sets of parameters: numbers of the method that users do not set and studies vary.

A subject's parameters are one frozen dataclass in its package's ``parameters.py``. Each field's documentation gives
its unit and its source: physics, a paper, or the table of docs/benchmarks that measured it. A study writes
``replace(parameters, ...)`` and passes the result in; nothing sets a module's names.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Dict


@dataclass(frozen=True)
class Parameters:
    """The base of all sets of parameters; every field has a default, and may be another set."""

    def changes(self) -> Dict[str, object]:
        """The fields that differ from their defaults, JSON-able; sets within this one as objects within the object.

        It is empty for the defaults, so results made with them have the same fingerprint as before a field was added.
        """
        found: Dict[str, object] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Parameters):
                inner = value.changes()
                if inner:
                    found[field.name] = inner
            elif value != _default(field):
                found[field.name] = value
        return found


def _default(field: "dataclasses.Field[object]") -> object:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
