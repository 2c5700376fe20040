"""The page: template, style and scripts in one file with a strict content security policy."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from importlib import resources

from usdskin import __version__
from usdskin.judge.report.markup import Markup, element, fragment

__all__ = ["content_security_policy", "page"]

_SCRIPTS = ("unpack.js", "wipe.js", "probe.js", "copy.js")
_SLOT = re.compile(r"\{\{([a-z]+)\}\}")


def content_security_policy(style: str, script: str) -> str:
    """Return a policy by which nothing loads, and nothing runs but one style and one script.

    Args:
        style: Text of the style element.
        script: Text of the script element.
    """
    return (
        f"default-src 'none'; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def page(
    title: str, verdict: tuple[str, str], sections: Sequence[Markup], data: Markup | None
) -> str:
    """Return the whole page.

    Args:
        title: What was proved.
        verdict: The headline and its class.
        sections: In order.
        data: What the scripts read.
    """
    style = _package_text("style.css")
    script = _wrapped("\n".join(_package_text(name) for name in _SCRIPTS))
    said, kind = verdict
    slots: Mapping[str, str] = {
        "policy": element(
            "meta", http_equiv="Content-Security-Policy",
            content=content_security_policy(style, script),
        ),
        "title": fragment(title),
        "verdict": element("p", said, class_=f"verdict {kind}"),
        "contents": _contents(sections),
        "sections": fragment(*sections),
        "version": fragment(__version__),
        "data": data or Markup(""),
        "style": style,
        "script": script,
    }  # fmt: skip
    # One pass: what is filled in is never looked at again.
    return _SLOT.sub(lambda slot: slots[slot.group(1)], _package_text("template.html"))


def _wrapped(script: str) -> str:
    return f'(() => {{\n"use strict";\n{script}}})();'


def _package_text(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text("utf-8")


def _contents(sections: Sequence[Markup]) -> Markup:
    """Return links to the sections, by their ids and headings, which are ours."""
    found = [re.match(r'<section id="([a-z]+)"[^>]*><h2[^>]*>([^<]*)<', text) for text in sections]
    found += [
        re.match(r'<section aria-labelledby="[a-z-]+" id="([a-z]+)"[^>]*><h2[^>]*>([^<]*)<', text)
        for text in sections
    ]
    links = [
        element("a", Markup(match.group(2)), href=f"#{match.group(1)}")
        for match in found
        if match is not None
    ]
    return fragment(*links)
