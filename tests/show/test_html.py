"""The page as a file: nothing of a recording is markup, and nothing runs that is not its own."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pc2scan.show.html import compress, decompress, description_of, html, script, style

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\u2028\u202e"


def test_text_of_a_recording_is_never_markup() -> None:
    page = html({"title": HOSTILE}, {"cloud-0": b"\x00</script>"})
    assert "alert" not in page.replace("\\u003c", "<")[: page.index('id="recording"')]
    held = re.search(r'<script type="application/json" id="recording">(.*?)</script>', page, re.DOTALL)
    assert held is not None
    # Browsers obey marks of direction.
    assert json.loads(held[1]) == {"title": HOSTILE[:-2] + r"\u2028\u202e"}
    assert "<" not in held[1]
    # The script, the description, the blob: no further element was opened.
    assert page.count("<script") == 3


def test_the_policy_allows_the_one_script_and_the_one_style() -> None:
    page = html({}, {})
    for text, kind in ((script(), "script"), (style(), "style")):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in page
        assert f"<{kind}>{text}</{kind}>" in page
    assert "default-src 'none'" in page
    assert "unsafe" not in page


@given(st.integers(0, 50).flatmap(lambda n: st.tuples(arrays("<f4", n), arrays("u1", n), arrays("<f8", n))))
def test_bytes_sorted_by_place_can_be_put_together(columns: tuple[Any, ...]) -> None:
    named = dict(zip(("x", "ring", "time"), columns, strict=True))
    description = description_of("cloud-0", named)
    found = decompress(compress(named), description)
    assert {name: column.tobytes() for name, column in found.items()} == {k: v.tobytes() for k, v in named.items()}
