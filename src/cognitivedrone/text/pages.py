"""HTML pages that load nothing: made from the templates of a package, with all text in them escaped."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import jinja2


def render_page(package: str, template: str, filters: Mapping[str, Callable[..., Any]], **values: Any) -> str:
    """A template of `package`'s folder `templates` with `values`; a name that it has and they lack is an error."""
    environment = _environment(package)
    environment.filters |= filters
    return environment.get_template(template).render(values)


@functools.cache
def _environment(package: str) -> jinja2.Environment:
    """It keeps the compiled templates: compiling takes longer than writing most reports."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
