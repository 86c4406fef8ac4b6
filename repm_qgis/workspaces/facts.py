"""What is known of a workspace: plain data about its images, runs and products."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import List, Mapping, NamedTuple, Optional, Tuple, Union

from ..contracts.products import Product

SCENES = ("registered.json", "reconstructed.json", "refined.json", "scene.json")
"""The scenes of a workspace, the most advanced first."""
Value = Union[str, float, bool, Tuple[str, ...]]


class ImageFacts(NamedTuple):
    """An image of a scene: when it was taken (ISO 8601, UTC; "" unknown), the sun's azimuth and elevation in degrees
    (None: unknown), and whether its file is there; of a ``remote`` one nobody has looked."""

    name: str
    path: str
    acquired: str
    sun: Optional[Tuple[float, float]]
    there: bool
    remote: bool


class ProductFacts(NamedTuple):
    """A product with the bytes that it and what belongs to it take; ``removable``: the workspace holds it itself,
    without a link that leads out of it, and the scene does not need it."""

    product: Product
    path: str
    size: int
    there: bool
    removable: bool


@dataclass(frozen=True)
class RunFacts:
    """A run, by its report: when that was written (seconds since 1970), the heading of its ``verdict`` in the report's
    language ("" where it has none), whether that is ``good``, what it says, and the values of the run's options where
    they are recorded; ``differing``: the options that are not the defaults, in words."""

    title: str
    report: str
    time: float
    verdict: str = ""
    good: bool = False
    text: str = ""
    stage: str = ""
    options: Mapping[str, Value] = field(default_factory=dict)
    differing: Tuple[str, ...] = ()


@dataclass(frozen=True)
class Workspace:
    """A folder with a scene; ``problem`` says why its scene cannot be read, ``writer`` who is writing in it now."""

    folder: str
    title: str
    scene: str = ""
    bounds: Optional[Tuple[float, float, float, float]] = None
    crs: str = ""
    registered: bool = False
    images: Tuple[ImageFacts, ...] = ()
    runs: Tuple[RunFacts, ...] = ()
    products: Tuple[ProductFacts, ...] = ()
    problem: str = ""
    writer: str = ""

    @property
    def days(self) -> List[str]:
        """The days (ISO 8601) on which its images were taken, in order."""
        return sorted({each.acquired[:10] for each in self.images if each.acquired})

    def product(self, stage: str, option: str = "output") -> Optional[ProductFacts]:
        """The first product of a kind that is there."""
        return next((each for each in self.products if _is(each, stage, option) and each.there), None)


def _is(made: ProductFacts, stage: str, option: str) -> bool:
    return (made.product.stage, made.product.option) == (stage, option)
