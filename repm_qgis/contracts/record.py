"""The base of dataclasses that are written to JSON and read from it."""

from __future__ import annotations

import dataclasses
from typing import Mapping, Type, TypeVar

from .checks import Misfit, mapping, member, typed, types_of
from .documents import JsonObject

R = TypeVar("R", bound="Record")


class Record:
    """The base of dataclasses that are written to JSON: one entry a field, under the field's name.

    The annotations of its fields say what the entries must be (:mod:`repm_qgis.contracts.checks`).
    """

    def to_mapping(self) -> JsonObject:
        return {field.name: _plain(getattr(self, field.name)) for field in dataclasses.fields(self)}  # type: ignore[arg-type]

    @classmethod
    def from_mapping(cls: Type[R], values: Mapping[str, object]) -> R:
        """Raises Misfit where an entry is missing, does not fit its field's type, or contradicts another one."""
        types, entries = types_of(cls), {}
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]  # every subclass is a dataclass
            with member(field.name):
                if field.name in mapping(values):
                    entries[field.name] = typed(types[field.name], values[field.name])
                elif field.default is field.default_factory is dataclasses.MISSING:
                    raise Misfit("is missing")
        record = cls(**entries)
        contradiction = record.contradiction()
        if contradiction:
            raise Misfit(contradiction)
        return record

    def contradiction(self) -> str:
        """How entries that are valid one by one contradict each other: "has ..."; "" where they do not."""
        return ""


def _plain(value: object) -> object:
    """A value as JSON has it."""
    if hasattr(value, "to_mapping"):
        return value.to_mapping()
    if hasattr(value, "tolist"):  # an array: whoever needs records alone loads no numpy
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value
