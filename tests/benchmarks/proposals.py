"""Print what becomes of the commands that `info` proposes in random worlds, as a table.

Run it with ``python tests/benchmarks/proposals.py 200``, or with ``--seeds 3 17`` to see what was said in some.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.worlds.scenes import outcome, random_world


def main() -> None:
    """Try the worlds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, nargs="+")
    asked = parser.parse_args()
    seeds = asked.seeds or range(asked.first, asked.first + asked.count)
    words: Counter[str] = Counter()
    for seed in seeds:
        name, world = random_world(seed)
        with TemporaryDirectory() as folder:
            found = outcome(world, Path(folder))
        words[found.word] += 1
        sys.stdout.flush()
        sys.stdout.write(f"{found.word:5} {found.right:6.1%} {found.filled:6.1%}  {name}" + "\n")
        if found.word != "right" or asked.seeds:
            sys.stdout.write("        " + found.text.replace("\n", "\n        ") + "\n")
    sys.stdout.write(", ".join(f"{word} {count}" for word, count in words.items()) + "\n")


if __name__ == "__main__":
    main()
