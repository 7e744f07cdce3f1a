"""The little reStructuredText that the models' docstrings use, as Markdown: headings, math, simple tables, roles, doctests."""

import re

RULE = re.compile(r"=+(  +=+)+")


def to_markdown(text: str, drop: str = "") -> str:
    """Markdown of a docstring; a table whose first column is headed ``drop`` is left out."""
    blocks = re.split(r"\n\s*\n", text.strip("\n"))
    made = []
    for block in blocks:
        lines = block.split("\n")
        if RULE.fullmatch(lines[0].strip()):
            rows = table(lines)
            made += [] if rows[0][0] == drop else [as_table(rows)]
        elif lines[0].startswith(".. math::"):
            made.append(f"$$\n{formula(block)}\n$$")
        elif lines[0].startswith(">>> "):
            made.append("```pycon\n" + block + "\n```")
        else:
            made.append(inline(" ".join(line.strip() for line in lines)))
    return "\n\n".join(made)


def formula(text: str) -> str:
    """The first ``.. math::`` of a docstring on one line; empty if it has none."""
    found = re.search(r"^\.\. math::(.*(?:\n[ \t]+.*)*)", text, re.MULTILINE)
    return " ".join(found[1].split()) if found else ""


def table(lines: list[str]) -> list[list[str]]:
    """Rows of a simple table, the head (empty cells, if it has none) first; a line without a first cell continues its row."""
    spans = [m.span() for m in re.finditer("=+", lines[0])]
    starts = [a for a, _ in spans]
    headless = sum(bool(RULE.fullmatch(line.strip())) for line in lines) < 3
    rows: list[list[str]] = [[""] * len(starts)] if headless else []
    for line in lines[1:]:
        if RULE.fullmatch(line.strip()):
            continue
        ends = [*starts[1:], len(line) + 1]
        cells = [line[a:b].strip() for a, b in zip(starts, ends, strict=True)]
        if cells[0] or not rows or not any(rows[-1]):
            rows.append(cells)
        else:
            rows[-1] = [f"{old} {new}".strip() for old, new in zip(rows[-1], cells, strict=True)]
    return rows


def as_table(rows: list[list[str]]) -> str:
    """A Markdown table; the first row is its head."""
    shown = [[inline(cell).replace("|", "\\|") for cell in row] for row in rows]
    head, *body = (f"| {' | '.join(row)} |" for row in shown)
    return "\n".join([head, f"|{' --- |' * len(rows[0])}", *body])


def inline(text: str) -> str:
    """Roles and literals of one paragraph."""
    text = re.sub(r":math:`([^`]*)`", r"$\1$", text)
    text = re.sub(r":\w+:`~?([^`]*)`", r"`\1`", text)
    return re.sub(r"``([^`]*)``", r"`\1`", text)
