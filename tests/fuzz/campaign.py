"""Mutants of sound recordings, each repaired or converted, and compared message by message with the sound one.

By hand, for as many as one likes (3,000 take some minutes)::

    PYTHONPATH=src:tests python tests/fuzz/campaign.py --count 3000 --seed 1

What may become of a mutant: the same as of the sound recording; something else, and the damage is reported (exit status
3); an error; or something else without a word, if nothing in the mutant contradicts itself (`contradictions` decides).
Everything else is a finding: a difference without a word, a traceback, a run without an end, memory without bound, a
source that was changed, an output that cannot be read, fewer messages than another reader finds, or the claim that
nothing is lost where something is.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fuzz.judge import Finding, Outcome, attempt, by_command, mutant_of, rearranged_of
from fuzz.mutants.seeds import make_seeds, place

if TYPE_CHECKING:
    from fuzz.judge import Operation
    from fuzz.mutants.mutate import Mutant


def main() -> None:
    """Run the campaign and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--only", default="", help="of seeds whose names contain this")
    parser.add_argument("--records", action="store_true", help="only whole records that are removed, repeated or moved")
    parser.add_argument("--command-every", type=int, default=50, help="every so many through the real command too")
    parser.add_argument("--keep", type=Path, help="folder for the files of findings")
    parser.add_argument("--json", type=Path, help="write the table here")
    arguments = parser.parse_args()
    warnings.simplefilter("error")
    seeds = [seed for seed in make_seeds() if arguments.only in seed.name]
    table: Counter[tuple[str, str, str]] = Counter()
    slowest = (0.0, "")
    began, findings, commands = time.monotonic(), 0, 0
    with tempfile.TemporaryDirectory(prefix="pc2scan-campaign-") as name:
        for number in range(arguments.seed, arguments.seed + arguments.count):
            folder = Path(name, str(number))
            folder.mkdir()
            made, operation = (rearranged_of if arguments.records else mutant_of)(number, seeds)
            start = time.monotonic()
            try:
                outcome = attempt(made, operation, folder)
                if number % arguments.command_every == 0:
                    (folder / "again").mkdir()
                    _compare_status(outcome, by_command(made, operation, folder / "again"))
                    commands += 1
            except BaseException as err:
                if isinstance(err, KeyboardInterrupt):
                    raise
                findings += 1
                _tell(number, made, operation, err, arguments.keep)
                table[made.seed.name, made.edit.role, "finding"] += 1
            else:
                table[made.seed.name, made.edit.role, outcome] += 1
            slowest = max(slowest, (time.monotonic() - start, f"{number}: {made}"))
            shutil.rmtree(folder)
    seconds = time.monotonic() - began
    _print(table, lambda key: _family(key[0]))
    _print(table, lambda key: key[1])
    sys.stdout.write(
        f"{arguments.count} mutants from number {arguments.seed} on in {seconds:.0f} s, {commands} of them through the "
        f"real command too, the slowest {slowest[0]:.1f} s ({slowest[1]}); {findings} findings\n"
    )
    if arguments.json:
        arguments.json.write_text(json.dumps([[*key, number] for key, number in sorted(table.items())]))


def _compare_status(outcome: Outcome, status: int) -> None:
    expected = {Outcome.refused: (1, 2), Outcome.reported: (3,), Outcome.identical_reported: (3,)}.get(outcome, (0,))
    if status not in expected:
        raise Finding(f"the command ends with {status}, in this process it was: {outcome}")


def _tell(number: int, made: Mutant, operation: Operation, err: BaseException, keep: Path | None) -> None:
    text = str(err) if isinstance(err, Finding) else traceback.format_exc()
    sys.stdout.write(f"{number}: {made}: {operation.name}: {text}\n")
    sys.stdout.flush()
    if keep is not None:
        place(made.files, made.seed.opened, keep / str(number))


def _family(name: str) -> str:
    if name.startswith(("rosbag2", "db3")):
        return "-".join(name.split("-")[:2])
    return name.split("-", 1)[0]


def _print(table: Counter[tuple[str, str, str]], group: Any) -> None:
    rows: dict[str, Counter[str]] = {}
    for key, number in table.items():
        rows.setdefault(group(key), Counter())[key[2]] += number
    columns = [*Outcome, "finding"]
    sys.stdout.write(" | ".join(["", *columns, "all"]) + "\n")
    for name, row in sorted(rows.items()):
        cells = [str(row[column]) for column in columns]
        sys.stdout.write(" | ".join([name, *cells, str(row.total())]) + "\n")
    sys.stdout.write("\n")


if __name__ == "__main__":
    main()
