"""Recordings that are cut, flipped and rearranged, each read, repaired, converted, and compared with other readers.

By hand, for as many as one likes (3,000 take some minutes)::

    PYTHONPATH=src:tests python tests/fuzz/campaign.py --count 3000 --seed 1

A mutant is read as the sound recording is, its damage is reported (exit status 3), or it is refused with an error. What
no count, no index and no checksum covers cannot be known: another value, in as many messages as before, and an MCAP
chunk whose opcode becomes a private record's. Everything else is a finding: fewer messages without a word, or than mcap
or rosbags find; a traceback, a run without an end, memory without bound, a source that was changed, an output that
cannot be read. `tests/e2e/test_recovery.py` compares with Debian's rosbag.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from fuzz.judge import OUTCOMES, attempt
from fuzz.mutants import damaged, rearranged
from fuzz.seeds import make_seeds, place
from support.bounded import Hang

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fuzz.mutants import Mutant
    from fuzz.seeds import Seed


def mutant_of(number: int, seeds: Sequence[Seed]) -> Mutant:
    """The mutant of a number: the same every time."""
    rng = random.Random(number)
    seed = rng.choice(seeds)
    return (rearranged if seed.opened.endswith((".bag", ".mcap")) and number % 3 == 0 else damaged)(seed, rng)


def main() -> None:
    """Run the campaign and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--keep", type=Path, help="folder for the files of findings")
    arguments = parser.parse_args()
    warnings.simplefilter("error")
    seeds = make_seeds()
    table: dict[str, Counter[str]] = {seed.name: Counter() for seed in seeds}
    for number in range(arguments.seed, arguments.seed + arguments.count):
        made = mutant_of(number, seeds)
        with tempfile.TemporaryDirectory(prefix="pc2scan-campaign-") as folder:
            try:
                outcome: str = attempt(made, Path(folder))
            except (Exception, Hang):  # noqa: BLE001 - whatever it is
                outcome = "finding"
                sys.stdout.write(f"{number}: {made}: {traceback.format_exc(limit=-3)}\n")
                if arguments.keep is not None:
                    place(made.files, made.seed.opened, arguments.keep / str(number))
        table[made.seed.name][outcome] += 1
    columns = [*OUTCOMES, "finding"]
    sys.stdout.write(" | ".join(["", *columns]) + "\n")
    for name, row in table.items():
        sys.stdout.write(" | ".join([name, *(str(row[column]) for column in columns)]) + "\n")


if __name__ == "__main__":
    main()
