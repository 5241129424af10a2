"""The one maker of pages: templates of Jinja in `assets/`, whose values are texts, nothing else.

Clients, operators and devices wrote much of what a page tells: notes, tags, file names, models.
None of it may do anything. So every text is escaped twice over: what cannot be seen is spelled out
(`pdcd.printable`), then comes HTML's own escaping; and the policy of a page lets no script run but
the one whose digest it names, and nothing be fetched but pictures beside it.
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
"""What all pages have; each has another of its own name beside that."""


def render(template: str, **values: Any) -> str:
    """A template of `assets/` with its values, each of which is shown as text.

    Called for parts of pages, such as a run in a notebook. A value that the template wants and
    does not get is an error of jinja2.
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
    """Load the template engine and a template beside other work, for a page that comes soon: they
    take as long as a few pages."""
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
    """A value as text of one line without anything that cannot be seen; markup of templates as it
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
    """As the page's policy names a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(words.encode("utf-8")).digest()).decode()


def encode_page_json(told: Any) -> str:
    """JSON for a script element, which ends no element and begins none; null for what is no
    number. The template marks it as safe."""
    data = encode_json(told, lambda value: value.item()).decode()
    return data.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
