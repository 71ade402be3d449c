"""The published number beside ours, and whether it is met."""

from __future__ import annotations

from typing import Any

Row = dict[str, Any]


def row(name: str, what: str, published: str, ours: str, met: bool | None) -> Row:
    """A line of the table, printed at once; `met` is None where nothing is asked."""
    mark = {True: "yes", False: "no", None: "-"}[met]
    print(f"{name:6} {what:44} {published:44} {ours:58} {mark}", flush=True)
    return {"id": name, "what": what, "published": published, "ours": ours, "met": mark}
