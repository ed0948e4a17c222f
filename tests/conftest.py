"""Settings of every test."""

from __future__ import annotations

import os

from hypothesis import settings

# Time says nothing on a shared machine; and what fails in CI should fail again where it is looked into.
settings.register_profile("pc2scan", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("pc2scan")
