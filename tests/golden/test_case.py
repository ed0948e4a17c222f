from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.compare.rules import Rules
from pc2scan.errors import UsageError
from pc2scan.golden.case import case_folders, load_case

if TYPE_CHECKING:
    from pathlib import Path


def case(folder: Path, *names: str, settings: str | None = None) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()
    if settings is not None:
        (folder / "case.yaml").write_text(settings)
    return folder


def names(folder: Path, pattern: str = "") -> list[str]:
    return [name for name, _ in case_folders(folder, pattern)]


class TestFinding:
    def test_at_any_depth_in_order(self, tmp_path: Path) -> None:
        case(tmp_path / "b" / "two", "input.bag", "params.yaml")
        case(tmp_path / "b" / "one", "input.mcap")
        case(tmp_path / "a", settings="input: ../x.bag")
        case(tmp_path / ".hidden", "input.bag")
        case(tmp_path / "notes", "README.md")
        assert names(tmp_path) == ["a", "b/one", "b/two"]

    def test_a_recording_inside_a_case_is_no_case(self, tmp_path: Path) -> None:
        case(tmp_path / "a" / "input", "metadata.yaml", "input.db3")
        assert names(tmp_path) == ["a"]

    def test_a_case_by_itself(self, tmp_path: Path) -> None:
        assert names(case(tmp_path / "hall", "input.bag")) == ["hall"]

    @pytest.mark.parametrize(
        ("pattern", "found"), [("hall", ["hall", "hall_tf"]), ("hall*f", ["hall_tf"]), ("x", ["x"])]
    )
    def test_patterns(self, pattern: str, found: list[str], tmp_path: Path) -> None:
        for name in ("hall", "hall_tf", "x"):
            case(tmp_path / name, "input.bag")
        assert names(tmp_path, pattern) == found

    def test_a_case_that_lost_its_input_is_still_one(self, tmp_path: Path) -> None:
        case(tmp_path / "a", "expected.txt")
        assert names(tmp_path) == ["a"]

    def test_nothing_to_find(self, tmp_path: Path) -> None:
        with pytest.raises(UsageError, match="does not exist"):
            case_folders(tmp_path / "nowhere")
        with pytest.raises(UsageError, match="has no cases"):
            case_folders(tmp_path)
        case(tmp_path / "a", "input.bag")
        with pytest.raises(UsageError, match="none of its 1 cases has 'b'"):
            case_folders(tmp_path, "b")


class TestLoading:
    def test_what_is_in_the_folder(self, tmp_path: Path) -> None:
        found = load_case(case(tmp_path / "a", "input.bag", "params.yaml", "expected.bag"))
        assert [path.name for path in found.inputs] == ["input.bag"]
        assert found.params == tmp_path / "a" / "params.yaml"
        assert found.expected == found.new_expected() == tmp_path / "a" / "expected.bag"
        assert found.rules == Rules()
        assert (found.arguments, found.exit_status, found.all_topics) == ((), 0, False)

    def test_what_is_not_there_yet(self, tmp_path: Path) -> None:
        found = load_case(case(tmp_path / "a", "input.bag"))
        assert (found.params, found.expected) == (None, None)
        assert found.new_expected().name == "expected.txt"
        everything = load_case(case(tmp_path / "b", "input.bag", settings="all_topics: true"))
        assert everything.new_expected().name == "expected.mcap"

    def test_settings(self, tmp_path: Path) -> None:
        settings = """
input: [../one.bag, ../two.bag]
params: ../params.yaml
arguments: [--topic, "/points:=/scan", --range-cutoff, 25, --static-tf-file, "{case}/mount.yaml"]
exit_status: 3
atol: {x: 1e-6, y: 2.0e-6}
rtol: 1.0e-5
allow_beams: 0.001
ignore: [seq, log_time]
"""
        case(tmp_path, "one.bag", "two.bag", "params.yaml")
        found = load_case(case(tmp_path / "a", settings=settings))
        assert [path.name for path in found.inputs] == ["one.bag", "two.bag"]
        assert found.params == tmp_path / "a" / ".." / "params.yaml"
        assert found.arguments[:4] == ("--topic", "/points:=/scan", "--range-cutoff", "25")
        assert found.arguments[4:] == ("--static-tf-file", f"{tmp_path / 'a'}/mount.yaml")
        assert found.exit_status == 3
        assert found.rules == Rules(
            atol={"x": 1e-6, "y": 2e-6}, rtol={"": 1e-5}, allow_beams=0.001, ignore=frozenset({"seq", "log_time"})
        )

    @pytest.mark.parametrize(
        ("settings", "told"),
        [
            ("tolerance: 1", "unknown key 'tolerance'"),
            ("- 1", "not a mapping"),
            ("a: [", "not valid YAML"),
            ("input: 5", "path or a list"),
            ("input: []", "path or a list"),
            ("input: ../gone.bag", "names ../gone.bag, which does not exist"),
            ("params: gone.yaml", "names gone.yaml, which does not exist"),
            ("params: [a]", "must be a path"),
            ("arguments: --topic /points", "must be a list"),
            ("arguments: [[a]]", "must be a list"),
            ("exit_status: true", "whole number"),
            ("all_topics: 1", "true or false"),
            ("atol: small", "must be a number"),
            ("rtol: {x: small}", "must be a number"),
            ("atol: -1", "at least 0"),
            ("allow_beams: all", "must be a number"),
            ("allow_beams: 7", "share from 0 to 1"),
            ("ignore: everything", "cannot be ignored"),
        ],
    )
    def test_settings_that_cannot_be(self, settings: str, told: str, tmp_path: Path) -> None:
        folder = case(tmp_path / "a", "input.bag", settings=settings)
        with pytest.raises(UsageError, match=told) as caught:
            load_case(folder)
        assert "case.yaml" in str(caught.value)

    def test_what_is_missing_or_there_twice(self, tmp_path: Path) -> None:
        with pytest.raises(UsageError, match="has no input"):
            load_case(case(tmp_path / "a", "params.yaml"))
        with pytest.raises(UsageError, match=r"input.bag and input.mcap"):
            load_case(case(tmp_path / "b", "input.bag", "input.mcap"))
        with pytest.raises(UsageError, match=r"expected.txt and expected.bag"):
            load_case(case(tmp_path / "c", "input.bag", "expected.bag", "expected.txt"))
