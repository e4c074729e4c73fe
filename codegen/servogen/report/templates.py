"""The environment of the pages' templates."""

from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined


@cache
def pages() -> Environment:
    """The HTML templates in servogen/report/templates; a name that is not defined is an error."""
    return Environment(
        loader=PackageLoader("servogen", "report/templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=True,
    )
