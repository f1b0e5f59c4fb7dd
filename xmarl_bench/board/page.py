"""The page: static files that load nothing from elsewhere, from a disk or a server.

Rankings (views.py), explainers (explainer_pages.py) and the comparison with and without the regulariser are
HTML with their charts drawn in it: they work without scripts, which only sort tables and highlight lines.
`scores.html` and `entry.html` show one of many rows, and read them from scripts in `pages/`, because browsers
let a page opened from a disk load scripts but not JSON:

- one script with every row of the board (rows.py);
- one script per policy and table with the provenance and charts of its entries.

Names of scripts and styles end in a hash of their bytes, so a page never loads a file of another build.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any

from jinja2 import BytecodeCache, Environment, FileSystemLoader, StrictUndefined
from jinja2.bccache import Bucket
from markupsafe import Markup, escape

from xmarl_bench.board.answer import answer_about, answer_on_term, number
from xmarl_bench.board.columns import COLUMNS, COMPARED, GAMED, ORDER, PAPER
from xmarl_bench.board.details import Details
from xmarl_bench.board.explainer_pages import explainers_of, term_page
from xmarl_bench.board.rows import board_rows
from xmarl_bench.board.views import absence_of, budget_chart, context_of, scopes_of, short_task
from xmarl_bench.explain.control_names import NEAREST, SUMMARIES
from xmarl_bench.metrics.table import OF_EXPLAINERS, by_name, metrics_of
from xmarl_bench.records.files import canonical_json

HERE = Path(__file__).parent
PAGES = "pages"
QUOTED = re.compile(r"`([^`]*)`")
Json = dict[str, Any]


def page_files(
    board: Json, details: Mapping[str, Details], animations: Set[str], cards: Json
) -> dict[str, bytes]:
    """Every file of the page by its path, in the order of writing: none refers to a later one but by a link.

    board: the result of `board_of`; details: by file; animations: names of the files in `animations/`; cards:
    what `explainers.json` tells of explainers, by name.
    """
    files: dict[str, bytes] = {}

    def add(name: str, data: bytes) -> str:
        stem, dot, ending = name.rpartition(".")
        path = f"{PAGES}/{stem}-{_hash(data)}{dot}{ending}"
        files[path] = data
        return path

    assets = {path.name: add(path.name, path.read_bytes()) for path in sorted((HERE / "assets").iterdir())}
    explainers = explainers_of(board, details, cards)
    environment = _environment(set(explainers), cards)
    figures: Any = environment.get_template("figures.jinja").module
    scripts = {}
    for t, table in enumerate(board["tables"]):
        for policy in table["policies"]:
            scope = (table["task"], table["n_agents"], table["max_cycles"])
            key = _hash(canonical_json([t, policy["name"], policy["weights_sha256"]]))
            charts = [budget_chart(table, policy, details, kind) for kind in ("comm_budget", "budget")]
            shown = {
                "entries": {row["entry_id"][:16]: _shown(details[row["file"]][scope])
                            for row in policy["rows"] if row["entry_id"]},
                "charts": [str(figures.lines(chart)) for chart in charts if chart is not None],
            }  # fmt: skip
            scripts[t, policy["name"], policy["weights_sha256"]] = (
                key, add(f"{policy['name']}.js", _script(f"XMARL_{key}", shown)))  # fmt: skip
    data = add("board.js", _script("BOARD", board_rows(board, scripts, animations)))
    scopes = scopes_of(board)
    environment.globals |= {
        "assets": assets,
        "data": data,
        "scopes": scopes,
        "board": board,
        "definitions": {m.name: m for m in metrics_of(*OF_EXPLAINERS)},
        "controls": {**SUMMARIES, NEAREST: "exp(-distance in m): never looks at the policy"},
    }

    def render(path: str, template: str, **context: Any) -> None:
        root = "../" * path.count("/")
        made = environment.get_template(template).render(root=root, path=path, **context)
        files[path] = made.encode()

    for name, explainer in explainers.items():
        render(explainer_path(name), "explainer.html.jinja", name=name, explainer=explainer)
    if board["tables"]:
        render(TERM, "regulariser.html.jinja", **term_page(board, scopes[0][0], details))
    for view in scopes:
        for each in reversed(view):  # the page of all tasks last
            shown = context_of(board, each, view, details, cards)
            render(each.path, "ranking.html.jinja", scope=each, context=shown)
    if not board["tables"]:
        render("index.html", "empty.html.jinja")
    render("scores.html", "scores.html.jinja")
    render("entry.html", "entry.html.jinja")
    return files


TERM = f"{PAGES}/regulariser.html"


def explainer_path(name: str) -> str:
    return f"{PAGES}/explainer-{name}.html"


def breakable(name: str) -> Markup:
    """The name, which may be broken after its hyphens and underscores."""
    return Markup(re.sub("([-_])", r"\1<wbr>", str(escape(name))))


class _CompiledTemplates(BytecodeCache):
    """Compiling the templates takes as long as filling them in: done once in a process."""

    def __init__(self) -> None:
        self.by_key: dict[str, bytes] = {}

    def load_bytecode(self, bucket: Bucket) -> None:
        if bucket.key in self.by_key:
            bucket.bytecode_from_string(self.by_key[bucket.key])

    def dump_bytecode(self, bucket: Bucket) -> None:
        self.by_key[bucket.key] = bucket.bytecode_to_string()


_COMPILED = _CompiledTemplates()


def _environment(explainers: Set[str], cards: Json) -> Environment:
    environment = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        bytecode_cache=_COMPILED,
    )

    def linked(text: str, root: str) -> Markup:
        """Names in backquotes become links to explainers, or code."""

        def link(name: str) -> Markup:
            if name not in explainers:
                return Markup("<code>{}</code>").format(name)
            return Markup('<a href="{}{}">{}</a>').format(root, explainer_path(name), name)

        parts = QUOTED.split(text.replace(" %", "\u00a0%"))
        return Markup("").join(link(part) if k % 2 else escape(part) for k, part in enumerate(parts))

    environment.filters |= {"breakable": breakable, "num": number, "linked": linked, "short_task": short_task}
    environment.globals |= {
        "columns": {name: heading.rstrip(" \u2191\u2193") for name, heading in COLUMNS.items()},
        "metrics": by_name(),
        "order": ORDER["by"],
        "gamed": GAMED,
        "compared": COMPARED,
        "order_note": ORDER["note"],
        "paper": PAPER,
        "explainer_path": explainer_path,
        "has_page": explainers.__contains__,
        "term_path": TERM,
        "absence_of": lambda name: absence_of(cards, name),
        "answer_about": answer_about,
        "answer_on_term": answer_on_term,
    }
    return environment


def _shown(details: Json) -> Json:
    """What the page of an entry shows: without what is drawn beforehand."""
    return {name: value for name, value in details.items() if name not in ("episodes", "budgets")}


def _script(name: str, value: Any) -> bytes:
    return b"globalThis.%s=%s;\n" % (name.encode(), canonical_json(value))


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:10]
