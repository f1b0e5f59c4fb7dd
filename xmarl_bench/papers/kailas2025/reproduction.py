"""Writes docs/reproduction.md: which of the paper's conclusions hold, in sentences with their numbers.

    python -m xmarl_bench.papers.kailas2025.reproduction study/main study/training study/zero-shot

Reads results.json of each folder, and writes docs/reproduction.json, a small file that is committed, and
docs/reproduction.md, which is a function of it. No number or verdict is typed by hand. A study replaces an
earlier one of its name and families; other studies of the file stay.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from xmarl_bench.counted import counted
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.errors import InputError
from xmarl_bench.papers.kailas2025.claims import Combine, Quantifier
from xmarl_bench.papers.kailas2025.ledger import Verdict, combine
from xmarl_bench.papers.kailas2025.lenses import BEHAVIOUR
from xmarl_bench.papers.kailas2025.plan import STUDIES
from xmarl_bench.papers.kailas2025.results import SCHEMA
from xmarl_bench.papers.kailas2025.tables import (
    METRIC_NAMES,
    decisive,
    difference,
    lens_table,
    p_value,
    performance_table,
)
from xmarl_bench.records.files import write_atomically, write_json
from xmarl_bench.records.markdown import from_template, markdown_table
from xmarl_bench.rollout.cell import Sampling

Json = dict[str, Any]
TEMPLATE = Path(__file__).with_name("reproduction.md.jinja")
DATA, PAGE = "reproduction.json", "reproduction.md"
HEADLINES = [f"main-{name}" for name in (
    "graphmask-least", "gnn-best", "attention-over-gnn-with", "attention-fid-plus", "attention-fid-minus",
    "attention-gef", "attention-fid-delta", "graphmask-fid-minus", "graphmask-fid-plus", "graphmask-gef",
    "gnn-mixed", "success", "distance",
)]  # fmt: skip
KEPT = (
    "schema", "study", "title", "existing", "protocol", "families", "policies", "missing", "core_hours",
    "performance",
)  # fmt: skip
CONTRAST = (
    "metric", "relation", "compares", "a_mean", "b_mean", "difference", "interval", "p_adjusted", "effect",
    "n_policies", "n_episodes", "verdict",
)  # fmt: skip


def findings_of(results: Json) -> Json:
    """The part of a study's results that the page needs, without values cell by cell."""
    return {
        **{name: results[name] for name in KEPT},
        "ledger": [_brief(claim) for claim in results["ledger"]],
        "beyond": [_brief(claim) for claim in results["beyond"]],
        "lenses": [
            {**lens, "claims": [_seen(claim) for claim in lens["claims"]]} for lens in results["lenses"]
        ],
    }


def page_of(findings: list[Json]) -> str:
    """The Markdown page of the studies."""
    studies = [
        {
            **each,
            "title": " ".join([each["title"], *_of_family(each)]),
            "headline": " ".join(["In short", *_of_family(each)]),
            "groups": [(v.value, [c for c in each["ledger"] if c["verdict"] == v]) for v in Verdict],
            "survival": survival(each),
            "lens_table": lens_table(each).markdown(),
            "performance_table": performance_table(each).markdown(),
            "command": command(each),
            "headlines": headlines(each),
            "played": _played(each),
            "gated": [policy for policy in each["policies"] if policy["gate"]],
        }
        for each in findings
    ]
    return from_template(
        TEMPLATE,
        {"sentence": sentence, "numbers": numbers},
        studies=studies,
        not_run=[
            study for study in STUDIES.values() if study.name not in {each["study"] for each in findings}
        ],
        outdated=", ".join(sorted({each["protocol"]["id"] for each in findings} - {PROTOCOL})),
    )


def through_lenses(findings: Json, claim: Json) -> Json:
    """The lenses under which a statement held, was reversed or stayed open. Skips those not measured."""
    seen = [
        (lens["name"], each)
        for lens in findings["lenses"]
        for each in lens["claims"]
        if each["id"] == claim["id"] and each["verdict"] != Verdict.NOT_MEASURED
    ]
    by = {verdict: [pair for pair in seen if pair[1]["verdict"] == verdict] for verdict in Verdict}
    return {
        "claim": claim,
        "n": len(seen),
        "held": by[Verdict.HELD],
        "reversed": by[Verdict.NOT_HELD],
        "open": by[Verdict.NOT_DECIDED],
    }


def survival(findings: Json) -> list[Json]:
    """Statements that held as in the paper, and to which a lens applies."""
    held = [claim for claim in findings["ledger"] if claim["verdict"] == Verdict.HELD]
    return [seen for seen in (through_lenses(findings, claim) for claim in held) if seen["n"]]


def headlines(findings: Json) -> str:
    """The main conclusions as a Markdown table."""
    header = "conclusion", "cell by cell", "over all policies", "through other explainers and metrics"
    rows = []
    for claim in findings["ledger"]:
        if claim["id"] in HEADLINES:
            seen = through_lenses(findings, claim)
            parts = [f"held {len(seen['held'])}"] if seen["held"] else []
            parts += [
                f"{word}: {', '.join(name for name, _ in seen[key])}"
                for key, word in (("reversed", "reversed"), ("open", "not decided"))
                if seen[key]
            ]
            verdict = f"**{claim['verdict']}**"
            rows.append((claim["text"], verdict, over_all(claim), "; ".join(parts) or "-"))
    return markdown_table(header, rows).rstrip()


def over_all(claim: Json) -> str:
    """The verdict over all policies together, and the comparison that decides it.

    Of a statement about cells both ways the comparison alone: a mean over cells cannot show it.
    """
    overall: list[Json] = claim["overall"]
    verdict = combine([Verdict(each["verdict"]) for each in overall], Combine.ALL)
    shown = next((each for each in overall if each["verdict"] == verdict), overall[0])
    judged = "" if claim["quantifier"] == Quantifier.MIXED else f"{verdict}: "
    runs = counted(shown["n_policies"], "policy")
    return f"{judged}{METRIC_NAMES[shown['metric']]} {difference(shown)}, {runs}"


def sentence(claim: Json) -> str:
    """The statement, its lines in the paper, and its numbers."""
    lines = claim["lines"]
    place = "" if lines == "-" else f"line{'' if lines.isdecimal() else 's'} {lines}; "
    return f"{claim['text']} ({place}asked of {claim['quantifier']}): {numbers(claim)}."


def numbers(claim: Json) -> str:
    """The number of cells of each verdict, and the decisive comparison over all policies."""
    counts, shown = claim["counts"], decisive(claim)
    n = sum(counts.values())
    words = {verdict: "the reverse" if verdict is Verdict.NOT_HELD else verdict for verdict in Verdict}
    parts = [f"{counts[verdict]} {word}" for verdict, word in words.items() if counts[verdict]]
    text = f"of {counted(n, 'cell')} {', '.join(parts)}"
    if shown["difference"] is None:
        return text
    return (
        f"{text}; {METRIC_NAMES[shown['metric']]}, {shown['compares']}: {difference(shown)}, "
        f"effect {shown['effect']:+.2f}, p {p_value(shown)}, {counted(shown['n_policies'], 'policy')}"
    )


def command(findings: Json) -> str:
    """The command that scores the same states again, or judges the leaderboard's entries of them."""
    protocol = findings["protocol"]
    # The name of a family means its finished policies.
    finished = all(policy["percent"] is None for policy in findings["policies"])
    options = [f"--policy {family}" for family in findings["families"] if finished]
    options += [f"--episodes {protocol['episodes']}"] if protocol["episodes"] != Sampling.episodes else []
    options += [] if protocol["timesteps"] is None else [f"--timesteps {protocol['timesteps']}"]
    source = "--entries leaderboard" if findings["existing"] else "--jobs 2"
    return " ".join(["xmarl-bench study", findings["study"], source, *options])


def _of_family(findings: Json) -> list[str]:
    """The end of a heading; empty if the policies are of several families."""
    return [f"(family `{family}`)" for family in findings["families"] if len(findings["families"]) == 1]


def _played(findings: Json) -> bool:
    """Whether teams played on the explanations that behavioural fidelity compares."""
    return any(
        claim["verdict"] != Verdict.NOT_MEASURED
        for lens in findings["lenses"]
        if lens["name"] == BEHAVIOUR.name
        for claim in lens["claims"]
    )


def _brief(claim: Json) -> Json:
    names = ("id", "lines", "text", "quantifier", "verdict", "counts")
    return {**{name: claim[name] for name in names}, "overall": [_kept(each) for each in claim["overall"]]}


def _seen(claim: Json) -> Json:
    """A statement through a lens: its id, verdict and decisive comparison."""
    return {
        **{name: claim[name] for name in ("id", "verdict", "counts")},
        "overall": [_kept(decisive(claim))],
    }


def _kept(contrast: Json) -> Json:
    return {name: contrast[name] for name in CONTRAST}


def read_results(folder: Path) -> Json:
    """Read results.json of a study's folder. Raises InputError if it is missing or of another schema."""
    path = folder / "results.json"
    try:
        results: Json = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path} cannot be read ({why}): run `xmarl-bench study` first.") from None
    if results.get("schema") != SCHEMA:
        raise InputError(f"{path} is of schema {results.get('schema')}, not {SCHEMA}: run the study again.")
    return results


def main(
    folders: Annotated[list[Path], typer.Argument(help="Folders of studies.")],
    out: Annotated[Path, typer.Option(help="Folder of reproduction.json and reproduction.md.")] = Path(
        "docs"
    ),
) -> None:
    """Write the findings of the studies, in place of earlier ones of the same studies and families."""
    data = out / DATA
    known = json.loads(data.read_bytes()) if data.exists() else []
    made = [findings_of(read_results(folder)) for folder in folders]
    findings = {(each["study"], *each["families"]): each for each in (*known, *made)}
    write_json(data, list(findings.values()))
    write_atomically(out / PAGE, page_of(json.loads(data.read_bytes())).encode())


if __name__ == "__main__":
    try:
        typer.run(main)
    except InputError as error:
        typer.echo(f"xmarl-bench: {error}", err=True)
        sys.exit(2)
