"""Record tf2's answers for ``tests/transforms/test_through.py``: ``python tests/parity/record_through.py ORACLE``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from parity.debian import ask, pose_in, through_command
from transforms.through import random_drive, random_throughs, save

if __name__ == "__main__":
    rng = np.random.default_rng(6000)
    rows, frames = random_drive(rng, samples=25)
    questions = random_throughs(rng, frames, 400)
    answers = ask(Path(sys.argv[1]), rows, [through_command(question) for question in questions])
    save(rows, questions, [pose_in(answer) for answer in answers])
