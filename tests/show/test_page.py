"""The page as a file: nothing of a recording is markup, and nothing runs that is not its own."""

from __future__ import annotations

import base64
import hashlib
import json
import re

from pc2scan.show.view import html, script, style

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\u2028\u202e"


def test_text_of_a_recording_is_never_markup() -> None:
    page = b"".join(html({"title": HOSTILE}, {"cloud-0": b"\x00</script>"})).decode()
    assert "alert" not in page.replace("\\u003c", "<")[: page.index('id="recording"')]
    held = re.search(r'<script type="application/json" id="recording">(.*?)</script>', page, re.DOTALL)
    assert held is not None
    # Browsers obey marks of direction.
    assert json.loads(held[1]) == {"title": HOSTILE[:-2] + r"\u2028\u202e"}
    assert "<" not in held[1]
    # The script, the description, the blob: no further element was opened.
    assert page.count("<script") == 3


def test_the_policy_allows_the_one_script_and_the_one_style() -> None:
    page = b"".join(html({}, {})).decode()
    for text, kind in ((script(), "script"), (style(), "style")):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in page
        assert f"<{kind}>{text}</{kind}>" in page
    assert "default-src 'none'" in page
    assert "unsafe" not in page
