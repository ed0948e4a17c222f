"""Placing through a frame that does not move is tf2's lookup with two times: against its recorded answers."""

from __future__ import annotations

import numpy as np
import pytest

from pc2scan.core.rigid import rotation_matrices
from pc2scan.errors import TransformError
from tf.through import assert_close, found, recorded
from tf.trees import built


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


def test_transforms_for_points_are_tf2s_too() -> None:
    rows, questions, answers = recorded()
    buffer = built(rows)
    compared = 0
    for question, theirs in zip(questions, answers, strict=True):
        if theirs is None or question.source == question.fixed:
            continue
        stamps, looked_up, _ = buffer.rows(
            question.fixed, question.source, question.source_ns, question.source_ns + 1, 1_000_000, lambda *_: 1 << 60
        )
        assert stamps[0] == question.source_ns
        from_fixed = buffer.lookup(question.target, question.fixed, question.target_ns)
        rotation = from_fixed.matrix @ looked_up[0, :9].reshape(3, 3)
        origin = from_fixed.apply(looked_up[:1, 9:])[0]
        np.testing.assert_allclose(rotation, rotation_matrices(theirs[3:]), rtol=0, atol=1e-9)
        np.testing.assert_allclose(origin, theirs[:3], rtol=0, atol=1e-9)
        compared += 1
    assert compared > 200
