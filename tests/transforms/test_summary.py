"""What is known of frames, for people."""

from __future__ import annotations

from pc2scan.transforms.summary import FrameInfo, Tree
from transforms.small_buffers import SECOND, at, built, row


class TestInfos:
    def test_dynamic_static_and_changing_frames(self) -> None:
        buffer = built(
            [row("odom", "base", second) for second in (0, 1, 2, 5, 6, 6)]
            + [row("odom", "cart", 3), row("base", "cart", 1), row("base", "cart", 2)],
            [row("base", "lidar", 4), row("base", "lidar", 9)],
        )
        base, cart, lidar = buffer.infos
        assert base == FrameInfo(
            child="base",
            parents=("odom",),
            static=False,
            transforms=5,
            received=6,
            first_ns=at(0),
            last_ns=at(6),
            rate_hz=4 * 1e9 / (6 * SECOND),
            largest_gap_ns=3 * SECOND,
            largest_gap_at_ns=at(2),
        )
        assert (cart.parents, cart.transforms) == (("base", "odom"), 3)
        assert (lidar.static, lidar.transforms, lidar.received, lidar.first_ns) == (True, 1, 2, at(9))
        assert (lidar.rate_hz, lidar.largest_gap_ns, lidar.largest_gap_at_ns) == (None, None, None)

    def test_trees(self) -> None:
        buffer = built(
            [row("map", "base", 0), row("odom", "base", 1), row("x", "y", 0), row("y", "x", 0)],
            [row("base", "lidar", 0), row("world", "camera", 0)],
        )
        assert buffer.trees == (
            Tree(roots=("map", "odom"), frames=("base", "lidar", "map", "odom")),
            Tree(roots=("world",), frames=("camera", "world")),
            Tree(roots=(), frames=("x", "y")),
        )

    def test_nothing(self) -> None:
        buffer = built()
        assert (buffer.infos, buffer.trees, buffer.frames, len(buffer)) == ((), (), (), 0)
