"""The surfaces of the comparisons' tests, which pages are written about."""

from tests.engine.evaluation.conftest import make_raster, surface, terrain  # noqa: F401
