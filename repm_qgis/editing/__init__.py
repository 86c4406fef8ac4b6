"""Edits of a DSM: records of what an analyst removed, filled, flattened or drew, applied in their order."""
