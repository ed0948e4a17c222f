"""Placing through a frame that does not move is tf2's lookup with two times: against its recorded answers."""

from __future__ import annotations

import pytest

from pc2scan.errors import TransformError
from transforms.through import assert_close, found, recorded
from transforms.trees import built


def test_recorded_answers_of_tf2() -> None:
    rows, questions, answers = recorded()
    buffer = built(rows)
    agreed = refused = 0
    for question, theirs in zip(questions, answers, strict=True):
        if theirs is None:
            with pytest.raises(TransformError):
                found(buffer, question)
            refused += 1
        else:
            assert_close(found(buffer, question), theirs, question)
            agreed += 1
    assert (agreed, refused) == (330, 70)
