"""Tables of a guide in docs, from what its experiments wrote: each stands where a comment names it."""

from __future__ import annotations

import argparse
import csv
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

DOCS = Path(__file__).parents[1] / "docs"
TABLES = DOCS / "tables"

Line = dict[str, Any]


class Guide(NamedTuple):
    """A guide's file, the tables that its experiments wrote, by the name in docs/tables to the name there,
    and what makes Markdown of them by the name in its comment."""

    path: Path
    written: Mapping[str, str]
    make: Callable[[Mapping[str, list[Line]]], dict[str, str]]

    def blocks(self) -> dict[str, str]:
        """Each table of the guide by the name in its comment."""
        return self.make({name: lines(TABLES / f"{name}.csv") for name in self.written})


def lines(path: Path) -> list[Line]:
    """Rows of a table, numbers as numbers."""

    def value(text: str) -> Any:
        try:
            return float(text)
        except ValueError:
            return text

    with path.open(encoding="utf-8", newline="") as file:
        return [{key: value(x) for key, x in row.items()} for row in csv.DictReader(file)]


def against(found: Sequence[Line], ids: Sequence[str] = ()) -> str:
    """The published number beside ours; those with such ids, or all."""
    rows = ["| | | published or wanted | here | met |", "|---|---|---|---|---|"]
    for x in found:
        if not ids or x["id"] in ids:
            rows.append(f"| {x['id']} | {x['what'].strip()} | {x['published']} | {x['ours']} | {x['met']} |")
    return "\n".join(rows)


def with_blocks(text: str, made: Mapping[str, str]) -> str:
    """The guide with its tables written anew."""
    for name, table in made.items():
        mark = re.compile(rf"(<!-- {name} -->\n\n).*?(\n\n<!-- end -->)", re.S)
        text, count = mark.subn(lambda m, table=table: m[1] + table + m[2], text)  # type: ignore[misc]
        if count != 1:
            raise ValueError(f"the guide needs one comment <!-- {name} --> with its <!-- end -->")
    return text


def write(about: str | None, guide: Guide) -> None:
    """The command line: copies the tables of the folders that are named to docs/tables, parts of one table
    joined, and writes them into the guide."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="where the parts were written")
    args = parser.parse_args()
    TABLES.mkdir(exist_ok=True)
    for name, own in guide.written.items():
        parts = [path for folder in args.folders if (path := folder / f"{own}.csv").exists()]
        texts = [path.read_text(encoding="utf-8").splitlines() for path in parts]
        if texts:
            whole = list(dict.fromkeys([texts[0][0], *(line for text in texts for line in text[1:])]))
            (TABLES / f"{name}.csv").write_text("\n".join(whole) + "\n", encoding="utf-8")
    text = with_blocks(guide.path.read_text(encoding="utf-8"), guide.blocks())
    guide.path.write_text(text, encoding="utf-8")
