"""Observers get what they would get by readings of their own, and share one."""

from __future__ import annotations

import random
from contextlib import closing
from itertools import islice
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.observers import Observer, observe
from pc2scan.bags.opening import open_recording
from support.builders import CONTENT, SOURCES

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.model import RawMessage


def row(message: RawMessage) -> tuple[str, int, bytes]:
    return message.connection.topic, message.log_time_ns, bytes(message.data)


@pytest.mark.parametrize("name", SOURCES)
def test_each_observer_sees_the_first_messages_of_its_own(name: str, tmp_path: Path) -> None:
    chance = random.Random(1)
    with closing(open_recording(SOURCES[name](tmp_path, CONTENT))) as reader:
        times = [message.log_time_ns for message in reader.messages()]
        observers = []
        for _ in range(30):
            chosen = chance.sample(list(reader.connections), chance.randint(1, len(reader.connections)))
            cut = sorted(chance.choices(times, k=2)) if chance.random() < 0.5 else (None, None)
            observers.append(Observer(chosen, row, chance.choice([1, 2, 3, 7, None]), *cut))
        observe((reader, observers))
        for each in observers:
            alone = reader.messages(each.connections, each.start_ns, each.stop_ns)
            assert each.values == list(map(row, islice(alone, each.most)))
            assert each.is_done
