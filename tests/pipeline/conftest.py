"""Fixtures that tests of parameters share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.pipeline.params_file import ParamsFile, load_params_file

if TYPE_CHECKING:
    from pathlib import Path

    from pipeline.param_settings import Load


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def write_and_load(text: str | bytes, *, node: str | None = None) -> ParamsFile:
        path = tmp_path / "params.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_params_file(path, node=node)

    return write_and_load
