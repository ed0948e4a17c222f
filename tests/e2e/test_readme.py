"""The README and the pages under docs speak the truth about the command, the report and the library."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from functools import cache
from typing import TYPE_CHECKING

import pytest
from ruamel.yaml import YAML

from pc2scan.core.presets import PRESETS
from pc2scan.options.table import PARAMETERS, output_options
from pc2scan.request.filters import FILTERS
from support import ROOT
from support.batches import in_this_process
from support.builders import T0, Item, Recording, Stream, write_rosbag1
from support.clouds import LIVOX, livox_points
from support.clouds import livox as livox_message
from support.command import environment, run
from support.worlds.moving import Lidar, write_world

if TYPE_CHECKING:
    from pathlib import Path

README = (ROOT / "README.md").read_text("utf-8")
DOCS = ROOT / "docs"
#: The pages by their paths under docs, without the suffix.
PAGES = {
    path.relative_to(DOCS).with_suffix("").as_posix(): path.read_text("utf-8") for path in sorted(DOCS.rglob("*.md"))
}
TEXT = "\n".join([README, *PAGES.values()])
COMMANDS = ("convert", "batch", "export", "view", "plot", "map", "check", "info", "tf", "repair", "diff", "golden")

#: Options of other programs that the README names, and pc2scan's own outside its commands.
ELSEWHERE = {
    *("--install-completion", "--version", "--help"),
    *("--clock", "--repeat", "--memory", "--pc2scan-golden", "--pc2scan-update", "--junitxml"),
    *("--qos-profile-overrides-path", "--upgrade-deps"),
}
OPTION = r"(?<![\w-])--[a-z][a-z0-9-]*"


@cache
def help_of(command: str) -> str:
    shown = run(command, "--help").stdout
    return run(command, "--help-all").stdout if "--help-all" in shown else shown


@cache
def options_of(command: str) -> frozenset[str]:
    return frozenset(re.findall(OPTION, help_of(command)))


def code_blocks(language: str, text: str = TEXT) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def commands_in(text: str) -> list[list[str]]:
    """The pc2scan commands of shell code, as words; what follows a pipe or ``||`` is not theirs."""
    found = []
    for line in text.replace("\\\n", " ").splitlines():
        code = line.split(" #")[0].split("||")[0]
        if match := re.search(r"(?:^|\s|/)pc2scan\s+(?=[a-z-])(.*)", code):
            found.append(shlex.split(match[1]))
    return found


def after(text: str, mark: str) -> str:
    """The part of a page from a mark to the next heading."""
    assert mark in text
    return text.partition(mark)[2].partition("\n## ")[0]


def quoted(text: str, pattern: str = r"\w+") -> set[str]:
    """The words in backticks."""
    return set(re.findall(rf"`({pattern})`", text))


# --- names ---


def test_every_option_in_the_docs_exists() -> None:
    known = frozenset().union(*(options_of(command) for command in COMMANDS)) | ELSEWHERE
    # A mention in prose, or in a table, ends at whatever an option cannot contain.
    ours = [text for name, text in PAGES.items() if name != "from-ros"]
    lines = [line for text in (README, *ours) for line in text.splitlines() if "python tests/" not in line]
    mentioned = set(re.findall(OPTION, "\n".join(lines)))
    assert len(mentioned) > 25
    assert mentioned - known == set()


def test_every_command_takes_the_options_shown() -> None:
    shown = [words for block in code_blocks("sh") for words in commands_in(block)]
    shown += [words for line in re.findall(r"`(pc2scan [^`\n]+)`", TEXT) for words in commands_in(line)]
    ours = [words for words in shown if words[0] not in ELSEWHERE]
    assert len(ours) >= 8
    for words in ours:
        assert words[0] in COMMANDS, words
        known = options_of(words[0]) | {"--help", "--ros-args"}
        assert {word.split("=")[0] for word in words if word.startswith("--")} <= known


def test_every_command_parameter_and_preset_is_named() -> None:
    listed = re.findall(r"^  ([a-z]+)  ", run("--help").stdout.partition("Commands:")[2], re.MULTILINE)
    assert set(listed) == set(COMMANDS)
    assert all(f"pc2scan {command}" in README for command in listed)
    rows = set(re.findall(r"`(\w+)`", "\n".join(re.findall(r"^\| (`.*?) \|", TEXT, re.MULTILINE))))
    assert PARAMETERS.keys() <= rows
    assert {parameter.spelling for parameter in PARAMETERS.values()} <= options_of("convert")
    assert all(re.search(rf"\b{consumer}\b", PAGES["slam"]) for consumer in PRESETS)
    assert f"consumer of the scans: {', '.join(PRESETS)}." in " ".join(help_of("convert").split())


def test_every_key_of_an_output_is_named() -> None:
    table = after(PAGES["scans-file"], "## Keys of an output")
    rows = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    filters = {*FILTERS}
    assert quoted("\n".join(rows)) == {"sources", *output_options()} - filters
    listed = set(re.findall(r"^\| `--([a-z-]+) ", PAGES["choosing-points"], re.MULTILINE))
    assert listed >= {name.replace("_", "-") for name in filters}


def test_the_report_has_the_keys_of_its_page(tmp_path: Path) -> None:
    done = run("convert", ROOT / "fixtures" / "hall.bag", "-o", "out.bag", "--report", "report.json", cwd=tmp_path)
    assert done.status == 0
    found = json.loads((tmp_path / "report.json").read_text())
    text = PAGES["report"]
    table = text[text.index("| key | |") :].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    # The count of what is listed stands with the list.
    top = set(re.findall(r"all are in `(\w+)`", table))
    inner: dict[str, set[str]] = {}
    for names, description in rows:
        for name in quoted(names, r"[\w\[\]]+"):
            top.add(name.removesuffix("[]"))
            if name.endswith("[]"):
                # ``points`` (`total`, ...) names the keys of a key; ``action`` (`converted`, ...) its values.
                inner[name[:-2]] = quoted(re.sub(r"\([^)]*\)", "", description))
    assert found.keys() == top
    assert all(topic.keys() == inner["topics"] for topic in found["topics"])
    points = re.search(r"`points` \(([^)]*)\)", table)
    assert points is not None
    assert all(topic["points"].keys() == quoted(points[1]) for topic in found["topics"])
    assert {topic["action"] for topic in found["topics"]} <= {"converted", "passed", "re-encoded", "skipped"}
    # No fixture has a message to skip: the keys of those are what the code says, and the page must name them.
    assert inner["skipped"] >= {"topic", "log_time_ns", "stamp_ns", "reason", "hint"}


# --- commands, in the order of a page, each with what the ones before it wrote ---


@pytest.mark.parametrize(
    ("blocks", "commands", "accepted"),
    [
        (code_blocks("sh", after(PAGES["slam"], "## A recipe for each program")), "", "slam_toolbox gmapping"),
        (code_blocks("sh", after(README, "## From a bag to a map")), "info tf convert check", "slam_toolbox"),
    ],
    ids=["programs", "README"],
)
def test_a_recipe_ends_in_accepted_scans(blocks: list[str], commands: str, accepted: str, tmp_path: Path) -> None:
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "drive.bag")
    typed = [words for block in blocks for words in commands_in(block)]
    assert not commands or [words[0] for words in typed if words[0] in commands.split()] == commands.split()
    assert {words[-1] for words in typed if words[0] == "check"} >= set(accepted.split())
    for words in typed:
        done = run(*words, cwd=tmp_path)
        assert (done.status, done.stderr) == (0, ""), words
        if words[0] == "check":
            assert words[-1] in done.stdout.partition("ok: accepted by ")[2]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the pages call their recordings."""
    folder = tmp_path_factory.mktemp("recordings")
    hall = ROOT / "fixtures" / "hall.bag"
    for name in ("drive.bag", "drive.bag.active", "recordings/drive.bag", "drives/monday.bag"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(hall, folder / name)
    write_world(
        folder / "robot.mcap",
        [Lidar("/front", "front"), Lidar("/rear", "rear", phase=0.037), Lidar("/flat", "flat", kind="flat")],
        seconds=0.5,
    )
    livox = Stream("/livox/lidar", LIVOX[1])
    data = {version: livox_message(livox_points(1), version) for version in (1, 2)}
    write_rosbag1(folder / "livox.bag", Recording((livox,), (Item(livox, T0, data),)))
    # A recording is found by its content.
    (folder / "robot.mcap").rename(folder / "robot.bag")
    options = ("--min-height", "-0.3", "--start", "0.1")
    two = ("--topic", "/points:=/scan", "--topic", "/points:=/scan2")
    for name, further in (
        ("scans.mcap", ("--preset", "slam_toolbox", "--target-frame", "base_link")),
        ("before.bag", two),
        ("after.mcap", two),
    ):
        assert run("convert", hall, "-o", folder / name, *options, *further).status == 0
    (folder / "params.yaml").write_text("pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: -0.3\n")
    (folder / "scans.yaml").write_text(code_blocks("yaml", PAGES["scans-file"])[0])
    shutil.copytree(ROOT / "fixtures" / "golden" / "tf_static", folder / "golden" / "tf_static")
    return folder


#: Words of commands that need what is not here: a store, a cluster, an odometry topic, an IMU.
ABSENT = ("://", "--dask", "/shared/", "--odom-topic", "--imu")
#: The page whose commands make what they read; another test runs it.
APART = {"golden"}


@pytest.mark.parametrize("page", sorted({"README", *PAGES} - APART))
def test_the_shown_commands_run(page: str, recordings: Path, tmp_path: Path) -> None:
    folder = tmp_path / "docs"
    shutil.copytree(recordings, folder)
    (folder / "fixtures").symlink_to(ROOT / "fixtures")
    blocks = code_blocks("sh", README if page == "README" else PAGES[page])
    for words in (words for block in blocks for words in commands_in(block)):
        if any(absent in word for word in words for absent in ABSENT):
            continue
        if "-o" in words:
            written = folder / words[words.index("-o") + 1]
            shutil.rmtree(written, ignore_errors=True)
            written.unlink(missing_ok=True)
        before = set(folder.iterdir())
        with in_this_process():
            done = run(*words, cwd=folder)
        # Not every consumer accepts every scan.
        assert done.status == 0 or (words[0] == "check" and done.status == 1), (words, done.stderr)
        if "-o" not in words:
            for path in set(folder.iterdir()) - before:
                path.unlink()


# --- the library ---


def output_of(block: str, folder: Path) -> list[str]:
    """The lines that a page's example prints."""
    shutil.copytree(ROOT / "fixtures", folder / "fixtures")
    command = [sys.executable, "-W", "error", "-c", block]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment(), check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_example_for_the_library_runs(tmp_path: Path) -> None:
    (block,) = code_blocks("python", PAGES["python"])
    first, *scans, last = output_of(block, tmp_path)
    assert first.startswith("0 [")
    assert "('/points', 4)" in first
    assert [line.split()[:2] for line in scans] == [[f"2023-11-14T22:13:20.{i}00000000", "lidar"] for i in (1, 2, 3, 4)]
    assert last.split() == ["1.0", "2.0", "2"]
    assert (tmp_path / "hall_scans.mcap").exists()


def test_the_python_of_the_readme_runs(tmp_path: Path) -> None:
    (block,) = code_blocks("python", README)
    assert len(output_of(block, tmp_path)) == 5


# --- the pages ---


def test_the_readme_is_short_and_yaml_is_yaml() -> None:
    assert len(README.splitlines()) <= 200
    blocks = code_blocks("yaml")
    assert len(blocks) >= 4
    assert all(YAML(typ="safe").load(block) is not None for block in blocks)


@pytest.mark.parametrize(
    "page", [*sorted(path.name for path in ROOT.glob("*.md")), *(f"docs/{name}.md" for name in PAGES)]
)
def test_links_lead_to_files_and_headings(page: str) -> None:
    path = ROOT / page
    for link in re.findall(r"\]\(([^)\s]+)\)", path.read_text("utf-8")):
        if link.startswith(("https://", "mailto:")):
            continue
        file, _, anchor = link.partition("#")
        target = (path.parent / file).resolve() if file else path
        assert target.exists(), link
        if anchor:
            headings = re.findall(r"^#+ (.*)$", target.read_text("utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^a-z0-9 _-]", "", heading.lower()).replace(" ", "-") for heading in headings}
            assert anchor in anchors, link
