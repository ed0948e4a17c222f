"""Calls with right and wrong types, for mypy: it reports a wrong one that it accepts, too (an unused ignore)."""

from datetime import datetime, timezone
from pathlib import Path

import pc2scan


def right() -> None:
    pc2scan.convert("a", min_height=1, max_height="50cm")
    pc2scan.convert("a", "b.mcap", target_frame="base_link", angle_min="-90deg", scan_time="auto")
    pc2scan.convert(["a", Path("b")], topics=["/points:=/scan"], keep="/tf*", start=datetime.now(timezone.utc))
    pc2scan.convert("a", where=["ring < 8"], static_tf=pc2scan.StaticTransform.parse("a b 0 0 0 0 0 0"))
    pc2scan.batch("a/", "b/", min_height=0.1, jobs=2, dask=True, format="npz", pose_frame="odom")
    pc2scan.view("a", clouds=3, at=["1", 2.5], reduce="median").save("page.html")
    pc2scan.check("a", consumers=["nav2"], tf_from="b")
    pc2scan.diff("a", "b", rtol=1e-5, atol={"ranges": 1e-3}, ignore=["seq"])


def wrong() -> None:
    pc2scan.scans("a", reduce="kth")  # type: ignore[arg-type]
    pc2scan.convert("a", min_hieght=1)  # type: ignore[call-arg]
    pc2scan.convert("a", min_height=["x"])  # type: ignore[arg-type]
    pc2scan.convert("a", overwrite="no")  # type: ignore[arg-type]
    pc2scan.map("a", "map.yaml")  # type: ignore[call-arg, arg-type]
    pc2scan.info("a", min_height=1)  # type: ignore[call-arg]
    pc2scan.convert(5)  # type: ignore[arg-type]
    _ = pc2scan.convert("a").nothing  # type: ignore[attr-defined]
