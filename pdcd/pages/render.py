"""Makes all pages, from Jinja templates in `assets/` whose values are always shown as text.

Much of a page's text comes from clients, operators and devices: notes, tags, file names, models.
None of it may have effects. So every text is escaped twice: invisible characters are spelled out
(`pdcd.printable`), then HTML's own escaping follows. And the policy of a page lets only the script
run whose digest it names, and only pictures beside the page be fetched.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import threading
from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from pdcd.files.text import encode_json
from pdcd.printable import to_one_line
from pdcd.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

_STYLE = "page.css"
"""Style sheet of all pages; each page has another one, called like its template."""


def render(template: str, **values: Any) -> str:
    """A template of `assets/`, filled in with values, each of which is shown as text.

    It is for parts of pages, such as a run in a notebook. A missing value raises an error of
    jinja2.
    """
    return _environment().get_template(template).render(values)


def render_page(template: str, scripts: Sequence[str] = (), **values: Any) -> str:
    """A whole page, which opens from the disk, without a network: a template that extends
    base.html. scripts : files of `assets/` that become its one script."""
    from markupsafe import Markup

    style = _asset(_STYLE) + _asset(template.replace(".html", ".css"))
    script = _joined(tuple(scripts))
    policy = (
        f"default-src 'none'; script-src '{_digest(script)}'; style-src '{_digest(style)}'; "
        f"img-src {'data:' if scripts else 'file:'}; base-uri 'none'; form-action 'none'"
    )
    own = {"policy": policy, "style": style, "script": script}
    trusted = {name: Markup(text) for name, text in own.items()}
    return render(template, version=__version__, **trusted, **values)


def load_template(template: str) -> None:
    """Load the template engine and a template beside other work, for a page that is made soon:
    loading takes as long as making a few pages."""
    threading.Thread(target=lambda: _environment().get_template(template)).start()


@functools.cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    return Environment(
        loader=FunctionLoader(_asset),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )


def _visible(value: object) -> object:
    """A value as one line of text with invisible characters escaped; markup of templates as it
    is."""
    return value if hasattr(value, "__html__") else to_one_line(str(value))


@functools.cache
def _asset(name: str) -> str:
    return (files("pdcd.pages") / "assets" / name).read_text(encoding="utf-8")


@functools.cache
def _joined(scripts: tuple[str, ...]) -> str:
    inner = "\n".join(map(_asset, scripts))
    return f'(() => {{\n"use strict";\n{inner}\n}})();\n' if scripts else ""


def _digest(words: str) -> str:
    """The digest by which the page's policy names a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(words.encode("utf-8")).digest()).decode()


def encode_page_json(told: Any) -> str:
    """JSON for a script element: it can neither end nor begin an element; NaN and infinity become
    null. The template marks it as safe."""
    data = encode_json(told, lambda value: value.item()).decode()
    return data.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
