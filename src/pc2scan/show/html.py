"""Builds one HTML file from the page's script, its style and its data; it loads nothing else.

A page that is opened from the disk cannot load modules. So the modules of ``page/`` become one script, in which each
module is a function that returns its exports, called once, after the modules that it imports.

A recording is untrusted. So its data are never part of the markup or the script, only JSON in which ``<`` is escaped,
and base64. The page's content security policy allows this script and this style by their digests, and no requests.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from collections.abc import Mapping
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import UsageError, visible

if TYPE_CHECKING:
    from collections.abc import Iterator
    from importlib.resources.abc import Traversable
    from pathlib import Path

    from numpy.typing import NDArray

#: The first bytes of every page; a file that begins like this may be replaced by another page.
BEGINNING = b"<!doctype html>\n<!-- pc2scan view -->\n"

_IMPORT = re.compile(r'^import (?P<names>\{[^}]*\}) from "\./(?P<module>\w+)\.mjs";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|const|let|class) (?P<name>\w+))", re.MULTILINE)

#: The level of compression; higher ones take longer and gain almost nothing for measured values.
_LEVEL = 6


def check_page_name(path: Path) -> None:
    """Raise if browsers would not open a file of this name as a page.

    Raises
    ------
    UsageError
        If the suffix is not that of HTML.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise UsageError("is not the name of a page", path=path, hint="pages are *.html; pc2scan plot draws figures")


def html(description: Mapping[str, Any], blobs: dict[str, bytes]) -> str:
    """Return the page.

    Parameters
    ----------
    description
        The data that `page/main.mjs` reads as JSON.
    blobs
        Binary data by the ids that the description uses; emptied, because they take as much memory as the page.
    """
    code, css = script(), style()
    policy = "; ".join(
        (
            "default-src 'none'",
            f"script-src {_digest(code)}",
            f"style-src {_digest(css)}",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    parts = {
        'content="policy"': [f'content="{policy}"'],
        "<!-- style -->": [f"<style>{css}</style>"],
        "<!-- script -->": [f"<script>{code}</script>"],
        "<!-- data -->": _data(description, blobs),
    }
    pieces = re.split(f"({'|'.join(map(re.escape, parts))})", (_folder() / "index.html").read_text("utf-8"))
    return "".join(text for piece in pieces for text in parts.get(piece, [piece]))


def script() -> str:
    """Return the modules of the page as one script."""
    modules: dict[str, str] = {}
    _collect("main", modules)
    return '"use strict";\n' + "".join(modules.values())


def style() -> str:
    """Return the style sheet of the page."""
    return (_folder() / "style.css").read_text("utf-8")


def _collect(name: str, modules: dict[str, str]) -> None:
    """Add a module after those that it imports."""
    if name in modules:
        return
    text = (_folder() / f"{name}.mjs").read_text("utf-8")
    for match in _IMPORT.finditer(text):
        _collect(match["module"], modules)
    exports = ", ".join(match["name"] for match in _EXPORT.finditer(text))
    body = _EXPORT.sub("", _IMPORT.sub(r"const \g<names> = module_\g<module>;", text))
    modules[name] = f"const module_{name} = (() => {{\n{body}return {{ {exports} }};\n}})();\n"


def _data(description: Mapping[str, Any], blobs: dict[str, bytes]) -> Iterator[str]:
    text = json.dumps(_visible(description), allow_nan=False, ensure_ascii=True).replace("<", "\\u003c")
    yield f'<script type="application/json" id="recording">{text}</script>'
    for name in list(blobs):
        yield f'\n<script type="text/plain" id="{name}">{base64.b64encode(blobs.pop(name)).decode()}</script>'


def _visible(value: Any) -> Any:
    """Return JSON's types with all names as safe text: browsers obey marks of direction."""
    if isinstance(value, str):
        return visible(value, None)
    if isinstance(value, Mapping):
        return {visible(key, None): _visible(each) for key, each in value.items()}
    return [_visible(each) for each in value] if isinstance(value, list | tuple) else value


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _folder() -> Traversable:
    return files("pc2scan.show") / "page"


def compressed(blobs: dict[str, bytes], columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Add compressed arrays of one length to the blobs of a page, and return its description of them.

    The first bytes of all values of a field come first, then their second bytes, and so on. Exponents and leading
    digits are similar, so measured floats compress a quarter better like this.
    """
    name, compressor = f"data-{len(blobs)}", zlib.compressobj(_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
    parts = []
    for column in columns.values():
        values = np.ascontiguousarray(column, column.dtype.newbyteorder("<"))
        parts.append(compressor.compress(values.view(np.uint8).reshape(-1, values.itemsize).T.tobytes()))
    blobs[name] = b"".join((*parts, compressor.flush()))
    fields = [{"name": field, "type": column.dtype.str[1:]} for field, column in columns.items()]
    return {"id": name, "length": len(next(iter(columns.values()))), "fields": fields}
