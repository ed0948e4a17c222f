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

from pc2scan import pytest_plugin
from pc2scan.compare.rules import GEOMETRY, IGNORABLE
from pc2scan.core.presets import PRESETS
from pc2scan.golden.case import KEYS
from pc2scan.options.table import PARAMETERS
from support import ROOT
from support.command import environment, run

if TYPE_CHECKING:
    from pathlib import Path

README = (ROOT / "README.md").read_text("utf-8")
PAGES = {path.stem: path.read_text("utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
TEXT = "\n".join([README, *PAGES.values()])
COMMANDS = ("convert", "batch", "export", "view", "plot", "map", "check", "info", "tf", "repair", "diff", "golden")

#: Options of other programs that the README names, and pc2scan's own outside its commands.
ELSEWHERE = {
    *("--install-completion", "--version", "--help"),
    *("--clock", "--repeat", "--memory", "--pc2scan-golden", "--pc2scan-update"),
}


@cache
def help_of(command: str, how: str = "--help") -> str:
    done = run(command, how if "--help-all" in run(command, "--help").stdout else "--help")
    assert done.status == 0, done.stderr
    return done.stdout


@cache
def options_of(command: str) -> frozenset[str]:
    return frozenset(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", help_of(command, "--help-all")))


def code_blocks(language: str, text: str = TEXT) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def commands_in(text: str) -> list[list[str]]:
    """The pc2scan commands of shell code, as words; what follows a pipe or ``||`` is not theirs."""
    joined = text.replace("\\\n", " ")
    found = []
    for line in joined.splitlines():
        code = line.split(" #")[0].split("||")[0]
        if match := re.search(r"(?:^|\s|/)pc2scan\s+(?=[a-z-])(.*)", code):
            found.append(shlex.split(match[1]))
    return found


def test_every_option_in_the_readme_exists() -> None:
    known = frozenset().union(*(options_of(command) for command in COMMANDS)) | ELSEWHERE
    # A mention in prose, or in a table, ends at whatever an option cannot contain.
    ours = [text for name, text in PAGES.items() if name != "from-ros"]
    lines = [line for text in (README, *ours) for line in text.splitlines() if "python tests/" not in line]
    mentioned = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", "\n".join(lines)))
    assert len(mentioned) > 25
    assert mentioned - known == set()


def test_every_command_in_the_readme_takes_the_options_shown() -> None:
    shown = [words for block in code_blocks("sh") for words in commands_in(block)]
    shown += [words for line in re.findall(r"`(pc2scan [^`\n]+)`", TEXT) for words in commands_in(line)]
    assert len(shown) >= 8
    for words in shown:
        if words[0] in ELSEWHERE:
            continue
        assert words[0] in COMMANDS, words
        known = options_of(words[0]) | {"--help", "--ros-args"}
        assert {word.split("=")[0] for word in words if word.startswith("--")} <= known


def test_every_command_is_in_the_readme() -> None:
    done = run("--help")
    assert done.status == 0
    listed = re.findall(r"^  ([a-z]+)  ", done.stdout[done.stdout.index("Commands:") :], re.MULTILINE)
    assert set(listed) == set(COMMANDS)
    for command in listed:
        assert f"pc2scan {command}" in README


def test_every_parameter_is_in_the_readmes_table() -> None:
    rows = set(re.findall(r"`(\w+)`", "\n".join(re.findall(r"^\| (`.*?) \|", TEXT, re.MULTILINE))))
    assert PARAMETERS.keys() <= rows
    assert all(parameter.spelling in options_of("convert") for parameter in PARAMETERS.values())


def test_every_preset_is_in_the_readme_and_the_help() -> None:
    section = PAGES["slam"]
    help_text = " ".join(help_of("convert").split())
    for consumer in PRESETS:
        assert re.search(rf"\b{consumer}\b", section)
    assert f"consumer of the scans: {', '.join(PRESETS)}." in help_text


def test_the_dataset_recipe_ends_in_scans_that_are_accepted(tmp_path: Path) -> None:
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "drive.bag")
    block = PAGES["slam"].partition("<!-- dataset recipe -->")[2].split("```")[1].removeprefix("sh\n")
    commands = commands_in(block)
    assert [words[0] for words in commands] == ["info", "tf", "convert", "check"]
    for words in commands:
        done = run(*words, cwd=tmp_path)
        assert (done.status, done.stderr) == (0, ""), words
    assert "ok: accepted by slam_toolbox" in done.stdout


def test_the_recipe_of_each_program_makes_what_it_accepts(tmp_path: Path) -> None:
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "drive.bag")
    section = PAGES["slam"].partition("## A recipe for each program")[2].partition("\n## ")[0]
    commands = [words for block in code_blocks("sh", section) for words in commands_in(block)]
    assert {words[-1] for words in commands if words[0] == "check"} >= {
        "slam_toolbox",
        "cartographer",
        "gmapping",
        "mrpt",
    }
    for words in commands:
        done = run(*words, cwd=tmp_path)
        assert (done.status, done.stderr) == (0, ""), words


@pytest.mark.parametrize("page", ["README", "tutorial"])
def test_from_a_bag_to_a_map(page: str, tmp_path: Path) -> None:
    """All commands of the way, each with what the ones before it wrote."""
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "drive.bag")
    text = PAGES.get(page) or README.partition("## From a bag to a map")[2].partition("\n## ")[0]
    commands = [words for block in code_blocks("sh", text) for words in commands_in(block)]
    assert [words[0] for words in commands if words[0] in {"info", "convert", "check"}] == ["info", "convert", "check"]
    for words in commands:
        done = run(*words, cwd=tmp_path)
        assert (done.status, done.stderr) == (0, ""), words
    assert "ok: accepted by slam_toolbox" in done.stdout


def test_exit_statuses_are_told_alike() -> None:
    help_text = run("--help").stdout
    report = PAGES["report"]
    table = report[report.index("| status | `convert`") :].split("\n\n")[0]
    told = re.findall(r"^\| (\d) \|", table, re.MULTILINE)
    assert told == ["0", "1", "2", "3", "4"]
    for status in told:
        assert re.search(rf"\b{status}\b", help_text[help_text.index("Exit status") :])


def test_the_report_has_the_keys_of_the_readme(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    done = run("convert", ROOT / "fixtures" / "hall.bag", "-o", tmp_path / "out.bag", "--report", report)
    assert done.status == 0, done.stderr
    found = json.loads(report.read_text())
    text = PAGES["report"]
    table = text[text.index("| key | |") :].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    # The count of what is listed stands with the list.
    top = set(re.findall(r"all are in `(\w+)`", table))
    inner: dict[str, set[str]] = {}
    for names, description in rows:
        for name in re.findall(r"`([\w\[\]]+)`", names):
            top.add(name.removesuffix("[]"))
            if name.endswith("[]"):
                # ``points`` (`total`, ...) names the keys of a key; ``action`` (`converted`, ...) its values.
                outer = re.sub(r"\([^)]*\)", "", description)
                inner[name[:-2]] = set(re.findall(r"`(\w+)`", outer))
    assert found.keys() == top
    assert all(topic.keys() == inner["topics"] for topic in found["topics"])
    points = re.search(r"`points` \(([^)]*)\)", table)
    assert points is not None
    assert all(topic["points"].keys() == set(re.findall(r"`(\w+)`", points[1])) for topic in found["topics"])
    assert {topic["action"] for topic in found["topics"]} <= {"converted", "passed", "re-encoded", "skipped"}
    # No fixture has a message to skip: the keys of those are what the code says, and the README must name them.
    assert inner["skipped"] >= {"topic", "log_time_ns", "stamp_ns", "reason", "hint"}


def test_the_example_for_the_library_runs(tmp_path: Path) -> None:
    (block,) = code_blocks("python", PAGES["python"])
    shutil.copytree(ROOT / "fixtures", tmp_path / "fixtures")
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", block],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment(),
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    first, *scans, last = done.stdout.splitlines()
    assert first.startswith("0 [")
    assert "('/points', 4)" in first
    assert [line.split()[:2] for line in scans] == [[f"2023-11-14T22:13:20.{i}00000000", "lidar"] for i in (1, 2, 3, 4)]
    assert last.split() == ["1.0", "2.0", "2"]
    assert (tmp_path / "hall_scans.mcap").exists()


@pytest.mark.parametrize("fixture", ["hall.bag", "hall.mcap", "hall"])
def test_the_first_command_works_on_every_fixture(fixture: str, tmp_path: Path) -> None:
    (line,) = [line for line in code_blocks("sh", README) if "fixtures/hall.bag" in line]
    (words,) = commands_in(line)
    words[words.index("fixtures/hall.bag")] = str(ROOT / "fixtures" / fixture)
    done = run(*words, cwd=tmp_path)
    assert done.status == 0, done.stderr
    assert (tmp_path / "scans.mcap").exists()
    assert done.stderr == ""


def test_the_shown_commands_run_on_a_recording(tmp_path: Path) -> None:
    ran = 0
    for number, block in enumerate(code_blocks("sh")):
        folder = tmp_path / str(number)
        folder.mkdir()
        shutil.copy(ROOT / "fixtures" / "hall.bag", folder / "drive.bag")
        (folder / "params.yaml").write_text("pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: -0.3\n")
        for words in commands_in(block):
            if "drive.bag" in words:
                done = run(*words, cwd=folder)
                assert done.status == 0, (words, done.stderr)
                ran += 1
                (folder / "drive_scan.bag").unlink(missing_ok=True)
    assert ran >= 6


def test_the_recipe_for_ci_works_from_start_to_finish(tmp_path: Path) -> None:
    """Its commands, then those of the workflow, then a change that it is there to find."""
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "drive.bag")
    params = "pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: -0.3\n"
    (tmp_path / "params.yaml").write_text(params)
    block = PAGES["golden"].partition("<!-- golden commands -->")[2].split("```")[1].removeprefix("sh\n")
    workflow, *_ = code_blocks("yaml", PAGES["golden"])
    steps = YAML(typ="safe").load(workflow)["jobs"]["golden"]["steps"]
    in_ci = [step["run"] for step in steps if step.get("run", "").startswith("pc2scan")]
    uploaded = [step["with"]["path"] for step in steps if "upload-artifact" in step.get("uses", "")]
    commands = [*block.splitlines(), *in_ci]
    assert len(commands) == 6
    for command in commands:
        words = shlex.split(command)
        if words[0] == "pc2scan":
            done = run(*words[1:], cwd=tmp_path)
            assert done.status == 0, (command, done)
        else:
            subprocess.run(words, cwd=tmp_path, check=True)
    assert [(tmp_path / path).is_file() for path in uploaded] == [True]
    (tmp_path / "golden" / "drive" / "params.yaml").write_text(params.replace("-0.3", "-0.2"))
    (words,) = commands_in(in_ci[0])
    assert run(*words, cwd=tmp_path).status == 1


def row_of(name: str) -> str:
    (row,) = [line for line in TEXT.splitlines() if line.startswith(f"| `{name}`")]
    return row


def test_what_is_said_of_diff_and_golden() -> None:
    named = set(re.findall(r"`(\w+)`", row_of("--ignore NAME")))
    # Of the geometry one name stands for all.
    assert named == IGNORABLE.keys() - {*GEOMETRY} | {"angle_max"}
    assert set(re.findall(r"`(\w+)`", row_of("case.yaml"))) - {"convert", "diff"} == set(KEYS)
    report = json.loads(run("diff", ROOT / "fixtures" / "hall.bag", ROOT / "fixtures" / "hall.mcap", "--json").stdout)
    told = PAGES["diff"].partition("`--json` prints")[2].partition("Exit status")[0]
    keys = set(re.findall(r"`(\w+)(?:\[\])?`", told))
    assert keys <= {*report, *report["topics"][0]}
    assert keys > {"same", "exit_status", "topics", "values", "worst"}


def test_the_fixtures_for_pytest_are_those_of_the_plugin() -> None:
    (block,) = code_blocks("python", PAGES["golden"])
    compile(block, "golden.md", "exec")
    asked = re.search(r"def test_\w+\((.*)\)", block)
    assert asked is not None
    assert set(asked[1].split(", ")) == set(pytest_plugin.__all__)


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= 200


def test_the_readmes_python_runs(tmp_path: Path) -> None:
    (block,) = code_blocks("python", README)
    shutil.copytree(ROOT / "fixtures", tmp_path / "fixtures")
    command = [sys.executable, "-W", "error", "-c", block]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment(), check=False)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 5


@pytest.mark.parametrize(
    "page",
    [
        "README",
        "DESIGN",
        "SECURITY",
        "CHANGELOG",
        "CONTRIBUTING",
        "CODE_OF_CONDUCT",
        *(f"docs/{name}" for name in PAGES),
    ],
)
def test_links_lead_somewhere(page: str) -> None:
    """To files that are there, and to headings of theirs."""
    path = ROOT / f"{page}.md"
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


def test_yaml_in_the_docs_is_yaml() -> None:
    blocks = code_blocks("yaml")
    assert len(blocks) >= 4
    for block in blocks:
        assert YAML(typ="safe").load(block) is not None
