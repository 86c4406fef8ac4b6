"""The same heights given twice: a copy of a reference is no second witness."""

from __future__ import annotations

from typing import List, Sequence, Tuple

import numpy as np

from .estimation import some_of
from .found import FoundHeights
from .parameters import REGISTRATION, RegistrationParameters


def copies(
    references: Sequence[FoundHeights], parameters: RegistrationParameters = REGISTRATION
) -> List[Tuple[int, int]]:
    """The references that are copies: (number, number of an earlier one with the same heights)."""
    found: List[Tuple[int, int]] = []
    for later in range(len(references)):
        kept = [number for number in range(later) if number not in dict(found)]
        same = [number for number in kept if are_same(references[number], references[later], parameters)]
        if same:
            found.append((later, same[0]))
    return found


def are_same(first: FoundHeights, second: FoundHeights, parameters: RegistrationParameters = REGISTRATION) -> bool:
    """Whether two references have the same heights in the same places, whatever their files' format and order: a file
    and its copy, or a part of it. No two surveys agree to a millimetre."""
    from scipy.spatial import cKDTree

    few, many = sorted((first, second), key=lambda each: len(each.height))
    some = some_of(np.arange(len(few.height)), parameters.copy_heights**2 // 2, 0)
    apart, nearest = cKDTree(many.xy).query(few.xy[some])
    there = apart < parameters.copy_m
    if there.mean() < parameters.copy_share:
        return False
    height = few.height[some][there]
    away = many.height[nearest[there]] - height
    alike = np.abs(away) < parameters.copy_m
    return bool(alike.mean() >= parameters.copy_share and np.ptp(height) > parameters.copy_m)
