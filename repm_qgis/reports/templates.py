"""The templates of reports and charts, in ``resources/templates``; all text that they take is escaped.

Their filter ``said`` translates, see :mod:`repm_qgis.runtime.translation`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from ..contracts.data_folder import DATA_FOLDER
from ..contracts.errors import MissingPackageError
from ..runtime.translation import said

if TYPE_CHECKING:
    from jinja2 import Environment

RESOURCES = DATA_FOLDER / "resources"


class Drawing(str):
    """SVG that a template made, or a script or style of resources: text that needs no escaping."""

    def __html__(self) -> str:
        return self


@lru_cache(maxsize=1)
def _environment() -> Environment:
    try:  # here, so that what shows no report works without the package
        import jinja2
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ImportError as error:
        raise MissingPackageError(
            f"Reports are written with the Python package 'jinja2', which is not installed ({error}): run "
            "repm:environment, which shows the command that installs it, or leave REPORT empty."
        ) from error
    loader = FileSystemLoader([str(RESOURCES / "templates"), str(RESOURCES / "viewer")])
    found = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    found.filters["fixed"] = lambda value, decimals: f"{value:.{decimals}f}"
    # A filter without the context is applied to constants once: these would stay in the language of the first page.
    in_context = getattr(jinja2, "pass_context" if hasattr(jinja2, "pass_context") else "contextfilter")  # before 3.0
    # Scripts and styles, as they are: their signs would mean something to the template.
    found.globals["asset"] = lambda name: Drawing(loader.get_source(found, name)[0])
    found.filters["said"] = in_context(lambda context, value: said(value))
    return found


def page(template: str, **values: object) -> str:
    """A whole template, filled in. Raises MissingPackageError where jinja2 is not installed."""
    return _environment().get_template(template).render(**values)


def draw(kind: str, **values: object) -> Drawing:
    """One macro of ``charts.svg``, filled in. Raises MissingPackageError where jinja2 is not installed."""
    return Drawing(getattr(_environment().get_template("charts.svg").module, kind)(**values))
